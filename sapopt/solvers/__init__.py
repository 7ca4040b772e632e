"""Solvers: policies that decide step by step and planners that see the whole horizon."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sapopt.solvers.distributed import CBBA, HAALD, CentralHAALD, DistributedAuction, DistributedDualLookahead
from sapopt.solvers.greedy import Greedy, MyopicGreedy
from sapopt.solvers.haal import HAA, HAAL
from sapopt.solvers.iterated import IteratedAssignment
from sapopt.solvers.policy import (
    AssignmentPolicy,
    NoHandover,
    energy_price,
    myopic,
    power_constrained,
)
from sapopt.solvers.rollout_policy import RolloutPolicy

if TYPE_CHECKING:
    from sapopt.solvers.dual_decomposition import DualDecomposition
    from sapopt.solvers.dual_lookahead import DualLookahead
    from sapopt.solvers.exact import Exact

__all__ = [
    "CBBA",
    "HAA",
    "HAAL",
    "HAALD",
    "AssignmentPolicy",
    "CentralHAALD",
    "DistributedAuction",
    "DistributedDualLookahead",
    "DualDecomposition",
    "DualLookahead",
    "Exact",
    "Greedy",
    "IteratedAssignment",
    "MyopicGreedy",
    "NoHandover",
    "RolloutPolicy",
    "energy_price",
    "myopic",
    "power_constrained",
]

# These load numba or a solver library, so they are imported when they are first asked for.
_LAZY = {
    "DualDecomposition": "sapopt.solvers.dual_decomposition",
    "DualLookahead": "sapopt.solvers.dual_lookahead",
    "Exact": "sapopt.solvers.exact",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'sapopt.solvers' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
