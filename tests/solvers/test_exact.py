"""The exact methods against each other and against enumeration, and how they end."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from local_dynamics import Dictator, Tiring
from strategies import Instance

from sapopt import SAP, InfeasibleError, Status, SwitchingCost, solve
from sapopt.formulations.highs import Programme, SolverError, maximise
from sapopt.formulations.network import Network
from sapopt.running.control import Run
from sapopt.solvers import HAAL
from sapopt.solvers.exact import Exact, search
from sapopt.solvers.exact.dp import TooLargeError, best_plan
from sapopt.solvers.exact.search import Search
from sapopt.solvers.exact.warm import Incumbent

METHODS = ("network", "milp", "qap", "dp")
CHUNKS = 12


def random_problem(seed: int) -> SAP:
    """Mixed shapes: n = m and n < m, sparse, negative and forbidden benefits, all cost rules, users' dynamics."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    m = n + int(rng.integers(0, 4 - n + (n < 3)))
    T = int(rng.integers(1, 4))
    benefits = rng.random((T, n, m))
    kind = seed % 4
    if kind == 1:
        benefits *= rng.random((T, n, m)) < 0.6
    elif kind == 2:
        benefits = rng.normal(size=(T, n, m)).round(1)
    elif kind == 3 and m > n:
        benefits[rng.random((T, n, m)) < 0.15] = -np.inf
        for k, i in itertools.product(range(T), range(n)):
            benefits[k, i, i] = max(benefits[k, i, i], 0.1)  # one full assignment stays
    if seed % 10 == 9:
        return SAP(benefits, Tiring(float(rng.random())))
    cost: Any = float(rng.random()) if seed % 3 else rng.random((m, m)) * (1 - np.eye(m))
    initial = rng.permutation(m)[:n] if seed % 5 < 2 else None
    return SAP(benefits, SwitchingCost(cost, idle_is_free=seed % 7 < 3), initial)


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_four_methods_agree(chunk: int) -> None:
    """300 random problems of mixed shape: network, MILP, QAP and brute force prove the same value."""
    for seed in range(chunk, 300, CHUNKS):
        problem = random_problem(seed)
        values = {}
        for method in METHODS:
            solver = Exact(method)
            if solver.refusal(problem) is None:
                result = solve(problem, solver)
                assert result.status is Status.OPTIMAL, (seed, method)
                assert result.bound is not None
                assert result.bound >= result.value
                values[method] = result.value
        assert {"network", "milp", "dp"} <= set(values), seed
        assert ("qap" in values) == isinstance(problem.dynamics, SwitchingCost)
        assert max(values.values()) - min(values.values()) <= 1e-6, (seed, values)


@pytest.mark.parametrize("idle_is_free", [False, True])
@pytest.mark.parametrize("initial", [None, (2, 0)])
def test_brute_force_is_the_definition(idle_is_free: bool, initial: tuple[int, ...] | None) -> None:
    """The methods meet an enumeration of all plans that shares no code with them."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        benefits = rng.integers(-4, 9, (3, 2, 3)) / 4
        instance = Instance(benefits, 0.75, idle_is_free, initial)
        best = instance.best()
        for method in ("network", "qap", "dp"):
            assert solve(instance.problem(), Exact(method)).value == pytest.approx(best, abs=1e-9)


def test_global_dynamics_by_brute_force() -> None:
    """Brute force takes a state that is not local to the agents; the others say why they do not."""
    rng = np.random.default_rng(0)
    problem = SAP(rng.random((3, 2, 3)), Dictator())
    result = solve(problem, Exact("dp"))
    rows = list(itertools.permutations(range(3), 2))
    best = max(problem.evaluate(np.array(plan)).value for plan in itertools.product(rows, repeat=3))
    assert result.status is Status.OPTIMAL
    assert result.value == pytest.approx(best)
    for method in ("network", "milp"):
        with pytest.raises(ValueError, match="local_model"):
            solve(problem, Exact(method))
    with pytest.raises(ValueError, match="only SwitchingCost"):
        solve(problem, Exact("qap"))


def test_states_without_hash_and_key() -> None:
    """States that are arrays, or objects that cannot be hashed, are told apart correctly."""

    class Counting:
        def initial_state(self, problem: SAP) -> Any:
            return {"held": [np.zeros(problem.n)], "m": problem.m}

        def handover(self, k: int, state: Any) -> np.ndarray:
            return np.repeat(-0.1 * state["held"][0][:, None], state["m"], axis=1)

        def transition(self, k: int, state: Any, assignment: np.ndarray) -> Any:
            return {"held": [state["held"][0] + assignment], "m": state["m"]}

    problem = SAP(np.random.default_rng(1).random((3, 2, 2)), Counting())
    rows = list(itertools.permutations(range(2)))
    best = max(problem.evaluate(np.array(plan)).value for plan in itertools.product(rows, repeat=3))
    assert solve(problem, Exact("dp")).value == pytest.approx(best)


def test_reduced_costs_do_not_change_the_optimum() -> None:
    """Deleting arcs by their reduced costs keeps an optimal plan."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        problem = SAP(rng.random((6, 4, 5)), SwitchingCost(0.4))
        fixed, whole = (solve(problem, Exact(reduced_costs=flag)) for flag in (True, False))
        assert fixed.status is whole.status is Status.OPTIMAL
        assert fixed.value == pytest.approx(whole.value, abs=1e-6)


def test_medium_problem_is_proven_and_traced() -> None:
    """8x10x8 is solved to a proof; bounds only fall and values only rise on the way."""
    problem = SAP(np.random.default_rng(0).random((8, 8, 10)), SwitchingCost(0.5))
    result = solve(problem, Exact())
    assert result.status is Status.OPTIMAL
    assert result.value >= solve(problem, HAAL(3)).value
    values, bounds = (np.array([record[key] for record in result.trace]) for key in ("value", "bound"))
    assert (np.diff(values) >= 0).all()
    assert (np.diff(bounds[np.isfinite(bounds)]) <= 1e-9).all()


@pytest.mark.parametrize("method", ["network", "milp", "qap", "dp"])
def test_time_limit_keeps_an_incumbent(method: str) -> None:
    """Without time for a proof there is still a feasible plan, and a valid bound where one was found."""
    shape = (4, 3, 5) if method == "qap" else (3, 5, 7) if method == "dp" else (12, 12, 14)
    problem = SAP(np.random.default_rng(0).random(shape), SwitchingCost(0.5))
    result = solve(problem, Exact(method), time_limit=0.05 if method != "qap" else 0.001)
    assert result.bound is None or result.bound >= result.value
    proven = result.bound is not None and result.bound - result.value <= 1e-7 * result.value
    assert result.status is (Status.OPTIMAL if proven else Status.TIME_LIMIT)


def test_prices_come_with_the_bound_they_prove() -> None:
    """Prices are handed back only while it is they that prove the bound."""
    from sapopt.formulations.dual import dual_value

    problem = SAP(np.random.default_rng(0).random((10, 10, 12)), SwitchingCost(0.5))
    seen = []
    result = solve(
        problem, Exact(), callback=lambda progress: seen.append(progress) or progress.message == "prices"
    )
    assert result.status is Status.INTERRUPTED
    assert seen
    assert result.prices is not None
    oracle = problem.model.path_oracle(problem.benefits, None)
    assert dual_value(oracle, result.prices).bound == pytest.approx(result.bound)


def test_warm_start_is_never_lost() -> None:
    """The result is at least as good as the plan it started from."""
    problem = SAP(np.random.default_rng(2).random((5, 4, 5)), SwitchingCost(0.3))
    best = solve(problem, Exact())
    again = solve(problem, Exact(), start=best, time_limit=0.01)
    assert again.value >= best.value - 1e-12


def test_infeasible_names_step_and_agents() -> None:
    """Forbidden moves may leave no plan although every step by itself has an assignment."""
    benefits = np.full((3, 2, 3), 1.0)
    benefits[1, :, 2] = (
        0.0  # after a step of work nobody may work again, and only one idle task is there at step 1
    )
    problem = SAP(benefits, Tiring(np.inf, 1))
    for method in ("network", "milp", "dp"):
        with pytest.raises(InfeasibleError, match=r"step 1.*agents 0, 1"):
            solve(problem, Exact(method))


def test_infeasible_only_over_time() -> None:
    """The agents that stand in each other's way over several steps are named."""
    cost = np.zeros((3, 3))
    benefits = np.full((2, 2, 3), -np.inf)
    benefits[0, :, :2] = 1.0
    benefits[1, 0, 0] = benefits[1, 1, 2] = 1.0

    class Stay(SwitchingCost):
        """Task 0 may only be entered from task 1, and task 2 from task 1 as well."""

        def handover(self, k: int, state: Any) -> np.ndarray:
            if state is None:
                return np.zeros((2, 3))
            return np.where((np.asarray(state) == 1)[:, None], 0.0, np.full((2, 3), -np.inf))

        def local_model(self, benefits: Any, state: Any) -> Any:
            class States:
                def state_count(self) -> int:
                    return 4

                def start(self, agent: int) -> int:
                    return 3

                def step(self, k: int, agent: int, benefit: np.ndarray) -> Any:
                    eta = np.zeros((4, 3))
                    eta[[0, 2]] = -np.inf
                    return np.broadcast_to(np.arange(3), (4, 3)), eta

            return States()

    problem = SAP(benefits, Stay(cost))
    with pytest.raises(InfeasibleError, match=r"step 1: no plan brings the agents 0, 1"):
        solve(problem, Exact())
    with pytest.raises(InfeasibleError, match=r"step 1"):
        solve(problem, Exact("dp"))


def test_bad_arguments() -> None:
    """One clear line for what the solver cannot take."""
    with pytest.raises(ValueError, match="method must be one of network, milp, qap, dp"):
        Exact("simplex")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="tolerance"):
        Exact(tolerance=-1)
    big = SAP(np.ones((2, 9, 12)), SwitchingCost(1.0))
    with pytest.raises(ValueError, match="too many for brute force"):
        solve(big, Exact("dp"))
    with pytest.raises(TooLargeError, match="states at step"):
        best_plan(SAP(np.random.default_rng(0).random((3, 3, 4)), SwitchingCost(1.0)), limit=100)


def test_endings_are_told_apart() -> None:
    """Optimal, feasible with a bound, out of time, stopped by the callback, and no plan at all."""
    problem = SAP(np.random.default_rng(0).random((20, 20, 24)), SwitchingCost(0.5))
    result = solve(problem, Exact(), time_limit=0.3)
    assert result.status is Status.TIME_LIMIT
    result = solve(problem, Exact(), callback=lambda progress: progress.bound is not None)
    assert result.status is Status.INTERRUPTED
    best = Incumbent(result.plan, result.value)
    exact = Exact()
    assert exact._outcome(problem, Run(), best, result.value).status is Status.OPTIMAL
    open_end = exact._outcome(problem, Run(), best, result.value + 1.0)
    assert open_end.status is Status.FEASIBLE
    assert open_end.bound == result.value + 1.0
    with pytest.raises(SolverError, match="found no plan"):
        exact._outcome(problem, Run(), Incumbent(), np.inf)


def test_failing_solver_is_an_error() -> None:
    """A programme that HiGHS refuses is an error, never an answer."""
    broken = Programme(
        np.array([np.nan, 1.0]),
        np.array([[1.0, np.inf]]),
        np.zeros(1),
        np.ones(1),
        np.ones(2),
        np.ones(2, dtype=bool),
    )
    with pytest.raises(SolverError, match="HiGHS"):
        maximise(broken)


def test_networks_that_are_too_large(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Where building the network would take all the time or memory, prices plan and prove, and the log says so."""
    problem = SAP(np.random.default_rng(0).random((6, 4, 6)), SwitchingCost(0.3))
    exact = solve(problem, Exact())
    assert not caplog.text
    monkeypatch.setattr("sapopt.solvers.exact.planner._MOST_PLACES", 100)
    priced = solve(problem, Exact(), time_limit=5.0)
    assert "too large to build" in caplog.text
    assert priced.value <= exact.value + 1e-9
    assert priced.bound is not None
    assert priced.bound >= exact.value - 1e-9


def test_programmes_that_are_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where HiGHS would not begin to search in the time left, no programme is written; better plans are looked for."""
    rng = np.random.default_rng(0)
    problem = SAP(rng.random((8, 8, 10)), SwitchingCost(rng.random((10, 10)) * (1 - np.eye(10))))
    start = solve(problem, HAAL(2))
    seen: list[float] = []
    monkeypatch.setattr("sapopt.solvers.exact.search._ARCS_A_SECOND", 0)
    monkeypatch.setattr(Search, "_programme", lambda self, delta, share: seen.append(delta))
    result = solve(problem, Exact(), time_limit=1.5, start=start)
    assert not seen
    assert result.value >= start.value
    assert result.bound is not None
    assert result.bound >= result.value
    proven = result.bound - result.value <= 1e-7 * result.value
    assert result.status is (Status.OPTIMAL if proven else Status.TIME_LIMIT)


def test_the_share_is_taken_of_what_writing_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of a programme is measured when it is written down, not before."""
    rng = np.random.default_rng(0)
    problem = SAP(rng.random((6, 6, 8)), SwitchingCost(rng.random((8, 8)) * (1 - np.eye(8))))
    allowed: list[tuple[float, float]] = []
    plain, write = search.maximise, Network.programme

    def slow(self: Network, keep: np.ndarray | None = None) -> Programme:
        late[0] += 100.0
        return write(self, keep)

    def solved(programme: Programme, **options: Any) -> Any:
        allowed.append((options["seconds"], run.seconds_left))
        return plain(programme, **options)

    late = [0.0]
    run = Run(time_limit=1000.0)
    monkeypatch.setattr(Run, "seconds", property(lambda self: late[0]))
    monkeypatch.setattr(Network, "programme", slow)
    monkeypatch.setattr(search, "maximise", solved)
    Exact().plan(problem, run)
    assert allowed
    assert all(seconds <= left for seconds, left in allowed)


def test_milp_is_stopped_by_the_callback() -> None:
    """Progress and an early end reach the programme that cvxpy wrote."""
    problem = SAP(np.random.default_rng(0).random((12, 14, 16)), SwitchingCost(0.5))
    seen = []
    result = solve(
        problem, Exact("milp"), callback=lambda progress: seen.append(progress) or progress.message == "milp"
    )
    assert result.status is Status.INTERRUPTED
    assert seen[-1].message == "milp"
    assert result.value >= solve(problem, HAAL(2)).value
