"""The network of a window in which agents wait wherever there is room, if the problem allows for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sapopt.data.types import FloatArray, IntArray
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.idle_places import IdlePlaces, idle_flow, idles_freely
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import RestrictedFlow, largest
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import Places, can_wait, waiting_flow

_PLACES_REGRET = 1.4
"""What a place may cost more than the cheapest of its spell, in typical benefits."""


def has_places(arrays: Arrays) -> bool:
    """Whether networks of this problem may have places to wait or to idle."""
    return can_wait(arrays) or idles_freely(arrays)


def flow_with_places(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    agents: IntArray,
    first: int,
    last: int,
    regrets: Sequence[float],
    scale: float,
    arcs: int,
    until: int | None = None,
    tried: Callable[[float], object] = lambda regret: None,
) -> tuple[RestrictedFlow, Places | IdlePlaces]:
    """The network of the first of the falling reduced costs with at most `arcs` arcs, else of the last; and its places.

    Parameters
    ----------
    regrets : sequence of float
        Reduced costs in units of `scale`; ``tried`` hears of each.
    until : int
        As in `restricted_flow.restricted_flow`.
    """
    idle = idles_freely(arrays)
    build = idle_flow if idle else waiting_flow

    def network(regret: float, limit: int) -> RestrictedFlow:
        tried(regret / scale)
        return build(arrays, plan, prices, agents, first, last, regret, limit, until)

    flow = largest(network, regrets, scale, arcs)
    if idle:
        return flow, IdlePlaces.of(arrays, plan, first, last)
    return flow, Places.of(arrays, flow, plan, prices, agents, first, last, _PLACES_REGRET * scale)
