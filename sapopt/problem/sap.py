"""The sequential assignment problem."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.naming import Naming
from sapopt.data.times import checked_times
from sapopt.data.types import FloatArray, IntArray, index_array
from sapopt.dynamics.base import Dynamics, Model, checked_handover
from sapopt.dynamics.capabilities import adapt
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.problem.capacity import check_room, checked_capacity
from sapopt.problem.checking import check_forbidden, check_tasks, checked_initial, checked_labels
from sapopt.problem.core import made_core
from sapopt.problem.description import fingerprint
from sapopt.problem.files import read_problem, write_problem
from sapopt.problem.limit import Limit, Team, checked_limits
from sapopt.problem.limit_files import described_limits
from sapopt.problem.result import Evaluation
from sapopt.problem.row_reader import compiled
from sapopt.problem.rows import Rows, no_rows


class SAP:
    """A sequential assignment problem: n agents, m tasks, T steps, benefits that depend on the state.

    At each step every agent takes exactly one task and no task is taken twice; the value of a plan is the sum of the
    benefits and of the handover terms eta(s_k) of its pairs (thesis, eq. 1.3 and 3.4). Capacities, idleness, limits and
    teams change what a plan may be (docs/limits.md). Problems are immutable.

    Parameters
    ----------
    benefits : array_like of shape (T, n, m), list of T sparse matrices, or Benefits
        Static benefits, n <= m. ``-inf`` forbids a pair. Held sparse if at most half of the pairs are not zero,
        whatever form they come in (`Benefits.settled`).
    dynamics : Dynamics or float
        State model, for example ``SwitchingCost(0.5)``; a number is the cost of a `SwitchingCost`.
    initial_assignment : array_like of shape (n,), optional
        Task that every agent holds before the first step. None: the first step pays no handover. With ``idle=True``,
        -1 stands for none.
    capacity : int or array_like of int, shape (m,) or (T, m)
        How many agents may hold a task; 0 closes it. n may exceed m where the capacities allow it.
    idle : bool
        Whether an agent may hold nothing, -1 in plans: worth 0, and going idle is free. Taking up a task from idleness
        is a handover. A dynamics sees idleness as a further task, the last one, of zero benefit (so a matrix of costs
        needs a row and a column more; rules of `AgentLocal` say themselves what idling costs).
    limits : sequence of Limit and Team
        Limits on the whole plan, and rewards for holding a task together.
    agents, tasks : sequence of str, optional
        Labels for messages, tables, plots and reports.
    times : sequence of datetime, numpy.datetime64, number or str, optional
        When every step begins, ascending; texts are ISO 8601. For tables and for other programs: no value depends on
        them.

    Attributes
    ----------
    dynamics : Dynamics
        As it was passed.
    model : Model
        The same, bound to the benefits, with an answer to every question (`sapopt.dynamics.base.Model`). With
        ``idle=True`` its last task, ``m``, is idleness.
    capacity : ndarray of int64, shape (T, m), or None
        None where every task takes one agent.
    idle : bool
    limits : tuple of Limit and Team

    Raises
    ------
    ValueError
        If an argument has a wrong shape or value, or forbidden pairs leave a step without a full assignment.

    Examples
    --------
    >>> import numpy as np
    >>> problem = SAP(np.random.default_rng(0).random((6, 3, 4)), SwitchingCost(0.2))
    >>> problem
    SAP(T=6, n=3, m=4, SwitchingCost(cost=0.2, idle_is_free=False))
    """

    def __init__(
        self,
        benefits: Any,
        dynamics: Dynamics | float = 0.0,
        initial_assignment: Any = None,
        *,
        capacity: Any = 1,
        idle: bool = False,
        limits: Iterable[Limit | Team] = (),
        agents: Sequence[str] | None = None,
        tasks: Sequence[str] | None = None,
        times: Sequence[Any] | None = None,
    ) -> None:
        self.benefits = Benefits(benefits).settled()
        self.T, self.n, self.m = self.benefits.shape
        if not isinstance(idle, (bool, np.bool_)):
            raise ValueError(f"idle must be True or False, got {idle!r}")
        self.idle = bool(idle)
        self.capacity = checked_capacity(capacity, self.T, self.m)
        if not self.idle:
            check_room(self.capacity, self.T, self.n, self.m)
        if isinstance(dynamics, numbers.Real):
            dynamics = SwitchingCost(float(dynamics))
        self.dynamics = cast(Dynamics, dynamics)  # `adapt` checks that it is one
        self.agents = checked_labels(agents, self.n, "agents")
        self.tasks = checked_labels(tasks, self.m, "tasks")
        self.times = checked_times(times, self.T)
        self.initial_assignment = checked_initial(self, initial_assignment)
        self.limits = checked_limits(limits)
        self.rows: Rows = self._rows()
        self.core: SAP = self if self.is_plain else cast(SAP, made_core(self))
        self.model: Model = adapt(dynamics, self) if self.is_plain else self.core.model
        check_forbidden(self.core)

    @classmethod
    def with_idle_tasks(
        cls, benefits: Any, dynamics: Dynamics | float = 0.0, *args: Any, **kwargs: Any
    ) -> SAP:
        """Build a problem with one more task of zero benefit per agent, so that agents can idle (and n > m is allowed).

        The appended tasks have the indices ``m .. m + n - 1``; other arguments are those of `SAP`.
        """
        wide = Benefits(benefits).with_idle_tasks()
        labels = kwargs.get("tasks")
        if labels is not None:
            kwargs["tasks"] = [*labels, *(f"idle {i}" for i in range(wide.shape[1]))]
        return cls(wide, dynamics, *args, **kwargs)

    @classmethod
    def from_table(
        cls,
        table: Any,
        dynamics: Dynamics | float = 0.0,
        *,
        step: str = "step",
        agent: str = "agent",
        task: str = "task",
        benefit: str = "benefit",
        forbidden: str | None = None,
        missing: Literal["zero", "forbidden"] = "zero",
        agents: Sequence[str] | None = None,
        tasks: Sequence[str] | None = None,
        **options: Any,
    ) -> SAP:
        """Build a problem from a table in long form, with one row for each step, agent and task.

        Parameters
        ----------
        table : data frame, mapping of str to sequence, str or Path
            A data frame of pandas or polars, a table of pyarrow, a mapping of names to lists, or a CSV or Parquet file.
        dynamics : Dynamics or float
            As for `SAP`.
        step, agent, task, benefit : str
            Names of the columns. Steps are numbers or time stamps (texts are ISO 8601), and are sorted; there is one
            step for each that occurs. Agents and tasks are names, in order of appearance. A benefit of ``-inf``
            forbids the pair.
        forbidden : str, optional
            Name of a column of true and false: true forbids the pair, whatever its benefit.
        missing : {"zero", "forbidden"}
            What pairs without a row are: worth nothing, or forbidden.
        agents, tasks : sequence of str, optional
            Names in an order of your own, with those that no row mentions.
        **options
            ``initial_assignment``, ``capacity``, ``idle`` and ``limits`` of `SAP`. The first two may also be mappings:
            from agents to tasks, and from tasks to numbers (1 where a task is not mentioned).

        Returns
        -------
        SAP
            With labels, and with `times` unless the steps are 0, 1, 2, ...

        Raises
        ------
        ValueError
            If a column is missing, a row holds no value, or two rows say what one pair is worth; rows are counted
            from 0.

        Examples
        --------
        >>> table = {"step": [0, 0, 1], "agent": ["Ada", "Bo", "Bo"], "task": ["x", "y", "x"], "benefit": [3, 2, 1]}
        >>> SAP.from_table(table, SwitchingCost(0.5)).agents
        ('Ada', 'Bo')
        """
        from sapopt.exchange.problems import arguments

        names = {"step": step, "agent": agent, "task": task, "benefit": benefit, "forbidden": forbidden}
        return cls(dynamics=dynamics, **arguments(table, names, missing, agents, tasks, options))

    def __repr__(self) -> str:
        return f"SAP(T={self.T}, n={self.n}, m={self.m}, {self.dynamics!r})"

    @property
    def is_plain(self) -> bool:
        """Whether every agent takes one task, every task one agent, and nothing else is asked of a plan."""
        return self.capacity is None and not self.idle and not self.limits

    def initial_state(self) -> Any:
        """State before the first step."""
        return self.model.initial_state(self.core)

    def handover(self, k: int, state: Any) -> FloatArray:
        """Handover matrix eta(s_k), shape ``(n, m)``."""
        core = self.core
        return checked_handover(self.model.handover(k, state), k, self.n, core.m)[:, : self.m]

    def transition(self, k: int, state: Any, assignment: IntArray) -> Any:
        """State after `assignment` was held at step k."""
        return self.model.transition(k, state, self.placed(assignment) if self.idle else assignment)

    def placed(self, plan: IntArray) -> IntArray:
        """A plan or assignment with the last place of `core` for holding nothing, instead of -1."""
        return np.where(plan < 0, self.m, plan) if self.idle else plan

    def held_benefits(self, plan: IntArray) -> FloatArray:
        """Static benefit (T, n) of what every agent holds at every step of a plan; 0 for nothing."""
        return self.core.benefits.at(self.placed(plan))

    def unplaced(self, plan: IntArray) -> IntArray:
        """Undo `placed`."""
        return np.where(plan >= self.m, -1, plan) if self.idle else plan

    def beta_hat(self, k: int, state: Any) -> FloatArray:
        """State-dependent benefits of step k, shape ``(n, m)``: benefits plus handover matrix (thesis, section 3.1)."""
        return dense_step(self.benefits.step(k)) + self.handover(k, state)

    def evaluate(self, plan: Any) -> Evaluation:
        """Score a plan.

        Parameters
        ----------
        plan : array_like of int, shape (T, n)
            Task of every agent at every step.

        Returns
        -------
        Evaluation

        Raises
        ------
        ValueError
            If the plan has a wrong shape, a task out of range, a task given to more agents than may hold it, or a
            forbidden pair, or if it breaks a hard limit.
        """
        tasks = self.check_plan(plan)
        held, eta = self.terms(tasks)
        previous = (
            tasks[:-1]
            if self.initial_assignment is None
            else np.vstack([self.initial_assignment, tasks[:-1]])
        )
        changed = tasks[len(tasks) - len(previous) :] != previous
        handovers = int((changed & (tasks[len(tasks) - len(previous) :] >= 0)).sum())
        try:
            value = math.fsum(held.ravel()) + math.fsum(eta.ravel())
            score = Evaluation(
                value, held.sum(axis=1), eta.sum(axis=1), handovers,
                paid_handovers=int((eta < 0).sum()), switches=self._switches(tasks, held),
            )  # fmt: skip
            has_rows = bool(self.rows.count or len(self.rows.team_cell))
            return self._within_limits(score, self.placed(tasks)) if has_rows else score
        except OverflowError:
            raise ValueError("benefits and handovers are so large that their sum overflows") from None

    def terms(self, plan: IntArray) -> tuple[FloatArray, FloatArray]:
        """Benefit and handover (both (T, n)) of every agent at every step of a checked plan.

        Raises
        ------
        ValueError
            If a pair is forbidden.
        """
        places = self.placed(plan)
        held = self.core.benefits.at(places)
        eta = np.empty((self.T, self.n))
        state = self.initial_state()
        for k in range(self.T):
            eta[k] = self.model.handover_at(k, state, places[k])
            state = self.model.transition(k, state, places[k])
        forbidden = np.argwhere(~(np.isfinite(held) & np.isfinite(eta)))
        if len(forbidden):
            k, i = (int(x) for x in forbidden[0])
            raise ValueError(
                f"plan: {self.naming.agent(i)} may not take {self.naming.task(plan[k, i])} at {self.naming.step(k)} "
                "(the pair is forbidden)"
            )
        return held, eta

    @property
    def naming(self) -> Naming:
        """What messages call agents, tasks and steps."""
        return Naming(self.agents, self.tasks, self.times)

    def agent_label(self, i: int) -> str | int:
        """What agent i is called; its number if it has no name."""
        return i if self.agents is None else self.agents[i]

    def task_label(self, j: int) -> str | int:
        """What task j is called; its number if it has no name."""
        return j if self.tasks is None else self.tasks[j]

    def _switches(self, tasks: IntArray, held: FloatArray) -> int:
        """How often an agent goes on from one task that serves it to another, in a plan with its benefits (T, n)."""
        real = self.model.real_tasks(self.m)[tasks]  # whoever holds nothing (-1) has no benefit
        serves = held > 0
        return int((serves[1:] & serves[:-1] & (real[1:] != real[:-1])).sum())

    def _within_limits(self, score: Evaluation, places: IntArray) -> Evaluation:
        """A score with what limits and teams add to it, or a ValueError where a hard limit is broken."""
        rows, initial = self.rows, self.core.initial_assignment
        use = rows.use(places, initial)
        broken = rows.broken(places, initial, use, self.naming)
        if broken:
            raise ValueError(f"plan: {broken}")
        cost, earned = rows.cost(use), rows.earned(places)
        value = score.value + math.fsum(earned) - math.fsum(cost)
        return replace(score, value=value, limits=rows.uses(use), teams=math.fsum(earned))

    def check_plan(self, plan: Any) -> IntArray:
        """The plan as an int64 array, or a ValueError that says what is wrong with it."""
        tasks = index_array(plan, "plan")
        if tasks.shape != (self.T, self.n):
            raise ValueError(f"plan must have shape (T, n) = {(self.T, self.n)}, got {tasks.shape}")
        check_tasks(self, tasks, 0)
        return tasks

    def check_assignment(self, assignment: Any, k: int) -> IntArray:
        """The assignment of step k as an int64 array, or a ValueError that says what is wrong with it."""
        tasks = index_array(assignment, f"assignment at step {k}")
        if tasks.shape != (self.n,):
            raise ValueError(f"assignment at step {k} must have shape (n,) = ({self.n},), got {tasks.shape}")
        check_tasks(self, tasks[None], k)
        return tasks

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of everything that decides the value of a plan; equal for dense and sparse forms of one problem.

        A user-defined dynamics tells what decides it by a method ``fingerprint()``: `sapopt.dynamics.base.Dynamics`.

        Raises
        ------
        ValueError
            If the dynamics is user-defined and does not tell.
        """
        shape = (self.T, self.n, self.m)
        meta, arrays = described_limits(self.limits)
        if self.capacity is not None:
            arrays["capacity"] = self.capacity
        if self.idle:
            meta["idle"] = True
        return fingerprint(
            shape, self.benefits.flat(), self.initial_assignment, self.dynamics, (meta, arrays)
        )

    def save(self, path: str | Path) -> None:
        """Write the problem to an ``.npz`` file (sparse or dense, as it is).

        A dynamics of a user's own class is written as data: the class' import path, its fingerprint, and, where all the
        fields of a dataclass are numbers, texts and arrays, those. The class itself has to be handed over to `load`.

        Raises
        ------
        ValueError
            If the dynamics is user-defined and has no method ``fingerprint()``.
        """
        write_problem(self, path)

    def write(self, path: str | Path) -> None:
        """Write the problem as a mixed-integer programme for other solvers, with readable names.

        The programme is that of the agents' paths (`sapopt.formulations.limited.graph`), with all capacities, limits
        and teams: its optimum is that of the problem. Variables are called ``take__AGENT__TASK__STEP`` (take up a task
        at a step, 0-based), ``stay__...`` (hold it on) and ``leave__...``; where agents have states,
        ``hold__...``. An existing file is replaced.

        Parameters
        ----------
        path : str or Path
            ``.lp`` (CPLEX LP) or ``.mps`` (free MPS; a maximum, with ``OBJSENSE``).

        Raises
        ------
        ValueError
            If the suffix is another one, the dynamics is not agent-local, or the programme would be too large.
        """
        from sapopt.exchange.programmes import write_programme

        write_programme(self, path)

    @classmethod
    def load(cls, path: str | Path, dynamics: Any = None) -> SAP:
        """Read a problem written by `save`.

        Parameters
        ----------
        path : str or Path
        dynamics : type or Dynamics, optional
            For a dynamics of a user's own: the class, or an object of it where the class cannot be made anew from what
            was written. It must tell the fingerprint that was written. A file never brings code, and nothing that it
            names is imported.

        Raises
        ------
        ValueError
            If the file is damaged or holds something else, or the dynamics is missing or another one.
        """
        return cls(**read_problem(path, dynamics))

    def _rows(self) -> Rows:
        if not self.limits:
            return no_rows((self.T, self.n, self.m + self.idle), self.m if self.idle else -1)
        return compiled(
            self.limits,
            self.benefits,
            self.idle,
            self.initial_assignment,
            self.agents,
            self.tasks,
            self.capacity,
        )
