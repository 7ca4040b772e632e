"""Handover-aware assignment with lookahead: HAAL, and its special case HAA."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import value_of
from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Change, Outlook
from sapopt.solvers.base import EXTRAS, check_lookahead
from sapopt.solvers.haal_tree import CompiledTree

Parking = Literal["lowest", "lookahead"]
_TIE = 1e-12
_PARKING_STEPS = 6


class Solved(NamedTuple):
    """An interval: the assignment that is held over it, what that brings, and the state it leads to."""

    tasks: IntArray
    value: float
    after: Any


@dataclass
class HAALMemory:
    """What HAAL remembers: solved intervals, valid as long as the benefits it sees are the same.

    Attributes
    ----------
    windows : object
        Source of the benefits the intervals were solved for.
    tree : CompiledTree, optional
        Holds the intervals of a sparse problem with one switching cost.
    solved : dict
        Those of other problems: ``(start, stop, state key) -> Solved``.
    kept : list of ndarray
        Unexecuted rest of the last plan, for ``keep_plan``.
    uncompiled : bool
        The compiled search met an interval it cannot solve, and is not tried again.
    assignment_problems : int
        Assignment problems solved so far.
    """

    windows: Any = None
    tree: CompiledTree | None = None
    solved: dict[tuple[int, int, Any], Solved] = field(default_factory=dict)
    kept: list[IntArray] = field(default_factory=list)
    uncompiled: bool = False
    assignment_problems: int = 0


@dataclass(frozen=True)
class HAAL:
    """Handover-aware assignment with lookahead (thesis, Algorithm 2).

    At every step all ways to cut the next L steps into intervals are tried. An interval is one assignment problem over
    the sum of its benefits plus the handover from the state before it (line 9). A sequence is worth what it brings when
    it is played step by step, with the state moving at every step (lines 11 and 12). The first assignment of the best
    sequence is executed. Sequences that begin alike share their first intervals, so 2^L - 1 assignment problems
    suffice, fewer where different sequences lead to the same state; intervals solved at one step are remembered for the
    next.

    For sparse benefits and one switching cost the search is compiled and also skips last intervals that provably
    cannot matter, see `sapopt.kernels.tree`. It holds up to 2^L states a step; where they would take more than 512 MiB
    (from L = 15 on with 324 agents, from L = 11 on with 10 000), for other dynamics, and where an idle agent finds no
    task, the search runs in Python, with the same result.

    Of equal sequences the one with the shortest first interval is taken, then with the shortest second one, and so on.

    Parameters
    ----------
    lookahead : int
        L >= 1; the window at step k is ``k .. min(k + L, T) - 1``.
    parking : {"lowest", "lookahead"}
        Where idle agents wait, a free choice among assignments of equal benefit. "lowest": the lowest-numbered free
        tasks (the reference). "lookahead": the free tasks with the least total benefit over the next steps, so that
        nobody blocks a task that will soon be wanted; reads up to 6 steps, past the window if it is shorter.
    keep_plan : bool
        HAAL+: the unexecuted rest of the plan of the step before, with one more step assigned by alpha(beta_hat),
        competes with the new sequences. This restores the c / (1 + c) guarantee, which Algorithm 2 loses for L >= 3
        because every interval is solved for itself (docs/theorem.md). The search is not compiled.
    exact_intervals : bool
        Not in the thesis: choose an interval's assignment by what every pair really yields over it, handovers and
        states on the way counted, where the dynamics can tell (`Battery` and all rules of `AgentLocal`). Elsewhere, and
        for `SwitchingCost`, this changes nothing.

    References
    ----------
    J. Holder, MSc thesis, University of Washington, 2024, section 3.3.
    """

    lookahead: int = 3
    parking: Parking = "lowest"
    keep_plan: bool = False
    exact_intervals: bool = False

    def __post_init__(self) -> None:
        check_lookahead(self.lookahead)
        for name in ("keep_plan", "exact_intervals"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name} must be True or False, got {getattr(self, name)!r}")
        if self.parking not in ("lowest", "lookahead"):
            raise ValueError(f"parking must be 'lowest' or 'lookahead', got {self.parking!r}")

    takes: ClassVar[frozenset[str]] = EXTRAS
    """Of what a problem may ask for; limits as `sapopt.running.steps` says."""

    @property
    def name(self) -> str:
        """Name with options."""
        suffix = "" if self.parking == "lowest" else ", parking=lookahead"
        suffix += ", exact intervals" if self.exact_intervals else ""
        return f"HAAL{'+' if self.keep_plan else ''}(L={self.lookahead}{suffix})"

    @property
    def keeps_guarantee(self) -> bool:
        """Whether the c / (1 + c) theorem holds for it (docs/theorem.md); a subclass may decide otherwise."""
        if type(self) is not HAAL:
            return False
        # With exact intervals a lookahead of 2 is another algorithm than the one the proof is about.
        return self.keep_plan or self.lookahead == 1 or (self.lookahead == 2 and not self.exact_intervals)

    def begin(self, problem: SAP, rng: np.random.Generator) -> HAALMemory:
        """Empty memory."""
        return HAALMemory()

    def carried(self, memory: HAALMemory, change: Change) -> HAALMemory:
        """The rest of the plan, where all of its agents and tasks are still there; benefits count as new ones."""
        place = np.full(int(max(change.tasks.max(initial=-1), *(k.max() for k in memory.kept), -1)) + 2, -1)
        place[change.tasks] = np.arange(len(change.tasks))
        place[-1] = -1
        kept = [place[tasks[change.agents]] for tasks in memory.kept[max(change.steps - 1, 0) :]]
        whole = change.steps >= 1 and change.agents.min() >= 0 and all(tasks.min() >= 0 for tasks in kept)
        return HAALMemory(kept=kept if whole else [], assignment_problems=memory.assignment_problems)

    def stored(self, memory: HAALMemory) -> dict[str, np.ndarray]:
        """The rest of the plan and the count of assignment problems."""
        count = {"assignment_problems": np.array(memory.assignment_problems)}
        return count | ({"kept": np.stack(memory.kept)} if memory.kept else {})

    def restored(self, arrays: dict[str, np.ndarray]) -> HAALMemory:
        """The memory of `stored`."""
        kept = [tasks.astype(np.int64) for tasks in arrays.get("kept", [])]
        return HAALMemory(kept=kept, assignment_problems=int(arrays["assignment_problems"]))

    def record(self, memory: HAALMemory) -> dict[str, int]:
        """For the trace: assignment problems solved so far."""
        return {"assignment_problems": memory.assignment_problems}

    def act(self, outlook: Outlook, memory: HAALMemory) -> tuple[IntArray, HAALMemory]:
        """Execute the first assignment of the best sequence of intervals."""
        if memory.windows is not outlook.windows:
            memory = replace(memory, windows=outlook.windows, tree=None, solved={})
        order = self._order(outlook)
        found = self._compiled(outlook, memory, order)
        return (self._generic(outlook, memory, order) if found is None else found), memory

    def _compiled(self, outlook: Outlook, memory: HAALMemory, order: IntArray) -> IntArray | None:
        """The step's assignment by the compiled search; None where it does not apply."""
        if memory.uncompiled or self.keep_plan or self.lookahead == 1:  # one interval needs no search
            return None
        if outlook.rules is not None:  # it knows one task for each agent, and no limits
            return None
        if outlook.model.switching() is not None and outlook.state is not None and outlook.state.min() < 0:
            return None  # nor agents that hold nothing beside others that do
        if memory.tree is None:
            memory.tree = CompiledTree.of(outlook, self.lookahead)
        first = None
        if memory.tree is not None:
            if self.parking == "lookahead":
                memory.tree.forget_nodes()  # they are parked in another order
            first, solved = memory.tree.best(outlook, order)
            memory.assignment_problems += solved
        if first is None:
            memory.tree = None
            memory.uncompiled = True
        return first

    def _generic(self, outlook: Outlook, memory: HAALMemory, order: IntArray) -> IntArray:
        """The step's assignment for any dynamics."""
        if self.parking == "lookahead":
            memory.solved.clear()
        if outlook.rules is not None:
            memory.solved.clear()  # what they allow changes from step to step
        for key in [key for key in memory.solved if key[0] < outlook.k]:
            del memory.solved[key]
        stop = min(outlook.k + self.lookahead, outlook.end)
        search = _Search(outlook, memory, order, stop, self.exact_intervals)
        first, value = search.best(outlook.k, outlook.state)
        if self.keep_plan:
            kept, kept_value = search.continued(memory.kept)
            if kept and (first is None or kept_value > value + _TIE * abs(value)):
                first = kept[0]
            else:
                kept = search.sequence(outlook.k, outlook.state)
            memory.kept = kept[1:]
        if first is None:
            outlook.assign(outlook.beta_hat())  # raises, and says why
            raise InfeasibleError(f"step {outlook.k}: no sequence of assignments is feasible (value {value})")
        return first

    def _order(self, outlook: Outlook) -> IntArray:
        if self.parking == "lowest":
            return outlook.parking
        stop = min(outlook.k + max(self.lookahead, _PARKING_STEPS), outlook.end)
        demand = outlook.windows.slice(outlook.k, stop).task_totals()
        return np.argsort(demand, kind="stable")


class _Search:
    """The tree of interval sequences of one step."""

    def __init__(
        self, outlook: Outlook, memory: HAALMemory, order: IntArray, stop: int, exact_intervals: bool
    ) -> None:
        self.outlook = outlook
        self.memory = memory
        self.order = order
        self.stop = stop
        self.exact_intervals = exact_intervals
        self.known: dict[tuple[int, Any], tuple[IntArray | None, float]] = {}

    def best(self, start: int, state: Any) -> tuple[IntArray | None, float]:
        """First assignment and value of the best sequence over ``start .. stop - 1`` from `state`."""
        if start == self.stop:
            return None, 0.0
        fingerprint = self.outlook.model.key(state)
        if (start, fingerprint) in self.known:
            return self.known[start, fingerprint]
        first: IntArray | None = None
        top = -np.inf
        for cut in range(start + 1, self.stop + 1):
            tasks, value, after = self._interval(start, cut, state, fingerprint)
            if value == -np.inf:
                continue
            total = value + self.best(cut, after)[1]
            if total == -np.inf:  # a dead end later on
                continue
            if first is None or total > top + _TIE * abs(top):
                first, top = tasks, total
        self.known[start, fingerprint] = first, top
        return first, top

    def continued(self, plan: list[IntArray]) -> tuple[list[IntArray], float]:
        """A plan for the steps from the current one on, brought to the length of the window, and its value.

        Steps that it lacks take alpha(beta_hat). Empty, with value -inf, if there is no plan or it cannot go on.
        """
        k, state = self.outlook.k, self.outlook.state
        out: list[IntArray] = []
        value = 0.0
        if plan and self.outlook.rules is not None and not self.outlook.rules.allows(plan[0]):
            return [], -np.inf
        while plan and k < self.stop:
            matrix = self.outlook.interval(k, k + 1, state)
            try:
                tasks = (
                    plan[len(out)]
                    if len(out) < len(plan)
                    else self.outlook.alpha(matrix, k, k + 1, self.order)
                )
            except InfeasibleError:
                return [], -np.inf
            value += value_of(matrix, tasks)
            out.append(tasks)
            state = self.outlook.model.transition(k, state, tasks)
            k += 1
        return (out, value) if value > -np.inf and out else ([], -np.inf)

    def sequence(self, start: int, state: Any) -> list[IntArray]:
        """Assignments of the best sequence, one a step."""
        plan: list[IntArray] = []
        while start < self.stop:
            first, top = self.best(start, state)
            if first is None:
                break
            for cut in range(start + 1, self.stop + 1):
                tasks, value, after = self._interval(start, cut, state, self.outlook.model.key(state))
                if value == -np.inf or not np.array_equal(tasks, first):
                    continue
                if value + self.best(cut, after)[1] >= top - _TIE * abs(top):
                    break
            plan += [first] * (cut - start)
            start, state = cut, after
        return plan

    def _interval(self, start: int, stop: int, state: Any, fingerprint: Any) -> Solved:
        """The assignment chosen for the steps ``start .. stop - 1``; value -inf if there is none."""
        known = self.memory.solved.get((start, stop, fingerprint))
        if known is not None:
            return known
        self.outlook.check()
        self.memory.assignment_problems += 1
        matrix = (self.outlook.interval if self.exact_intervals else self.outlook.entered)(start, stop, state)
        try:
            tasks = self.outlook.alpha(matrix, start, stop, self.order)
            gains, after = self.outlook.played(start, stop, state, tasks)
            solved = Solved(tasks, float(gains.sum()), after)
        except InfeasibleError:
            solved = Solved(np.empty(0, dtype=np.int64), -np.inf, None)
        self.memory.solved[start, stop, fingerprint] = solved
        return solved


@dataclass(frozen=True)
class HAA:
    """Handover-aware assignment (thesis, Algorithm 1): alpha(beta_hat) at every step; HAAL with lookahead 1.

    Parameters
    ----------
    parking : {"lowest", "lookahead"}
        See `HAAL`.
    """

    parking: Parking = "lowest"

    takes: ClassVar[frozenset[str]] = EXTRAS

    @property
    def name(self) -> str:
        """Name with options."""
        return "HAA" if self.parking == "lowest" else "HAA(parking=lookahead)"

    @property
    def keeps_guarantee(self) -> bool:
        """Whether the c / (1 + c) theorem holds for it: yes, but for a subclass, which may decide otherwise."""
        return type(self) is HAA

    def begin(self, problem: SAP, rng: np.random.Generator) -> HAALMemory:
        """Empty memory."""
        return HAALMemory()

    def act(self, outlook: Outlook, memory: HAALMemory) -> tuple[IntArray, HAALMemory]:
        """Assign the current step."""
        return HAAL(1, self.parking).act(outlook, memory)
