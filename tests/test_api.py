"""solve and bound: no method beats the optimum, no bound falls below it, and arguments are checked."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import Instance, instances, random_instances

import sapopt
from sapopt import SAP, Outlook, Status, SwitchingCost, bound, solve
from sapopt.formulations.bounds import stepwise_bound
from sapopt.running.control import Run
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, Greedy, NoHandover, myopic
from sapopt.solvers.base import Outcome

POLICIES: tuple[Any, ...] = (
    HAA(),
    HAAL(2),
    HAAL(5),
    HAAL(3, "lookahead"),
    NoHandover(),
    Greedy(),
    AssignmentPolicy(myopic),
)
PROBLEM = SAP(np.random.default_rng(0).random((5, 3, 4)), SwitchingCost(0.3))


@dataclass(frozen=True)
class Echo:
    """A planner that returns what it was started with, or a plan it was given."""

    answer: Any = None
    name: str = "Echo"

    def plan(self, problem: SAP, run: Run) -> Outcome:
        chosen = run.start if self.answer is None else self.answer
        return Outcome(chosen, Status.OPTIMAL, bound=9.0, prices=np.zeros((5, 4)), trace=[{"iteration": 0}])


@dataclass(frozen=True)
class Dice:
    """A policy that assigns at random."""

    name: str = "Dice"

    def begin(self, problem: SAP, rng: np.random.Generator) -> np.random.Generator:
        return rng

    def act(self, outlook: Outlook, memory: np.random.Generator) -> Any:
        return memory.permutation(outlook.problem.m)[: outlook.problem.n], memory


@dataclass(frozen=True)
class Mood:
    """Chapter 6.1 in small: one state for all, set by agent 0, decides what every pair is worth."""

    def initial_state(self, problem: SAP) -> int:
        return 0

    def handover(self, k: int, state: int) -> np.ndarray:
        return np.roll(np.arange(6.0) % 4, state).reshape(2, 3) * 0.5

    def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
        return int(assignment[0])


class DeclaredMood(Mood):
    """The same, with the largest entry of its handover matrix."""

    handover_limit = 1.5


# --- Values against the optimum and its bounds ---


@settings(max_examples=80)
@given(instances(plans=800, most=(4, 3, 4), forbid=True))
def test_heuristics_optimum_bound(instance: Instance) -> None:
    """heuristic <= optimum by enumeration <= bound, for all forms of cost and benefits, with forbidden pairs."""
    optimum = instance.best()
    for form in ("dense", "sparse"):
        problem = instance.problem(form)
        for policy in POLICIES:
            result = solve(problem, policy)
            assert result.value == instance.score(result.plan), policy.name
            assert result.value <= optimum + 1e-9, policy.name
        assert stepwise_bound(problem).value >= optimum


@settings(max_examples=25)
@given(instances(plans=800, most=(4, 3, 4), forbid=True))
def test_bound_is_above_the_optimum(instance: Instance) -> None:
    """The bound holds for this very problem, however little time it had."""
    optimum = instance.best()
    for form in ("dense", "sparse"):
        assert bound(instance.problem(form), time_limit=0.05).value >= optimum - 1e-9


def test_last_step_and_single_step_are_solved() -> None:
    """With one step HAA is optimal, whatever the cost and the initial assignment."""
    for instance in random_instances(40, seed=1, steps=1, n=3, m=5):
        assert solve(instance.problem(), HAA()).value == pytest.approx(instance.best(), abs=1e-12)


@given(instances(most=(4, 4, 6), forbid=True))
def test_cost_zero_is_step_by_step(instance: Instance) -> None:
    """Without handover costs every lookahead solves every step by itself, and that meets the simple bound."""
    free = Instance(instance.benefits, 0.0, instance.idle_is_free, instance.initial)
    best = math.fsum(float(_alpha(step)) for step in instance.benefits)
    for form in ("dense", "sparse"):
        problem = free.problem(form)
        for policy in (HAA(), HAAL(2), HAAL(4), NoHandover(), AssignmentPolicy(myopic)):
            assert solve(problem, policy).value == pytest.approx(best, abs=1e-9)
        assert stepwise_bound(problem).value == pytest.approx(best, abs=1e-9)


def _alpha(step: np.ndarray) -> float:
    from scipy.optimize import linear_sum_assignment

    return float(step[linear_sum_assignment(step, maximize=True)].sum())


@pytest.mark.parametrize("policy", [p for p in POLICIES if not isinstance(p, Greedy)], ids=lambda p: p.name)
def test_relabelling_agents(policy: Any) -> None:
    """Agents in another order have the same plan in that order, where there are no ties (for Greedy, order matters)."""
    rng = np.random.default_rng(3)
    for instance in random_instances(12, seed=4, steps=5, n=4, m=6):
        order = rng.permutation(4)
        initial = None if instance.initial is None else tuple(np.array(instance.initial)[order].tolist())
        moved = Instance(instance.benefits[:, order], instance.cost, instance.idle_is_free, initial)
        first, second = solve(instance.problem(), policy), solve(moved.problem(), policy)
        np.testing.assert_array_equal(second.plan, first.plan[:, order])
        assert second.value == pytest.approx(first.value, abs=1e-12)


def test_relabelling_tasks() -> None:
    """Tasks in another order have the same value, where there are no ties."""
    rng = np.random.default_rng(5)
    for instance in random_instances(12, seed=6, steps=5, n=4, m=6):
        order = rng.permutation(6)
        place = np.argsort(order)
        initial = None if instance.initial is None else tuple(place[list(instance.initial)].tolist())
        cost = instance.cost if np.ndim(instance.cost) == 0 else instance.cost[order][:, order]
        moved = Instance(instance.benefits[:, :, order], cost, instance.idle_is_free, initial)
        for policy in POLICIES[:3]:
            first, second = solve(instance.problem(), policy), solve(moved.problem(), policy)
            np.testing.assert_array_equal(order[second.plan], first.plan)


def test_sparse_and_dense_play_alike_without_ties() -> None:
    """When all pairs have benefits of their own, the form of the benefits does not change any plan."""
    for instance in random_instances(20, seed=7, steps=6, n=4, m=6):
        for policy in POLICIES:
            if isinstance(policy, HAAL) and policy.parking == "lookahead":
                continue
            plans = [solve(instance.problem(form), policy).plan for form in ("dense", "sparse", "function")]
            np.testing.assert_array_equal(plans[0], plans[1], err_msg=policy.name)
            np.testing.assert_array_equal(plans[0], plans[2], err_msg=policy.name)


# --- User-defined dynamics ---


def test_global_state() -> None:
    """One state for all agents: values are those of the definition, below the optimum, below the declared bound."""
    values = np.random.default_rng(8).random((3, 2, 3))
    rows = list(itertools.permutations(range(3), 2))

    def score(plan: Any) -> float:
        total, mood = 0.0, 0
        for k, row in enumerate(plan):
            table = np.roll(np.arange(6.0) % 4, mood).reshape(2, 3) * 0.5
            total += sum(values[k, i, j] + table[i, j] for i, j in enumerate(row))
            mood = row[0]
        return total

    optimum = max(score(plan) for plan in itertools.product(rows, repeat=3))
    problem = SAP(values, DeclaredMood())
    for policy in (HAA(), HAAL(1), HAAL(2), HAAL(3), Greedy(), NoHandover(), AssignmentPolicy(myopic)):
        result = solve(problem, policy)
        assert result.value == pytest.approx(score(result.plan), abs=1e-12)
        assert result.value <= optimum + 1e-9
    assert bound(problem).value >= optimum
    assert bound(problem).value == stepwise_bound(problem).value


def test_nothing_is_proven_about_the_unknown() -> None:
    """Without a limit on the handover matrix there is no bound, and the message says what to declare; solve works."""
    problem = SAP(np.ones((3, 2, 3)), Mood())
    assert solve(problem, HAAL(2)).bound is None
    with pytest.raises(ValueError, match="Mood must declare handover_limit"):
        bound(problem)


# --- Arguments ---


def test_seeds() -> None:
    """Equal seeds give equal plans, other seeds others; the seed is in the result."""
    runs = [solve(PROBLEM, Dice(), seed=seed) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(runs[0].plan, runs[1].plan)
    assert not np.array_equal(runs[0].plan, runs[2].plan)
    assert [run.seed for run in runs] == [3, 3, 4]


def test_solvers_can_be_used_again() -> None:
    """A solver keeps nothing from one run to the next, also after a run that was stopped."""
    for policy in POLICIES:
        first = solve(PROBLEM, policy)
        solve(SAP(np.random.default_rng(1).random((5, 3, 4)), 0.3), policy)
        solve(PROBLEM, policy, callback=lambda progress: progress.done > 2)
        np.testing.assert_array_equal(solve(PROBLEM, policy).plan, first.plan)


def test_result_of_a_policy() -> None:
    """A policy's result has a name, a runtime and a trace, and claims no bound."""
    result = solve(PROBLEM, HAAL(2))
    assert (result.solver, result.status, result.bound, result.gap) == (
        "HAAL(L=2)",
        Status.FEASIBLE,
        None,
        None,
    )
    assert result.plan.dtype == np.int64
    assert result.runtime > 0
    assert len(result.trace) == 5
    assert result.evaluation.value == PROBLEM.evaluate(result.plan).value


def test_start_reaches_a_planner() -> None:
    """A plan, as a list or a result, is checked and handed to the planner; its outcome becomes the result."""
    start = solve(PROBLEM, HAA())
    for given_start in (start, start.plan, start.plan.tolist()):
        result = solve(PROBLEM, Echo(), start=given_start)
        np.testing.assert_array_equal(result.plan, start.plan)
        assert (result.bound, result.status, result.trace) == (9.0, Status.OPTIMAL, [{"iteration": 0}])
        assert result.value == start.value
        assert result.prices is not None


def test_outcomes_of_planners_are_checked() -> None:
    """A planner's plan is scored by evaluate, so an infeasible one is an error."""
    with pytest.raises(ValueError, match="given to agents"):
        solve(PROBLEM, Echo(np.zeros((5, 3), dtype=int)))


PLAN = np.tile([0, 1, 2], (5, 1))
BAD: dict[str, tuple[Any, Any, dict[str, Any], str]] = {
    "name": (PROBLEM, "haal", {}, "solver must be a policy or a planner"),
    "class": (PROBLEM, HAA, {}, r"solver: pass an instance, such as HAA\(\.\.\.\)"),
    "nothing": (PROBLEM, None, {}, "solver must be"),
    "function": (PROBLEM, len, {}, "solver must be"),
    "array": (np.ones((2, 2, 2)), HAA(), {}, r"problem must be a SAP, got ndarray; build one with SAP"),
    "no time": (PROBLEM, HAA(), {"time_limit": 0}, "time_limit must be a positive"),
    "negative time": (PROBLEM, HAA(), {"time_limit": -1.0}, "time_limit must be a positive"),
    "NaN time": (PROBLEM, HAA(), {"time_limit": float("nan")}, "time_limit must be a positive"),
    "time as text": (PROBLEM, HAA(), {"time_limit": "10"}, "time_limit must be a positive"),
    "negative seed": (PROBLEM, HAA(), {"seed": -1}, "seed must be a whole number"),
    "broken seed": (PROBLEM, HAA(), {"seed": 1.5}, "seed must be a whole number"),
    "no seed": (PROBLEM, HAA(), {"seed": None}, "seed must be a whole number"),
    "start of a policy": (PROBLEM, HAA(), {"start": PLAN}, "HAA decides step by step and takes no plan"),
    "forecast of a planner": (PROBLEM, Echo(), {"forecast": lambda k, s: None}, "Echo plans the whole horizon"),
    "start of a wrong shape": (PROBLEM, Echo(), {"start": PLAN[:4]}, r"shape \(T, n\)"),
    "infeasible start": (PROBLEM, Echo(), {"start": np.zeros((5, 3), int)}, "given to agents 0, 1, 2 at step 0"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments(name: str) -> None:
    """Each is a ValueError that names the argument."""
    problem, solver, options, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        solve(problem, solver, **options)


def test_bad_arguments_of_bound() -> None:
    """The same checks hold for bound."""
    with pytest.raises(ValueError, match="problem must be a SAP"):
        bound(np.ones((2, 2, 2)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="time_limit"):
        bound(PROBLEM, time_limit=-1)


@pytest.mark.parametrize(
    "lookahead", [0, -1, 1.5, 3.0, "3", "x", None, float("nan"), float("inf"), True, [2]]
)
def test_bad_lookahead(lookahead: Any) -> None:
    """The lookahead is a whole number of at least 1."""
    with pytest.raises(ValueError, match="lookahead must be a whole number of at least 1"):
        HAAL(lookahead)


def test_any_whole_lookahead() -> None:
    """numpy's integers are whole numbers; a lookahead beyond the horizon ends at it."""
    expected = solve(PROBLEM, HAAL(5)).plan
    for lookahead in (np.int64(5), np.uint8(5), 12):
        np.testing.assert_array_equal(solve(PROBLEM, HAAL(lookahead)).plan, expected)


def test_public_names() -> None:
    """Everything that the package lists is there."""
    for name in sapopt.__all__:
        assert hasattr(sapopt, name), name
