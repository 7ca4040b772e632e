"""Exact solutions by four routes that have little in common."""

from sapopt.solvers.exact.planner import Exact

__all__ = ["Exact"]
