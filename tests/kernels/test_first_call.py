"""The first call on a machine: what is compiled then is told, and does not eat a time limit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sapopt import solve
from sapopt.domains.instances import instance
from sapopt.solvers import HAA
from sapopt.solvers.names import METHODS

COMMAND = "from sapopt.cli import main; main()"


def run(cache: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run Python with an empty cache of compiled code."""
    return subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, check=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
    )  # fmt: skip


@pytest.mark.slow
def test_compiling_does_not_eat_a_time_limit(tmp_path: Path) -> None:
    """Five seconds are five of work: the planner has proven a bound and found more than HAA's whole plan."""
    code = (
        "import logging; logging.basicConfig(level=logging.INFO)\n"
        "from sapopt import solve\n"
        "from sapopt.solvers import DualDecomposition\n"
        "from sapopt.domains.instances import instance\n"
        "result = solve(instance('constellation-toy'), DualDecomposition(), time_limit=5.0)\n"
        "print(result.value, result.bound)\n"
    )
    ran = run(tmp_path, "-c", code)
    value, bound = map(float, ran.stdout.split())
    assert solve(instance("constellation-toy"), HAA()).value < value <= bound + 1e-9
    assert "went into compiling kernels" in ran.stderr


@pytest.mark.slow
def test_the_command_line_tells_of_compiling(tmp_path: Path) -> None:
    """One line on standard error says that kernels are compiled, and the limit is left for the bound."""
    ran = run(tmp_path, "-c", COMMAND, "bound", "constellation-toy", "--time-limit", "5", "--json")
    assert ran.stderr.count("compiling kernels") == 1
    assert '"bound"' in ran.stdout


@pytest.mark.slow
def test_warm_compiles_ahead(tmp_path: Path) -> None:
    """After `sapopt warm` a bound compiles nothing any more, and `warm` itself is silent on stdout but for its JSON."""
    told = json.loads(run(tmp_path, "-c", COMMAND, "warm", "--jobs", "2", "--json").stdout)
    assert set(told["compile_seconds"]) == {"bound", *(method.name for method in METHODS)}
    ran = run(tmp_path, "-c", COMMAND, "compare", "constellation-toy", "--time-limit", "2")
    assert "in the cache" not in ran.stderr
