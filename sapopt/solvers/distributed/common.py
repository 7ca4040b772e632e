"""What all distributed policies share: options, memory, and the rule for agents that cannot agree.

The rule
--------
Every task has exactly one *keeper*, the agent that may give it away: the agent that holds it, or held it last; before
anybody did, agent ``j mod n`` for task j. At each step the agents of a connected part of the network assign among
themselves the tasks whose keepers are in that part, and nothing else. An assigned task's new holder becomes its keeper.
Keepers are handed over only by agreement inside a part, so two parts never assign one task, however often the network
splits and heals. A dead agent keeps its task and all tasks that it is the keeper of. A part that does not come to an
agreement within the round limit keeps the tasks that it holds; all its agents know the round, so all of them do. An
agent that may not do the task it holds (the pair is forbidden at this step) takes the best of the other tasks that it
is itself the keeper of: nobody else can take those. If there is none, the step has no plan, and the run ends with an
`InfeasibleError` that says so; likewise if a part has no full assignment among the tasks that it keeps.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.distributed.faults import Faults
from sapopt.solvers.distributed.network import Network, Networks
from sapopt.solvers.distributed.simulator import Simulator, Traffic

log = logging.getLogger(__name__)

MAX_ROUNDS = 20_000
_HELD_BYTES = 4
_NO_TRAFFIC = Traffic()


@dataclass(frozen=True, eq=False)
class Memory:
    """What a distributed policy remembers between steps.

    Attributes
    ----------
    networks : Networks
    seed : int
        Of lost and late packets.
    held : ndarray of int64, shape (n,)
        Task that every agent may always fall back on.
    keeper : ndarray of int64, shape (m,)
        Agent that may give a task away.
    traffic : Traffic
        What the last step cost.
    extra : object
        The policy's own memory.
    """

    networks: Networks
    seed: int
    held: IntArray
    keeper: IntArray
    traffic: Traffic = _NO_TRAFFIC
    extra: Any = None


@dataclass(frozen=True, eq=False)
class Talks:
    """A policy whose agents exchange packets: tells the trace what every step cost (`sapopt.solvers.base.Talking`)."""

    def with_graph(self, graph: Any) -> Self:
        """The same policy with other links."""
        return replace(self, graph=graph)  # type: ignore[call-arg]  # a field of every subclass

    def record(self, memory: Memory) -> dict[str, int]:
        """Rounds, messages and bytes of the last step, and how many agents kept their task for want of agreement."""
        return asdict(memory.traffic)


@dataclass(frozen=True, eq=False)
class Scene:
    """One step as the agents find it.

    Attributes
    ----------
    network : Network
        What is left of the graph.
    simulator : Simulator
    component : ndarray of int64, shape (n,)
    open_tasks : ndarray of bool, shape (components, m)
        Tasks that a component may assign.
    dead : ndarray of bool, shape (n,)
    room : ndarray of int64, shape (m,), or None
        How many agents every task takes; None: one.
    """

    network: Network
    simulator: Simulator
    component: IntArray
    open_tasks: np.ndarray
    dead: np.ndarray
    room: IntArray | None = None

    def closed_prices(self, count: int) -> np.ndarray:
        """Starting prices of the agents, shape ``(count, m, n)``: zero, +inf for tasks they may not take."""
        start = np.where(self.open_tasks, 0.0, np.inf)[self.component].T
        return np.repeat(start[None], count, axis=0)


def check_options(epsilon: float | None, max_rounds: int, faults: Faults | None) -> None:
    """Raise a ValueError that names the option and the mend."""
    if epsilon is not None and not (np.isfinite(epsilon) and epsilon > 0):
        raise ValueError(f"epsilon must be a positive number (the least raise of a bid), got {epsilon!r}")
    if isinstance(max_rounds, bool) or int(max_rounds) != max_rounds or max_rounds < 1:
        raise ValueError(f"max_rounds must be a whole number of at least 1, got {max_rounds!r}")
    if faults is not None and not isinstance(faults, Faults):
        raise ValueError(f"faults must be a Faults(...), got {faults!r}")


def begin(problem: SAP, graph: Any, allow_disconnected: bool, faults: Faults | None, seed: int) -> Memory:
    """Memory before the first step; checks the graphs against the problem."""
    n, m = problem.n, problem.m
    if not problem.is_plain and (allow_disconnected or (faults is not None and faults.splits)):
        named = "allow_disconnected" if allow_disconnected else "faults"
        raise ValueError(
            f"{named}: with capacities, idleness, limits or teams all agents must hear each other, for a part that is "
            "cut off cannot know what the others use; leave it out"
        )
    networks = Networks(graph, n, problem.T)
    if faults is not None:
        faults.check(n)
    if not allow_disconnected:
        for step in networks.steps:
            parts = int(networks.at(step).components.max()) + 1
            if parts > 1:
                raise ValueError(
                    f"graph at step {step} is not connected ({parts} parts); pass allow_disconnected=True to let every "
                    "part assign the tasks that it keeps"
                )
    keeper = np.arange(m) % n
    held = np.minimum(np.arange(n), m - 1)
    if problem.initial_assignment is not None:
        held = problem.initial_assignment
        free = np.setdiff1d(np.arange(m), held)
        keeper[free] = np.arange(len(free)) % n
        keeper[held] = np.arange(n)
    return Memory(networks, seed, held, keeper)


def open_step(outlook: Outlook, memory: Memory, allow_disconnected: bool, faults: Faults | None) -> Scene:
    """Find who hears whom at this step and which tasks every part may assign."""
    n, m = outlook.problem.n, outlook.problem.m
    network = memory.networks.at(outlook.k)
    dead = np.zeros(n, dtype=bool)
    may_split = allow_disconnected
    if faults is not None:
        network = faults.at(outlook.k, network)
        dead = faults.dead_at(outlook.k, n)
        may_split |= faults.splits
    rng = np.random.default_rng([memory.seed, outlook.k])
    simulator = Simulator(network, faults, rng, outlook.check)
    component = network.components
    parts = int(component.max()) + 1
    room = None if outlook.problem.capacity is None else outlook.problem.capacity[outlook.k]
    if outlook.problem.rows.count:
        simulator.flood(np.full(n, _HELD_BYTES))  # from which everybody knows what is left of every limit
    if not may_split:
        return Scene(network, simulator, component, np.ones((1, m), dtype=bool), dead, room)
    # Nobody knows who is there before all agents of the part have told what they keep.
    simulator.flood(4 * np.bincount(memory.keeper, minlength=n))
    open_tasks = component[memory.keeper] == np.arange(parts)[:, None]
    open_tasks[component[dead]] = False
    open_tasks[component[dead], memory.held[dead]] = True
    return Scene(network, simulator, component, open_tasks, dead)


def fallback(outlook: Outlook, memory: Memory, agreed: np.ndarray) -> IntArray:
    """Tasks (n,) of agents whose part did not agree, by the rule of this module.

    Raises
    ------
    InfeasibleError
        If such an agent may do neither the task it holds nor another that it keeps.
    """
    tasks = memory.held.copy()
    k = outlook.k
    benefits = outlook.problem.benefits.slice(k, k + 1)
    for i in np.flatnonzero(~agreed & np.isneginf(benefits.at(tasks[None])[0])):
        kept = np.flatnonzero(memory.keeper == i)
        trials = np.repeat(memory.held[None], len(kept), axis=0)
        trials[:, i] = kept
        worth = np.array([benefits.at(trial[None])[0, i] for trial in trials])
        worth = worth + np.array([outlook.model.handover_at(k, outlook.state, trial)[i] for trial in trials])
        if not np.isfinite(worth).any():
            names = outlook.problem.naming
            raise InfeasibleError(
                f"{names.step(k)}: {names.agent(i)} may not do {names.task(tasks[i])}, which it holds, "
                "nor another that it keeps, and its part came to no agreement within max_rounds; raise max_rounds"
            )
        tasks[i] = kept[int(np.argmax(worth))]
    return tasks


def close_step(
    scene: Scene, memory: Memory, tasks: IntArray, agreed: np.ndarray, extra: Any = None
) -> Memory:
    """Memory after the step; `tasks` are the executed ones, `agreed` tells whose part came to an agreement."""
    held = np.bincount(tasks, minlength=len(memory.keeper))
    assert (held <= (1 if scene.room is None else scene.room)).all(), "more agents on a task than it takes"
    if not agreed.all():
        log.warning("%d agents keep their tasks: no agreement within the round limit", int((~agreed).sum()))
    keeper = memory.keeper.copy()
    keeper[tasks] = np.arange(len(tasks))
    # A held task that was given up and taken by nobody stays with its last holder: keepers change only with holders.
    traffic = scene.simulator.traffic(int((~agreed).sum()))
    return replace(memory, held=tasks, keeper=keeper, traffic=traffic, extra=extra)
