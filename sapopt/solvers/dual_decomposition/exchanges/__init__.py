"""Annealing by exchanges: two agents swap what they do for some steps, or one goes to a task that is free."""

from sapopt.solvers.dual_decomposition.exchanges.search import Exchanges

__all__ = ["Exchanges"]
