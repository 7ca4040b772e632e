"""Large-neighbourhood search: windows of the plan, between fixed neighbours, solved exactly on restricted networks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import (
    RestrictedFlow,
    restricted_flow,
)
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import (
    PLACES_REGRET,
    Places,
    wait_anywhere,
    waiting_flow,
)

REGRETS = (0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08, 0.05, 0.03)
"""Ladder of reduced costs, in typical benefits. Long windows with small ones gain more than short ones with large."""

GROUP_REGRET = 0.18
"""Where all agents' network does not fit at this reduced cost, they are split into groups."""

_SMALL_PROBLEM = 6
"""Tasks up to which an agent may wait on any task."""

SHARE_OF_TIME = 0.1
"""Share of the time left that one network may take."""


@dataclass(frozen=True)
class Effort:
    """Size of one round of windows.

    Attributes
    ----------
    length : int
        Steps of a window.
    arcs : int
        Size of a network: the reduced cost shrinks, and then the agents are split into groups, until it fits.
    parking : int
        Random tasks that each agent may use without seeing them.
    """

    length: int
    arcs: int
    parking: int = 2


EFFORTS = (Effort(10, 8_000), Effort(15, 11_000), Effort(20, 15_000), Effort(30, 30_000), Effort(40, 40_000))
"""Windows from small ones that go fast to large ones."""

_WAITING_EFFORTS = ((3, 12), (4, 16), (6, 18), (8, 24), (6, 40), (10, 40))
"""The same where windows have places to wait (`waiting_places`): steps, and arcs for every agent."""

_WAITING_REGRETS = (1.4, 1.0, *REGRETS)
"""Ladder of reduced costs there: what agents may do is less, so that networks are small."""

_LONGEST_WAITING = 12
"""Steps of a window up to which it has places to wait: their number grows with the square of that."""


def improved(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    effort: Effort,
    shift: int,
    rng: np.random.Generator,
    *,
    threads: int = 2,
    seconds_left: Callable[[], float] = lambda: math.inf,
) -> Iterator[IntArray]:
    """Yield ever better plans (T, n): one after each window ``[shift + c * length, shift + (c + 1) * length)``.

    Windows that touch depend on each other, so every second one is solved at a time, in parallel. The result depends on
    ``rng`` alone unless time runs out; closing the iterator stops the search.
    """
    steps, length = arrays.steps, effort.length
    edges = sorted({min(max(e, 0), steps) for e in range(shift - length, steps + length, length)})
    windows = list(pairwise(edges))
    seeds = rng.integers(2**63, size=len(windows))
    with ThreadPoolExecutor(threads) as pool:
        for turn in (0, 1):
            base = plan
            jobs = [
                (
                    window,
                    pool.submit(improve_window, arrays, base, prices, effort, *window, seed, seconds_left),
                )
                for window, seed in list(zip(windows, seeds, strict=True))[turn::2]
            ]
            try:
                for (first, last), job in jobs:
                    window_plan = job.result()
                    plan = plan.copy()
                    plan[first:last] = window_plan[first:last]
                    yield plan
            finally:
                for _, job in jobs:
                    job.cancel()


def improve_window(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    effort: Effort,
    first: int,
    last: int,
    seed: int,
    seconds_left: Callable[[], float],
) -> IntArray:
    """Return ``plan`` (T, n) with the steps first .. last - 1 planned anew, all agents together or in groups."""
    rng = np.random.default_rng(seed)
    everyone = np.arange(arrays.agents)
    parking = parking_tasks(arrays, plan, first, last, effort.parking, rng)
    scale = typical_benefit(arrays, first, last)
    flow = restricted_flow(arrays, plan, prices, everyone, first, last, GROUP_REGRET * scale, parking)
    value = arrays.value(plan)
    waits = last - first <= _LONGEST_WAITING and wait_anywhere(arrays)
    for group in groups_of(flow, arrays.agents, arrays.tasks, effort.arcs, rng):
        if seconds_left() <= 0:
            break
        places = None
        if waits:
            flow, places = _with_places(arrays, plan, prices, group, first, last, scale, effort.arcs)
        else:
            flow = _fitting(arrays, plan, prices, group, first, last, scale, parking[group], effort.arcs)
        seconds = max(SHARE_OF_TIME * seconds_left(), 0.01)
        found = solve_flow(
            flow, plan, arrays.tasks, seconds=seconds, stop=lambda: seconds_left() <= 0, places=places
        )
        if found is not None:
            found_value = arrays.value(found)
            if found_value >= value:
                plan, value = found, found_value
    return plan


def typical_benefit(arrays: Arrays, first: int, last: int) -> float:
    """Return the typical benefit of the window, the unit of reduced costs."""
    data = arrays.data[arrays.indptr[first * arrays.agents] : arrays.indptr[last * arrays.agents]]
    data = data[np.isfinite(data)]
    typical = float(np.abs(data).mean()) if len(data) else 0.0
    return typical if typical > 0.0 else 1.0


def parking_tasks(
    arrays: Arrays, plan: IntArray, first: int, last: int, count: int, rng: np.random.Generator
) -> IntArray:
    """Draw tasks for every agent to wait on, (n, count): spare ones if there are any."""
    if arrays.tasks <= _SMALL_PROBLEM:
        return np.tile(np.arange(arrays.tasks), (arrays.agents, 1))
    spare = np.setdiff1d(np.arange(arrays.tasks), plan[first:last])
    tasks = spare if len(spare) else np.arange(arrays.tasks)
    return rng.choice(tasks, size=(arrays.agents, count))


def _fitting(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    agents: IntArray,
    first: int,
    last: int,
    scale: float,
    parking: IntArray,
    arcs: int,
) -> RestrictedFlow:
    """Return the network of the largest reduced cost that has at most ``arcs`` arcs, or else of the smallest."""
    everything = arrays.tasks <= _SMALL_PROBLEM and len(agents) * (last - first) * arrays.tasks**2 <= arcs

    def network(regret: float, limit: int) -> RestrictedFlow:
        return restricted_flow(arrays, plan, prices, agents, first, last, regret, parking, limit)

    return largest(network, (math.inf,) if everything else REGRETS, scale, arcs)


def _with_places(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    agents: IntArray,
    first: int,
    last: int,
    scale: float,
    arcs: int,
) -> tuple[RestrictedFlow, Places]:
    """The same where agents wait wherever there is room, and the places for that."""

    def network(regret: float, limit: int) -> RestrictedFlow:
        return waiting_flow(arrays, plan, prices, agents, first, last, regret, limit)

    flow = largest(network, _WAITING_REGRETS, scale, arcs)
    return flow, Places.of(arrays, flow, plan, prices, agents, first, last, PLACES_REGRET * scale)


def largest(
    network: Callable[[float, int], RestrictedFlow], regrets: Sequence[float], scale: float, arcs: int
) -> RestrictedFlow:
    """The network of the first of the falling reduced costs that has at most ``arcs`` arcs, or else of the last.

    ``network(regret, limit)`` may leave it incomplete once it has more arcs than the limit.
    """
    for regret in regrets[:-1]:
        flow = network(regret * scale, arcs)
        if len(flow.tail) <= arcs:
            return flow
    return network(regrets[-1] * scale, 2**62)


def groups_of(
    flow: RestrictedFlow, agents: int, tasks: int, arcs: int, rng: np.random.Generator
) -> list[IntArray]:
    """Split the agents into groups with about ``arcs`` arcs each, whose members compete for the same cells.

    ``flow`` is the network of all agents at `GROUP_REGRET`, agent by agent.
    """
    if len(flow.tail) <= 2 * arcs:
        return [np.arange(agents)]
    size = 1 + agents * arcs // len(flow.tail)
    cell = flow.step * tasks + flow.task
    order = np.argsort(cell, kind="stable")
    _, start = np.unique(cell[order], return_index=True)
    cell_start = np.append(start, len(cell))
    place = np.empty(len(cell), np.int64)  # number of the distinct cell at every entry
    place[order] = np.repeat(np.arange(len(start)), np.diff(cell_start))
    agent_start = np.searchsorted(flow.agent, np.arange(agents + 1))
    label = _grow(cell_start, flow.agent[order], agent_start, place, size, rng.permutation(agents))
    return [np.flatnonzero(label == g) for g in range(label.max() + 1)]


@njit(cache=True, nogil=True)
def _grow(cell_start, cell_agents, agent_start, agent_cells, size, order):  # type: ignore[no-untyped-def]
    """Label agents by breadth-first search over shared cells; a group is closed when it has ``size`` members."""
    n = len(order)
    label = -np.ones(n, np.int64)
    queue = np.empty(n, np.int64)
    group = members = 0
    for root in order:
        if label[root] >= 0:
            continue
        queue[0], head, tail = root, 0, 1
        label[root] = group
        members += 1
        while head < tail and members < size:
            i = queue[head]
            head += 1
            for q in range(agent_start[i], agent_start[i + 1]):
                c = agent_cells[q]
                for p in range(cell_start[c], cell_start[c + 1]):
                    other = cell_agents[p]
                    if label[other] < 0 and members < size:
                        label[other] = group
                        members += 1
                        queue[tail] = other
                        tail += 1
        if members >= size:
            group += 1
            members = 0
    return label


def efforts_for(arrays: Arrays) -> tuple[Effort, ...]:
    """The windows that suit a problem, small ones first."""
    if not wait_anywhere(arrays):
        return EFFORTS
    return tuple(Effort(length, arcs * arrays.agents) for length, arcs in _WAITING_EFFORTS)
