"""Options with which a test's programs compile several times faster than they would, and run slower; and the others."""

import os

import jax

# JAX 0.11 has another option for it; on an accelerator neither means anything.
LESS = (
    {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {"xla_disable_hlo_passes": "fusion"}
)
QUICK = {**LESS, "xla_backend_optimization_level": 0} if os.environ.get("JAX_PLATFORMS") == "cpu" else {}
FULL = (
    {"xla_cpu_use_fusion_emitters": True, "xla_backend_optimization_level": 3}
    if QUICK and "xla_cpu_use_fusion_emitters" in LESS
    else {}
)
"""What users have, against the flags in `conftest.py`: for what is asked of a program to the last bits."""
