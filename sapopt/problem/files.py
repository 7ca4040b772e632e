"""Problems in files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sapopt.data.benefits import Benefits
from sapopt.data.files import Entry, read_npz, write_npz
from sapopt.data.times import described_times, rebuilt_times
from sapopt.dynamics.registry import is_own
from sapopt.problem.description import described, described_own, rebuilt, rebuilt_own
from sapopt.problem.limit_files import described_limits, rebuilt_limits

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP

_FORMAT = "sapopt-problem-1"
_ENTRIES = {
    "dense": Entry("f", (None, None, None), optional=True),
    "indptr": Entry("iu", (None,), optional=True),
    "indices": Entry("iu", (None,), optional=True),
    "data": Entry("f", (None,), optional=True),
    "initial_assignment": Entry("iu", (None,), optional=True),
    "capacity": Entry("iu", (None, None), optional=True),
}
_MOST_BYTES = 64 * 2**30  # of the arrays of a file


def write_problem(problem: SAP, path: str | Path) -> None:
    """Write a problem; see `SAP.save`."""
    own = is_own(problem.dynamics)
    meta, arrays = described_own(problem.dynamics) if own else described(problem.dynamics)
    meta |= {
        "format": _FORMAT,
        "agents": problem.agents,
        "tasks": problem.tasks,
        "shape": [problem.T, problem.n, problem.m],
        **described_times(problem.times),
    }
    if problem.benefits.is_sparse:
        flat = problem.benefits.flat()
        arrays |= {"indptr": flat.indptr, "indices": flat.indices, "data": flat.data}
    else:
        arrays["dense"] = problem.benefits.dense() + 0.0  # no negative zeros: equal problems, equal files
    if problem.initial_assignment is not None:
        arrays["initial_assignment"] = problem.initial_assignment
    if problem.capacity is not None:
        arrays["capacity"] = problem.capacity
    if problem.idle:
        meta["idle"] = True
    more, weights = described_limits(problem.limits)
    write_npz(path, meta | more, arrays | weights)


def brings_own(path: str | Path) -> bool:
    """Whether the problem of a file has a dynamics of a user's own."""
    return "own" in read_npz(path, _FORMAT, _ENTRIES, _MOST_BYTES, prefix=("dynamics.", "limit."))[0]


def read_problem(path: str | Path, dynamics: Any = None) -> dict[str, Any]:
    """The arguments of the `SAP` that a file holds; see `SAP.load`.

    Raises
    ------
    ValueError
        If the file is damaged or holds something else, or the dynamics handed over is not that of the file.
    """
    meta, arrays = read_npz(path, _FORMAT, _ENTRIES, _MOST_BYTES, prefix=("dynamics.", "limit."))
    try:
        if "dense" in arrays:
            benefits = Benefits(arrays["dense"])
        else:
            benefits = Benefits.from_flat(arrays["indptr"], arrays["indices"], arrays["data"], meta["shape"])
        if "own" in meta:
            model = rebuilt_own(meta, arrays, dynamics, path)
        elif dynamics is not None:
            raise ValueError(f"dynamics: {path} holds a {meta['dynamics']} of sapopt; leave dynamics out")
        else:
            model = rebuilt(meta, arrays)
        return {
            "benefits": benefits, "dynamics": model, "initial_assignment": arrays.get("initial_assignment"),
            "capacity": arrays.get("capacity", 1), "idle": meta.get("idle", False),
            "limits": rebuilt_limits(meta, arrays), "agents": meta["agents"], "tasks": meta["tasks"],
            "times": rebuilt_times(meta),
        }  # fmt: skip
    except (KeyError, TypeError, OverflowError, MemoryError) as error:
        raise ValueError(f"{path}: damaged problem file ({error})") from None
