"""A session: one decision after another, while agents and tasks come and go."""

from __future__ import annotations

import logging
import numbers
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.dynamics.base import Dynamics
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.live.benefits import arranged, read_benefits
from sapopt.live.deciding import decided
from sapopt.live.decision import Assignment, Decision
from sapopt.live.empty import NO_TASK, is_empty, without_agents, without_tasks
from sapopt.live.limits import session_limits
from sapopt.live.names import Name, checked_name, checked_names
from sapopt.live.saving import loaded, saved
from sapopt.live.thinking import Pace
from sapopt.live.warming import run_warm
from sapopt.live.window import DynamicsOf, Settings, Standing
from sapopt.problem.limit import Team
from sapopt.running.outlook import Policy
from sapopt.solvers.base import Extended

log = logging.getLogger(__name__)


class Session:
    """Decide step by step for a system that runs: forecasts arrive, agents fail, tasks appear, the answer is due.

    At every step the session is given the benefits of the next few steps, with the ids of the agents and tasks that
    there are now, and answers with an assignment. Between the calls it remembers, by id, what every agent holds, its
    state (such as its charge), the prices of the tasks where the policy works with prices, what was announced, and how
    much of each limit is used. It may be used from several threads; their calls are answered one after another.

    Parameters
    ----------
    policy : Policy
        Decides a step: `DualLookahead`, `HAAL`, `HAA`, an `AssignmentPolicy`, one of your own. It sees a window as a
        problem whose step 0 begins now.
    dynamics : Dynamics, float, or callable
        As in `SAP`. One that depends on time, or has parameters by agent or task, is given as a function
        ``dynamics(step, agents, tasks)`` that returns the one for a window: `step` counts the calls from 0 on, and the
        ids come in the order in which the window has them.
    idle : bool
        Whether an agent may hold nothing, see `SAP`.
    capacity : int, or dict of task id to int
        How many agents a task takes; tasks that a dictionary does not name take one.
    limits : sequence of Limit and Team
        `Limit.once`, `Limit.work` and `Limit.handovers` with ``at_most``, `Limit.cover`, and `Team`. They name ids, and
        what is used so far counts. Other limits are refused: they speak of a first and a last step.
    announce : int
        Steps that every decision announces, the one that begins now among them.
    change_cost : float
        Cost of every announced pair that is not kept although its task is still there and still worth something.
    holding : dict of agent id to task id, optional
        What is held before the first call. Without it, the first call charges no handover.
    prove : bool
        Whether decisions come with the bound of their window.
    seed : int
        Of everything random in the policy.

    Raises
    ------
    ValueError
        If an argument is of a wrong kind or value.

    Notes
    -----
    An agent that was not there at the call before has the dynamics' initial state. An agent whose task is there no more
    holds nothing, like a new one; whatever it takes up then is a handover. Whoever is left out has failed: its task is
    free at once, and if it comes back it is new.

    A policy remembers something between two calls only if it is a `sapopt.running.outlook.Carrying` one; others begin
    anew each time, so a session that was saved goes on exactly as it would have.

    Examples
    --------
    >>> from sapopt import Session, SwitchingCost
    >>> from sapopt.solvers import DualLookahead
    >>> session = Session(DualLookahead(2), SwitchingCost(0.5))
    >>> window = [[[1.0, 0.2], [0.9, 0.8]], [[0.9, 0.3], [0.1, 0.9]]]
    >>> session.step(window, agents=["north", "south"], tasks=["port", "field"]).assignment
    {'north': 'port', 'south': 'field'}
    >>> session.step([[[1.0, 0.6]]], agents=["south"], tasks=["field", "bridge"]).assignment
    {'south': 'field'}
    """

    def __init__(
        self,
        policy: Policy,
        dynamics: Dynamics | DynamicsOf | float = 0.0,
        *,
        idle: bool = False,
        capacity: int | Mapping[Name, int] = 1,
        limits: Any = (),
        announce: int = 1,
        change_cost: float = 0.0,
        holding: Mapping[Name, Name] | None = None,
        prove: bool = True,
        seed: int = 0,
    ) -> None:
        if isinstance(policy, type) or not isinstance(policy, Policy):
            raise ValueError(
                f"policy must decide step by step, such as DualLookahead(6) or HAA(), got {policy!r}; planners such as "
                "Exact see a whole horizon"
            )
        if isinstance(dynamics, numbers.Real):
            dynamics = SwitchingCost(float(dynamics))
        if isinstance(dynamics, type) or not (isinstance(dynamics, Dynamics) or callable(dynamics)):
            raise ValueError(
                f"dynamics must be a dynamics, a cost, or a function (step, agents, tasks), got {dynamics!r}"
            )
        for name, value in (("idle", idle), ("prove", prove)):
            if not isinstance(value, (bool, np.bool_)):
                raise ValueError(f"{name} must be True or False, got {value!r}")
        for name, count, least in (("announce", announce, 1), ("seed", seed, 0)):
            if isinstance(count, bool) or not isinstance(count, numbers.Integral) or count < least:
                raise ValueError(f"{name} must be a whole number of at least {least}, got {count!r}")
        self._settings = Settings(
            policy, dynamics, bool(idle), _checked_capacity(capacity), session_limits(limits), int(announce),
            _number(change_cost, "change_cost"), _checked_holding(holding), bool(prove), int(seed),
        )  # fmt: skip
        _check_taken(self._settings)
        self._standing = Standing()
        self._lock = threading.Lock()
        self._pace = Pace()

    def __repr__(self) -> str:
        standing = self._standing
        return (
            f"Session({self._settings.policy.name}, {self._settings.dynamics!r}, step={standing.step}, "
            f"{len(standing.agents)} agents, {len(standing.tasks)} tasks)"
        )

    @property
    def steps(self) -> int:
        """Calls answered so far."""
        return self._standing.step

    @property
    def assignment(self) -> Assignment:
        """What every agent holds since the last call."""
        standing = self._standing
        if standing.held is None:
            return dict(self._settings.holding)
        names = (*standing.tasks.names, None)
        return {
            agent: names[j] for agent, j in zip(standing.agents.names, standing.held.tolist(), strict=True)
        }

    @property
    def announced(self) -> tuple[Assignment, ...]:
        """What is announced for the steps to come."""
        return self._standing.announced

    def step(
        self,
        benefits: Any,
        *,
        agents: Any = None,
        tasks: Any = None,
        budget_s: float | None = None,
        frozen: Any = None,
        ends: bool = False,
    ) -> Decision:
        """Decide the step that begins now.

        Parameters
        ----------
        benefits : array_like of shape (W, n, m), list of W sparse matrices, or Benefits
            What each pair is worth at this step and the next ones, as far as is known today. W may change from call to
            call. -inf forbids a pair.
        agents, tasks : sequence of str or int
            The ids of the rows and the columns, each once, in any order; 0, 1, ... if left out. There may be none:
            without agents (``agents=[]``) nothing is decided, without tasks (``tasks=[]``) all agents idle if they may.
        budget_s : float, optional
            Seconds until the answer. The policy thinks as long as there is time; if it has no answer by then that is
            better over the window, the best assignment of this step (`HAA`) is played. It alone may take longer than a
            budget that is too small for it. Kernels that still have to be compiled take longer too: `warm`.
        frozen : int, dict, or list of dict, optional
            First steps that may not change: so many of those announced; or a task (None: nothing) by agent, for this
            step or for as many as the list has. Agents that are not named may choose. Of what was announced, pairs
            whose agent or task is gone are free.
        ends : bool
            Whether nothing follows the window; else states at its end, such as charges, keep a value.

        Returns
        -------
        Decision

        Raises
        ------
        ValueError
            If an argument is wrong, or the agents cannot all be given a task. Then the session is what it was.
        """
        began = time.perf_counter()
        budget = None if budget_s is None else _number(budget_s, "budget_s")
        if not isinstance(ends, (bool, np.bool_)):
            raise ValueError(f"ends must be True or False, got {ends!r}")
        with self._lock:
            decision, self._standing = self._answered(
                self._standing, benefits, agents, tasks, frozen, bool(ends), began, budget
            )
        return replace(decision, seconds=time.perf_counter() - began)

    def _answered(
        self,
        standing: Standing,
        values: Any,
        agents: Any,
        tasks: Any,
        frozen: Any,
        ends: bool,
        began: float,
        budget: float | None,
    ) -> tuple[Decision, Standing]:
        """The decision of a call, and what the session carries on."""
        if is_empty(agents):
            return without_agents(self._settings, standing, values, tasks)
        if is_empty(tasks):
            values, tasks = without_tasks(values, self._settings.idle), [NO_TASK]
        benefits: Benefits = read_benefits(values, agents, tasks)
        _, n, m = benefits.shape
        given_agents, given_tasks = checked_names(agents, n, "agents"), checked_names(tasks, m, "tasks")
        now_agents, now_tasks = standing.agents.updated(given_agents), standing.tasks.updated(given_tasks)
        place_agent = {name: place for place, name in enumerate(given_agents)}
        place_task = {name: place for place, name in enumerate(given_tasks)}
        benefits = arranged(
            benefits,
            np.array([place_agent[name] for name in now_agents.names]),
            np.array([place_task[name] for name in now_tasks.names]),
        )
        return decided(
            self._settings,
            standing,
            now_agents,
            now_tasks,
            benefits,
            frozen,
            ends,
            began,
            budget,
            self._pace,
        )

    def warm(
        self, benefits: Any = None, *, agents: Any = None, tasks: Any = None, budget_s: float | None = None
    ) -> float:
        """Compile everything that the first decisions will need, and leave the session as it is.

        Parameters
        ----------
        benefits : array_like of shape (W, n, m), list of W sparse matrices, or Benefits, optional
            Like those that will come; made up if left out, with a few tasks in sight of every agent.
        agents, tasks : sequence of str or int, or int
            The ids, or how many there will be.
        budget_s : float, optional
            That of the steps to come, which then is tried as well.

        Returns
        -------
        float
            Seconds that it took; the log says so as well.
        """
        began = time.perf_counter()
        run_warm(self._twin(), benefits, agents, tasks, budget_s)
        seconds = time.perf_counter() - began
        log.info("the session is warm: %.1f s went into compiling and trying", seconds)
        return seconds

    def _twin(self) -> Session:
        """A session like this one that has not begun."""
        return self._of(replace(self._settings, holding={}), Standing(), self._pace)

    @classmethod
    def _of(cls, settings: Settings, standing: Standing, pace: Pace) -> Session:
        """A session that stands where `standing` says."""
        out = cls.__new__(cls)
        out._settings, out._standing, out._lock, out._pace = settings, standing, threading.Lock(), pace
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy, also in another process, stands where this one stands now and goes its own way."""
        with self._lock:
            return self._of, (self._settings, self._standing, Pace())

    def save(self, path: str | Path) -> None:
        """Write all that the session carries to a file, whole or not at all.

        Policies and dynamics of your own are not written, as files hold data and never code: hand them to `load`.

        Raises
        ------
        ValueError
            If the state of the dynamics cannot be taken apart by agents (`sapopt.dynamics.base.Model.agent_columns`).
        """
        with self._lock:
            standing = self._standing
        saved(path, self._settings, standing)

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        policy: Policy | None = None,
        dynamics: Dynamics | type[Dynamics] | DynamicsOf | None = None,
    ) -> Session:
        """A session that goes on where the saved one stood.

        Parameters
        ----------
        path : str or Path
        policy, dynamics : optional
            Those that the session was made with, where they are not of sapopt itself. For a dynamics of your own with
            a ``fingerprint()`` the class is enough if it is a dataclass of numbers, texts and arrays: the file holds
            its parameters, and one that tells another fingerprint is refused.

        Raises
        ------
        ValueError
            If the file is damaged or something else, or a policy or dynamics is needed and not given.
        """
        return cls._of(*loaded(path, policy, dynamics), Pace())


def _check_taken(settings: Settings) -> None:
    """Refuse what the policy does not take."""
    teams = [limit for limit in settings.limits if isinstance(limit, Team)]
    asked = {"capacity": settings.capacity != 1, "idle": settings.idle, "teams": bool(teams),
             "limits": len(settings.limits) > len(teams)}  # fmt: skip
    takes = settings.policy.takes if isinstance(settings.policy, Extended) else frozenset()
    lacking = [name for name, is_asked in asked.items() if is_asked and name not in takes]
    if lacking:
        raise ValueError(
            f"policy: {settings.policy.name} does not take {' and '.join(lacking)}; DualLookahead does"
        )


def _number(value: Any, name: str) -> float:
    if (
        isinstance(value, (bool, np.bool_))
        or not isinstance(value, numbers.Real)
        or not 0 <= float(value) < np.inf
    ):
        raise ValueError(f"{name} must be a finite number that is not negative, got {value!r}")
    return float(value)


def _checked_capacity(capacity: Any) -> int | dict[Name, int]:
    if isinstance(capacity, Mapping):
        return {checked_name(name, "capacity"): _whole(count) for name, count in capacity.items()}
    return _whole(capacity)


def _whole(count: Any) -> int:
    if isinstance(count, (bool, np.bool_)) or not isinstance(count, numbers.Integral) or count < 0:
        raise ValueError(f"capacity must be a whole number of at least 0, or one by task id, got {count!r}")
    return int(count)


def _checked_holding(holding: Any) -> dict[Name, Name]:
    if holding is None:
        return {}
    if not isinstance(holding, Mapping):
        raise ValueError(f"holding must be a task id by agent id, got {holding!r}")
    return {checked_name(agent, "holding"): checked_name(task, "holding") for agent, task in holding.items()}
