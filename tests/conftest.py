"""Shared set-up: where tests find `strategies`, and how hypothesis runs."""

import os
import signal
import sys
from pathlib import Path

# On tiny problems the threads of the kernels mostly wait for each other, minutes of it where the cores are shared.
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from sapopt import SAP, SwitchingCost

# Tests are imported by file (import mode importlib), so what they share has to be put on the path.
sys.path.insert(0, str(Path(__file__).parent))

# The same examples in every run; HYPOTHESIS_PROFILE=explore looks for new ones. No deadline: kernels are compiled on
# the first example.
settings.register_profile(
    "steady", deadline=None, derandomize=True, max_examples=60, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "explore", deadline=None, max_examples=1000, suppress_health_check=[HealthCheck.too_slow]
)
# A shell that starts the tests in the background has them ignore Ctrl-C, which some of them send.
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steady"))


@pytest.fixture
def problem_file(tmp_path: Path) -> Path:
    """A small saved problem."""
    path = tmp_path / "small.npz"
    SAP(np.random.default_rng(1).random((5, 3, 4)), SwitchingCost(0.3)).save(path)
    return path
