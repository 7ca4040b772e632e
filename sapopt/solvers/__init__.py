"""Solvers: policies that decide step by step and planners that see the whole horizon."""

from sapopt.solvers.haal import HAA, HAAL
from sapopt.solvers.policy import AssignmentPolicy, Greedy, NoHandover, myopic

__all__ = ["HAA", "HAAL", "AssignmentPolicy", "Greedy", "NoHandover", "myopic"]
