"""The README's example runs as it stands there."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

README = Path(__file__).parents[1] / "README.md"


def test_the_python_example_runs(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    time = np.arange(300) / 100
    still = np.tile([0.0, 0.0, 0.01], (300, 1))
    arrays = {
        "time": time,
        "gyr": still,
        "acc": np.add(still, [0, 0, 9.8]),
        "mag": np.tile([0.0, 18.0, -41.0], (300, 1)),
    }
    np.savez(tmp_path / "trial.npz", **arrays)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(re.findall(r"-?\d\.\d+", done.stdout)) >= 4 + 9
