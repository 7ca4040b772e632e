"""Every built-in method in forked children, in many threads and in a Dask worker; run as a script of its own.

    python tests/surroundings.py fork|threads|dask

Prints one JSON object: the values by method, and what the process then had loaded.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from sapopt import SAP, SwitchingCost, bound, solve
from sapopt.dynamics import Battery, Interference, SlewCost, SyntheticSwitching
from sapopt.kernels import blocks
from sapopt.kernels.jit import KERNELS, compiled_always
from sapopt.solvers.names import METHODS, parse_solver

SECONDS = 60.0
"""A child that has not answered by then hangs."""
RULES = {
    "uniform": SwitchingCost(0.3),
    "idle": SwitchingCost(0.3, idle_is_free=True),
    "matrix": SwitchingCost(0.3 * (1.0 - np.eye(5))),
    "battery": Battery(0.3),
    "copies": SyntheticSwitching(0.3),
    "interference": Interference([[0, 1]], 0.2, 0.3),
    "slew": SlewCost(0.3, np.full((3, 3, 3), 2.0) + np.arange(27).reshape(3, 3, 3) / 10, np.eye(3)),
}
"""One of each family of dynamics."""


def problem(rule: str) -> SAP:
    """A tiny problem; copies and slewing want three tasks."""
    benefits = np.random.default_rng(1).random((3, 3, 3 if rule == "slew" else 5))
    return SAP(benefits * (benefits > 0.4), RULES[rule], [0, 1, 2])


def work(name: str) -> float:
    """Value of a method on a rule that it takes, or the bound of a rule."""
    what, _, which = name.partition(" ")
    if what == "bound":
        return bound(problem(which)).value
    rule = "interference" if which == "iterated" else "uniform"
    return solve(problem(rule), parse_solver(which).solver, seed=0).value


NAMES = [
    *(f"solve {method.name}" for method in METHODS),
    *(f"bound {rule}" for rule in RULES if rule != "interference"),
]


def forked() -> dict[str, float]:
    """Everything once here, then in forked children."""
    here = [work(name) for name in NAMES]
    with multiprocessing.get_context("fork").Pool(2) as pool:
        there = pool.map_async(work, NAMES).get(SECONDS)
    assert here == there
    return dict(zip(NAMES, here, strict=True))


def threaded() -> dict[str, float]:
    """Everything in eight threads at once, and in a daemon thread."""
    with ThreadPoolExecutor(8) as pool:
        first, second = (list(half) for half in np.array_split(list(pool.map(work, NAMES * 2)), 2))
    assert first == second
    found: list[float] = []
    thread = threading.Thread(target=lambda: found.extend(map(work, NAMES)), daemon=True)
    thread.start()
    thread.join(SECONDS)
    assert found == first
    return dict(zip(NAMES, found, strict=True))


def in_dask() -> dict[str, float]:
    """Everything in a worker of three threads."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=1, threads_per_worker=3, processes=False, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        values = client.gather(client.map(work, NAMES, pure=False))
    return dict(zip(NAMES, values, strict=True))


def loaded() -> dict[str, object]:
    """What numba has loaded, and kernels that Python called and that were compiled for more than one signature."""
    from numba.np.ufunc import parallel

    layers = [name for name in ("omppool", "tbbpool", "workqueue") if f"numba.np.ufunc.{name}" in sys.modules]
    several = [
        repr(kernel)
        for kernel in KERNELS
        if kernel._run is not None and len(kernel._dispatcher.nopython_signatures) > 1
    ]
    return {"layers": layers, "initialised": parallel._is_initialized, "several": several}


if __name__ == "__main__":
    blocks._WORTH = 0  # threads share out even the least work
    with compiled_always():
        values = {"fork": forked, "threads": threaded, "dask": in_dask}[sys.argv[1]]()
    print(json.dumps({"values": values, **loaded()}))
