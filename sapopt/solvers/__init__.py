"""Solvers: policies that decide step by step and planners that see the whole horizon."""

from sapopt.solvers.distributed import CBBA, HAALD, CentralHAALD, DistributedAuction, DistributedDualLookahead
from sapopt.solvers.haal import HAA, HAAL
from sapopt.solvers.policy import AssignmentPolicy, Greedy, NoHandover, myopic

__all__ = [
    "CBBA",
    "HAA",
    "HAAL",
    "HAALD",
    "AssignmentPolicy",
    "CentralHAALD",
    "DistributedAuction",
    "DistributedDualLookahead",
    "Greedy",
    "NoHandover",
    "myopic",
]
