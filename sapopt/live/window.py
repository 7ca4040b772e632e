"""The next steps of a session as a problem, with the state that its agents bring along."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import AgentColumns, Dynamics, Model
from sapopt.live.decision import Assignment
from sapopt.live.limits import Used, limits_left
from sapopt.live.names import Name, Roster
from sapopt.problem.limit import Limit, Team
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Policy

DynamicsOf = Callable[[int, tuple[Name, ...], tuple[Name, ...]], Dynamics]
"""``dynamics(step, agents, tasks)``: the dynamics of the window that begins at a step, for the ids in this order."""


@dataclass(frozen=True, eq=False)
class Settings:
    """What a session was made with; see `sapopt.live.session.Session`."""

    policy: Policy
    dynamics: Dynamics | DynamicsOf
    idle: bool
    capacity: int | dict[Name, int]
    limits: tuple[Limit | Team, ...]
    announce: int
    change_cost: float
    holding: dict[Name, Name]
    prove: bool
    seed: int


@dataclass(frozen=True, eq=False)
class Standing:
    """Everything that a session carries from call to call. Never changed: a call that is refused leaves no trace.

    Attributes
    ----------
    step : int
        Calls answered so far.
    agents, tasks : Roster
        Of the last call.
    held : ndarray of int64, shape (n,), or None
        Task of every agent after the last call, -1 for none; None before the first one.
    state : object
        State after the last call, as its model knows it.
    columns : AgentColumns or None
        The same by agents; idleness, where there is some, is the task after the last.
    memory : object
        Of the policy.
    rows : tuple of str
        Rows of the limits that the memory knows.
    decided : int
        Step whose decision the memory belongs to.
    announced : tuple of dict
        What is announced for the steps from `step` on.
    used : dict
        Use of the limits.
    prices : ndarray, shape (steps, m), or None
        Of tasks, for bounds, where the policy has none; the first row is that of the last call.
    """

    step: int = 0
    agents: Roster = field(default_factory=Roster)
    tasks: Roster = field(default_factory=Roster)
    held: IntArray | None = None
    state: Any = None
    columns: AgentColumns | None = None
    memory: Any = None
    rows: tuple[str, ...] = ()
    decided: int = -1
    announced: tuple[Assignment, ...] = ()
    used: Used = field(default_factory=dict)
    prices: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Kept:
    """Announced pairs that are still there and worth something, all shape (pairs,)."""

    step: IntArray
    agent: IntArray
    task: IntArray

    def at(self, k: int) -> tuple[IntArray, IntArray]:
        """Agents and tasks of one step."""
        here = self.step == k
        return self.agent[here], self.task[here]


@dataclass(frozen=True, eq=False)
class Window:
    """The next steps as a problem.

    Attributes
    ----------
    core : SAP
        A core (`SAP.core`) whose benefits contain a reward for keeping what was announced.
    truth : SAP
        The same without that reward.
    state : object
        State before the first step.
    held : ndarray of int64, shape (n,), or None
        Task of every agent before it, -1 for none.
    agents, tasks : Roster
    kept : Kept
    """

    core: SAP
    truth: SAP
    state: Any
    held: IntArray | None
    agents: Roster
    tasks: Roster
    kept: Kept

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.core.T

    @property
    def idle_place(self) -> int:
        """The place of holding nothing, -1 if agents always hold something."""
        return self.core.rows.idle

    @cached_property
    def blank(self) -> SAP:
        """The core without what is held before it."""
        out = copy.copy(self.core)
        out.initial_assignment = None
        return out

    def placed(self, tasks: IntArray) -> IntArray:
        """Tasks (-1: none) as places of the core; stays -1 where nobody may idle."""
        return np.where(tasks < 0, self.idle_place, tasks)

    def unplaced(self, places: IntArray) -> IntArray:
        """Undo `placed`."""
        return np.where(places >= len(self.tasks), -1, places)

    def named(self, places: IntArray) -> Assignment:
        """An assignment by ids."""
        names = (*self.tasks.names, None)
        return {
            agent: names[j]
            for agent, j in zip(self.agents.names, self.unplaced(places).tolist(), strict=True)
        }


def made_window(
    settings: Settings, standing: Standing, agents: Roster, tasks: Roster, benefits: Benefits
) -> Window:
    """The window of a call.

    Parameters
    ----------
    settings : Settings
    standing : Standing
        What is carried along; its agents and tasks may be others.
    agents, tasks : Roster
    benefits : Benefits
        In the order of these.

    Raises
    ------
    ValueError
        If the benefits do not fit the settings, or the state cannot be carried to other agents and tasks.
    """
    dynamics = settings.dynamics
    if not isinstance(dynamics, Dynamics):
        dynamics = dynamics(standing.step, agents.names, tasks.names)
    kept = _kept(standing, agents, tasks, benefits) if settings.change_cost else _NONE_KEPT
    limits = limits_left(settings.limits, standing.used, agents, tasks)
    options: dict[str, Any] = {"idle": settings.idle, "limits": limits,
                               "capacity": _capacity(settings.capacity, tasks)}  # fmt: skip
    if limits:
        options |= {
            "agents": [str(name) for name in agents.names],
            "tasks": [str(name) for name in tasks.names],
        }
    try:
        truth = SAP(benefits, dynamics, **options).core
        core = truth if not len(kept.step) else SAP(_rewarded(benefits, kept, settings.change_cost), dynamics,
                                                     **options).core  # fmt: skip
    except ValueError as error:
        raise ValueError(with_names(str(error), agents, tasks)) from None
    state, held = _brought_along(settings, standing, agents, tasks, core)
    for problem in {id(core): core, id(truth): truth}.values():
        problem.initial_assignment = None if held is None else np.where(held < 0, problem.rows.idle, held)
        problem.rows = replace(problem.rows, first_counts=held is not None)
    return Window(core, truth, state, held, agents, tasks, kept)


def with_names(message: str, agents: Roster, tasks: Roster) -> str:
    """A message about indices with the ids instead: ``agent 3`` becomes ``agent 'sat 7'``."""

    def put(match: re.Match[str]) -> str:
        names = (agents if match[1] == "agent" else tasks).names
        numbers = [int(number) for number in re.findall(r"\d+", match[3])]
        if any(number >= len(names) for number in numbers):
            return match[0]
        return f"{match[1]}{match[2]} {', '.join(repr(names[number]) for number in numbers)}"

    return re.sub(r"\b(agent|task)(s?) (\d+(?:, \d+)*)\b", put, message)


_NONE_KEPT = Kept(*(np.zeros(0, dtype=np.int64) for _ in range(3)))


def _kept(standing: Standing, agents: Roster, tasks: Roster, benefits: Benefits) -> Kept:
    """The announced pairs of a window that count."""
    found = [
        (k, agents.index[agent], tasks.index[task])
        for k, announced in enumerate(standing.announced[: benefits.shape[0]])
        for agent, task in announced.items()
        if task is not None and agent in agents.index and task in tasks.index
    ]
    if not found:
        return _NONE_KEPT
    step, agent, task = np.array(found, dtype=np.int64).T
    worth = np.zeros(len(step))
    for k in np.unique(step):
        here = step == k
        plan = np.zeros((1, len(agents)), dtype=np.int64)
        plan[0, agent[here]] = task[here]
        worth[here] = benefits.slice(int(k), int(k) + 1).at(plan)[0, agent[here]]
    good = worth > 0
    return Kept(step[good], agent[good], task[good])


def _rewarded(benefits: Benefits, kept: Kept, reward: float) -> Benefits:
    """Benefits with a reward on pairs of positive benefit, so that no sign changes."""
    _, n, m = benefits.shape
    if not benefits.is_sparse:
        dense = benefits.dense().copy()
        dense[kept.step, kept.agent, kept.task] += reward
        return Benefits(dense)
    flat = benefits.flat()
    rows = np.repeat(np.arange(len(flat.indptr) - 1), np.diff(flat.indptr))
    data = flat.data.copy()
    data[np.searchsorted(rows * m + flat.indices, (kept.step * n + kept.agent) * m + kept.task)] += reward
    return Benefits.from_flat(flat.indptr, flat.indices, data, benefits.shape)


def _capacity(capacity: int | Mapping[Name, int], tasks: Roster) -> Any:
    if isinstance(capacity, int):
        return capacity
    return np.array([capacity.get(name, 1) for name in tasks.names], dtype=np.int64)


def _brought_along(
    settings: Settings, standing: Standing, agents: Roster, tasks: Roster, core: SAP
) -> tuple[Any, IntArray | None]:
    """State and held tasks before a window."""
    if standing.held is None:
        held = None
        if settings.holding:
            before = [settings.holding.get(name) for name in agents.names]
            held = np.array([-1 if task is None else tasks.index.get(task, -1) for task in before])
            core.initial_assignment = np.where(held < 0, core.rows.idle, held)
        return core.model.initial_state(core), held
    was = agents.places(standing.agents)
    place = np.append(standing.tasks.places(tasks), -1)  # of a former task; idleness and nothing are the last
    old = was >= 0
    held = np.full(len(agents), -1)
    held[old] = place[standing.held[was[old]]]
    columns = standing.columns
    if columns is None:
        if agents is not standing.agents or tasks is not standing.tasks:
            raise ValueError(
                f"dynamics: agents or tasks come and go, and {core.model.called} does not say what of its state goes "
                "with an agent; define agent_columns(state) and of_columns(columns) (sapopt.dynamics.base.Model)"
            )
        return standing.state, held
    none = core.rows.idle
    fresh = _fresh(core, columns, len(agents))
    new = AgentColumns({}, {})
    for name, values in fresh.values.items():
        new.values[name] = values.copy()
        new.values[name][old] = columns.values[name][was[old]]
    for name, values in fresh.tasks.items():
        new.tasks[name] = values.copy()
        new.tasks[name][old] = place[np.minimum(columns.tasks[name], len(standing.tasks))[was[old]]]
        new.tasks[name][new.tasks[name] < 0] = none
    return core.model.of_columns(new), held


def _fresh(core: SAP, carried: AgentColumns, n: int) -> AgentColumns:
    """The columns of agents that are all new."""
    model: Model = core.model
    fresh = model.agent_columns(model.initial_state(core))
    if fresh is None:  # a first step that is free has no columns; in a session that goes on none is
        core.initial_assignment = np.full(n, core.rows.idle)
        fresh = model.agent_columns(model.initial_state(core))
        core.initial_assignment = None
    if (
        fresh is None
        or fresh.tasks.keys() != carried.tasks.keys()
        or fresh.values.keys() != carried.values.keys()
    ):
        raise ValueError(
            f"dynamics: agent_columns of {model.called} must have the same columns at every step"
        )
    return fresh
