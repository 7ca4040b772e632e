"""Lagrangian dual of the task capacities: proven upper bounds and the prices behind them."""

from sapopt.formulations.dual.ascent import DualResult, DualState, ascend
from sapopt.formulations.dual.lagrangian import DualValue, dual_value, rigorous_bound

__all__ = ["DualResult", "DualState", "DualValue", "ascend", "dual_value", "rigorous_bound"]
