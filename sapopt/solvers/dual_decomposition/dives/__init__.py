"""Dives: agents plan steps anew by fixing what their softened paths agree on, under prices that settle on the way."""

from sapopt.solvers.dual_decomposition.dives.search import Dives

__all__ = ["Dives"]
