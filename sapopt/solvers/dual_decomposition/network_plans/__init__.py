"""Plans from prices under the plain switching rule: flat arrays, compiled sweeps, restricted networks."""

from sapopt.solvers.dual_decomposition.network_plans.builder import LargeNetworkPlans, NetworkPlans

__all__ = ["LargeNetworkPlans", "NetworkPlans"]
