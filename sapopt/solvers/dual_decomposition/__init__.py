"""Plans from prices: dual decomposition with large-neighbourhood search."""

from sapopt.solvers.dual_decomposition.solver import DualDecomposition

__all__ = ["DualDecomposition"]
