"""Branch and price: cuts keep every plan, and the search proves what other methods prove."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sapopt import SAP, Status, SwitchingCost, solve
from sapopt.formulations import network, stays
from sapopt.formulations.highs import maximise
from sapopt.solvers.exact import Exact
from sapopt.solvers.exact.cuts import coefficients, violated
from sapopt.solvers.exact.dive import dive
from sapopt.solvers.exact.master import Master
from sapopt.solvers.exact.tree import Tree


def hard_problem(seed: int, T: int = 12, n: int = 10, m: int = 11) -> SAP:
    """A dense problem whose relaxation is not whole."""
    return SAP(np.random.default_rng(seed).random((T, n, m)), SwitchingCost(0.5))


def relaxed_to_the_end(problem: SAP) -> tuple[stays.Stays, Master, list[np.ndarray], list[float]]:
    compiled = stays.formulate(problem)
    everything = np.zeros(len(compiled), dtype=bool)
    master = Master(compiled, np.arange(0, len(compiled), 7))
    rng = np.random.default_rng(0)
    cuts: list[np.ndarray] = []
    bounds = []
    while True:
        relaxed = master.solve(everything, -np.inf)
        bounds.append(relaxed.bound)
        rows = violated(compiled, relaxed.stays, relaxed.x, 50, rng)
        if not rows:
            return compiled, master, cuts, bounds
        cuts += rows
        master.cut(*coefficients(compiled, rows))


def test_column_generation_ends_at_the_relaxation_of_the_network() -> None:
    """Pricing finds all stays that matter: the value is that of the whole linear programme, and the proof holds."""
    for seed in range(3):
        problem = hard_problem(seed, 8, 6, 7)
        compiled = stays.formulate(problem)
        master = Master(compiled, np.arange(5))
        found = master.solve(np.zeros(len(compiled), dtype=bool), -np.inf)
        assert found.bound == pytest.approx(
            maximise(network.formulate(problem).programme(), relaxed=True).value
        )
        assert len(found.stays) < len(compiled)


def test_cuts_lower_the_bound_and_keep_every_plan() -> None:
    """No plan breaks a cut, and the bound with cuts is lower, never below the optimum."""
    problem = hard_problem(1, 10, 9, 10)
    compiled, _, cuts, bounds = relaxed_to_the_end(problem)
    assert cuts
    assert bounds[-1] < bounds[0] - 1e-6
    best = solve(problem, Exact())
    assert best.status is Status.OPTIMAL
    assert bounds[-1] >= best.value - 1e-9
    matrix, right = coefficients(compiled, cuts)
    rng = np.random.default_rng(1)
    plans = [best.plan, *(np.array([rng.permutation(10)[:9] for _ in range(10)]) for _ in range(20))]
    plans += [np.repeat(rng.permutation(10)[None, :9], 10, axis=0) for _ in range(20)]
    for plan in plans:
        assert (matrix @ compiled.follow(plan).astype(float) <= right + 1e-9).all()


def test_dives_end_in_plans() -> None:
    """A dive gives a plan between the first heuristics and the bound; one that stays below the floor gives none."""
    problem = hard_problem(1)
    compiled, master, _, bounds = relaxed_to_the_end(problem)
    nothing = np.zeros(len(compiled), dtype=bool)
    plan = dive(master, nothing, lambda: -np.inf, np.random.default_rng(0))
    assert plan is not None
    assert 0.97 * bounds[-1] <= problem.evaluate(plan).value <= bounds[-1] + 1e-9
    assert dive(master, nothing, lambda: bounds[-1] + 1.0, np.random.default_rng(0)) is None


@pytest.mark.parametrize("threads", [1, 2])
def test_the_tree_finds_and_proves_the_optimum(threads: int) -> None:
    """Without a plan, cuts or prices to begin with, the tree alone ends with the optimum as its bound."""
    problem = hard_problem(2, 8, 7, 8)
    compiled = stays.formulate(problem)
    best = [-np.inf]

    def found(plan: np.ndarray) -> float:
        best[0] = max(best[0], problem.evaluate(plan).value)
        return best[0]

    tree = Tree(compiled, np.arange(50), np.inf, found, lambda: best[0], lambda bound, nodes: False)
    bound = tree.search(threads)
    whole = maximise(network.formulate(problem).programme(), tolerance=1e-9)
    assert best[0] == pytest.approx(whole.value, abs=1e-6)
    assert bound == pytest.approx(whole.value, abs=1e-6)


def test_branches_part_the_plans() -> None:
    """Every plan keeps to exactly one side of a branch."""
    problem = hard_problem(3, 5, 3, 4)
    compiled = stays.formulate(problem)
    tree = Tree(compiled, np.arange(1), np.inf, lambda plan: 0.0, lambda: 0.0, lambda bound, nodes: True)
    rng = np.random.default_rng(0)
    for _ in range(50):
        plan = np.array([rng.permutation(4)[:3] for _ in range(5)])
        if rng.random() < 0.5:
            plan[2:] = plan[1]
        used = compiled.follow(plan)
        for branch in (("change", 2, 1, -1), ("cell", 2, 1, 3)):
            open_sides = [not (tree.closed(((*branch, yes),)) & used).any() for yes in (True, False)]
            assert sum(open_sides) == 1


def test_stopped_search_has_a_valid_bound() -> None:
    """A search that is stopped after a node reports a bound above the optimum."""
    problem = hard_problem(1, 10, 9, 10)
    seen = []
    result = solve(
        problem,
        Exact(),
        callback=lambda progress: seen.append(progress) or "nodes" in progress.message,
    )
    assert result.bound is not None
    best = solve(problem, Exact())
    assert result.bound >= best.value - 1e-9
    assert best.status is Status.OPTIMAL


def test_a_master_that_is_stopped_still_bounds() -> None:
    """Cut short, the relaxation claims no plan, and its bound is valid."""
    problem = SAP(np.random.default_rng(2).random((6, 4, 5)), SwitchingCost(0.4))
    form = stays.formulate(problem)
    best = solve(problem, Exact()).value
    for most in range(4):
        asked = itertools.count()
        master = Master(form, np.arange(len(form)), lambda: next(asked) >= most)  # noqa: B023
        relaxed = master.solve(np.zeros(len(form), dtype=bool), -np.inf)
        assert relaxed.bound >= best - 1e-9
        assert most > 0 or not (relaxed.whole or relaxed.complete)
