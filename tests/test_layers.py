"""The direction of DESIGN: a folder imports only what stands above it."""

import ast
from pathlib import Path

import jaxest

PACKAGE = Path(jaxest.__file__).parent
LAYERS = [
    "types",
    "files",
    "stamps",
    "derivatives",
    "linalg",
    "manifolds",
    "distributions",
    "kinematics",
    "models",
    "filters",
    "mapping",
    "sensors",
    "parallel",
    "mcmc",
    "calibration",
    "simulate",
    "systems",
    "metrics",
    "tuning",
    "io",
    "viz",
    "live",
    "bench",
    "reproduce",
    "cli",
]
FORBIDDEN = {"filters": {"sensors", "kinematics", "models"}, "io": {"systems", "filters"}}


def imports(path: Path) -> set[str]:
    """Layers of jaxest that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "jaxest":
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("jaxest.")}
    return found & set(LAYERS)


def test_every_file_imports_only_from_above():
    wrong = []
    for path in PACKAGE.rglob("*.py"):
        relative = path.relative_to(PACKAGE)
        layer = relative.parts[0].removesuffix(".py")
        if layer.startswith("__"):
            continue
        assert layer in LAYERS, f"{relative} has no place in DESIGN's list"
        allowed = set(LAYERS[: LAYERS.index(layer) + 1]) - FORBIDDEN.get(layer, set())
        wrong += [f"{relative} imports jaxest.{name}" for name in imports(path) - allowed]
    assert not wrong, "\n".join(wrong)


def test_the_check_sees_imports():
    assert "kinematics" in imports(PACKAGE / "simulate" / "imu.py")
