"""Unit commitment against a mixed-integer programme that is written here, directly, with the usual on/off variables."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from sapopt import bound, solve
from sapopt.domains.instances import instance
from sapopt.domains.unit_commitment import PowerSystem, random_power_system
from sapopt.solvers import HAA, HAAL, DualLookahead, Exact


def tiny(seed: int, n: int = 2, blocks: int = 2, steps: int = 6, stops: bool = False) -> PowerSystem:
    rng = np.random.default_rng(seed)
    most = rng.choice([50.0, 100.0, 150.0], n)
    return PowerSystem(
        least_mw=most * 0.4,
        most_mw=most,
        fuel_per_mwh=rng.uniform(15, 45, n),
        running_per_h=rng.uniform(50, 300, n),
        start_up=rng.uniform(200, 3000, n),
        minimum_up=rng.integers(1, 4, n),
        minimum_down=rng.integers(1, 4, n),
        initial=rng.choice([-4, -2, -1, 1, 2, 4], n),
        demand_mw=rng.uniform(0, 220, steps),
        block_mw=rng.choice([50.0, 100.0, 120.0], blocks),
        price_per_mwh=60.0,
        shut_down=rng.uniform(100, 1000, n) if stops else 0.0,
    )


def milp(system: PowerSystem, method: str = "HIGHS") -> float:
    """Greatest value: energy served at its price, less fuel, running hours and starts; blocks need not be served."""
    n, T, B = len(system.least_mw), len(system.demand_mw), len(system.block_mw)
    on = cp.Variable((T, n), boolean=True)
    start, stop = (cp.Variable((T, n), boolean=True) for _ in range(2))
    serve = [cp.Variable((n, B), boolean=True) for _ in range(T)]
    rules: list[Any] = []
    value: Any = 0.0
    for k in range(T):
        sizes = np.diff(np.minimum(np.concatenate([[0.0], np.cumsum(system.block_mw)]), system.demand_mw[k]))
        before = (system.initial > 0).astype(float) if k == 0 else on[k - 1]
        rules += [on[k] - before == start[k] - stop[k], start[k] + stop[k] <= 1]
        rules += [cp.sum(serve[k], axis=1) <= on[k], cp.sum(serve[k], axis=0) <= 1]
        for i in range(n):
            hours = abs(int(system.initial[i]))
            up, down = int(system.minimum_up[i]), int(system.minimum_down[i])
            rules.append(cp.sum(start[max(0, k - up + 1) : k + 1, i]) <= on[k, i])
            rules.append(cp.sum(stop[max(0, k - down + 1) : k + 1, i]) <= 1 - on[k, i])
            if system.initial[i] > 0 and k < up - hours:
                rules.append(on[k, i] == 1)
            if system.initial[i] < 0 and k < down - hours:
                rules.append(on[k, i] == 0)
            idle_cost = system.fuel_per_mwh[i] * system.least_mw[i] + system.running_per_h[i]
            value -= idle_cost * on[k, i] + system.start_up[i] * start[k, i]
            value -= system.shut_down[i] * stop[k, i]
            for b, size in enumerate(sizes):
                if not 0 < size <= system.most_mw[i]:
                    rules.append(serve[k][i, b] == 0)
                    continue
                more = max(size - system.least_mw[i], 0.0)
                value += (system.price_per_mwh * size - system.fuel_per_mwh[i] * more) * serve[k][i, b]
    programme = cp.Problem(cp.Maximize(value), rules)
    programme.solve(solver=getattr(cp, method))
    assert programme.status == "optimal"
    return float(programme.value)


@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_against_the_direct_programme(seed: int, stops: bool) -> None:
    """Brute force, the network and the programme agree; heuristics lie below, the bound above."""
    system = tiny(seed, stops=stops)
    problem = system.problem()
    best = solve(problem, Exact(method="dp")).value
    assert milp(system) == pytest.approx(best, abs=1e-4)
    assert solve(problem, Exact(method="network")).value == pytest.approx(best, abs=1e-4)
    assert bound(problem, time_limit=2.0).value >= best - 1e-6
    for solver in (HAA(), HAAL(3), DualLookahead(3), DualLookahead(6)):
        assert solve(problem, solver).value <= best + 1e-6


def test_three_units_against_the_direct_programme() -> None:
    """Too large for brute force, small enough for the network."""
    system = tiny(11, n=4, blocks=4, steps=8)
    best = milp(system)
    problem = system.problem()
    assert solve(problem, Exact(method="network")).value == pytest.approx(best, abs=1e-3)
    assert best <= bound(problem, time_limit=3.0).value + 1e-6


def test_blocks_add_up_to_the_demand() -> None:
    system = tiny(0)
    sizes = system.blocks_mw
    np.testing.assert_allclose(sizes.sum(axis=1), np.minimum(system.demand_mw, system.block_mw.sum()))
    assert (sizes <= system.block_mw).all()
    assert not ((sizes[:, 0] < system.block_mw[0]) & (sizes[:, 1] > 0)).any()  # the first block fills first


def test_output_of_a_plan() -> None:
    """Units serve no more than the demand, nothing while they are off, and each what it can."""
    system = random_power_system(12, 30, seed=1)
    problem = system.problem()
    result = solve(problem, DualLookahead(6))
    output = system.output_mw(result.plan)
    assert (output.sum(axis=1) <= system.demand_mw + 1e-9).all()
    assert (output <= system.most_mw).all()
    assert output.sum() >= 0.9 * system.demand_mw.sum()
    state = problem.initial_state()
    for k, row in enumerate(result.plan):
        state = problem.transition(k, state, row)
        assert not output[k, state.local < 0].any()


def test_start_ups_scale_with_cost() -> None:
    system = tiny(3)
    free = system.problem(0.0)
    assert not free.dynamics.start_up.any()
    assert not tiny(3, stops=True).problem(0.0).dynamics.shut_down.any()
    assert solve(free, Exact(method="dp")).value >= solve(system.problem(), Exact(method="dp")).value
    with pytest.raises(ValueError, match="factor on the start-up and shut-down costs"):
        system.problem(-1.0)


def test_bad_input() -> None:
    good = tiny(0)
    options = {name: getattr(good, name) for name in good.__dataclass_fields__}
    for changes, message in (
        ({"start_up": [1.0]}, "start_up must have one entry"),
        ({"demand_mw": [np.nan]}, "demand_mw must be"),
        ({"block_mw": []}, "block_mw must be"),
        ({"least_mw": good.most_mw + 1.0}, "least_mw must not"),
        ({"step_h": 0.0}, "step_h must be"),
        ({"shut_down": [1.0]}, "shut_down must have one entry"),
    ):
        with pytest.raises(ValueError, match=message):
            PowerSystem(**(options | changes))
    with pytest.raises(ValueError, match="shut_down must be a finite share"):
        random_power_system(4, shut_down=-1.0)
    with pytest.raises(ValueError, match="units must be"):
        random_power_system(0)


def test_small_units_are_not_left_out_silently() -> None:
    """A unit that is smaller than every block would never serve: told, with the block that would mend it."""
    options = {name: getattr(tiny(0), name) for name in tiny(0).__dataclass_fields__}
    changes = {
        "least_mw": np.array([10.0, 40.0]), "most_mw": np.array([12.0, 100.0]), "demand_mw": np.full(6, 150.0),
        "block_mw": [100.0, 50.0],
    }  # fmt: skip
    with pytest.raises(
        ValueError, match=r"block_mw: units 0 \(1 in all\).* smallest block, 50 MW.* at most 12 MW"
    ):
        PowerSystem(**(options | changes))
    assert PowerSystem(**(options | changes | {"block_mw": [100.0, 38.0, 12.0]})).gains()[:, 0].any()


def test_ramps_and_reserve_are_told() -> None:
    """A unit that would have to jump by 60 MW and may climb 20 a step sheds the rest; what is not counted is said."""
    system = PowerSystem(
        least_mw=[40.0], most_mw=[100.0], fuel_per_mwh=[20.0], running_per_h=[10.0], start_up=[0.0], minimum_up=[1],
        minimum_down=[1], initial=[2], demand_mw=[40.0, 100.0, 100.0, 100.0], block_mw=[40.0, 60.0],
        price_per_mwh=90.0,
    )  # fmt: skip
    plan = np.array([[0], [1], [1], [1]])
    assert system.running(plan).all()
    free = system.dispatch(plan)
    assert free.shed_mwh == pytest.approx(0.0)
    assert free.not_counted[:2] == ("ramps", "reserve")
    tight = system.dispatch(plan, ramp_mw=20.0, reserve_mw=10.0)
    assert tight.output_mw[:, 0] == pytest.approx([40, 60, 80, 100])
    assert tight.shed_mwh == pytest.approx(40 + 20)
    assert tight.reserve_short_mwh == pytest.approx(10)  # demand comes before reserve
    assert "shed; counted" in str(tight)
    assert "ramps" in tight.counted
    with pytest.raises(ValueError, match="ramp_mw must be one number or 1"):
        system.dispatch(plan, ramp_mw=[1.0, 2.0])
    with pytest.raises(ValueError, match="reserve_mw must be"):
        system.dispatch(plan, reserve_mw=-1.0)


def test_dispatch_sheds_no_more_than_the_blocks() -> None:
    """Without ramps the outputs between the blocks can only serve more than the blocks do."""
    system = random_power_system(8, 16, seed=2)
    result = solve(system.problem(), HAA())
    by_blocks = system.demand_mw.sum() - system.output_mw(result.plan).sum()
    free, tight = system.dispatch(result.plan), system.dispatch(result.plan, ramp_mw=0.2 * system.most_mw)
    assert free.shed_mwh <= by_blocks + 1e-6
    assert tight.shed_mwh >= free.shed_mwh - 1e-6


def test_instance_and_draw() -> None:
    from matplotlib.figure import Figure

    problem = instance("unit-commitment", units=8, steps=12)
    assert (problem.T, problem.n, problem.m) == (12, 8, 24)
    stops = instance("unit-commitment", units=8, steps=12, shut_down=0.25).dynamics
    np.testing.assert_allclose(stops.shut_down, 0.25 * stops.start_up)
    system = random_power_system(8, 12)
    assert system.problem().fingerprint == problem.fingerprint
    ax = system.draw(solve(problem, HAA()).plan, Figure().subplots())
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert "demand" in labels
    assert len(labels) == 4


@pytest.mark.parametrize("units", [1, 2, 3, 6, 10])
def test_blocks_may_lie_above_the_demand(units: int) -> None:
    """A unit for whose blocks the demand is too low, on a short day, is no error: it stays off."""
    for steps in (1, 8, 24):
        for seed in range(5):
            system = random_power_system(units, steps, seed)
            problem = system.problem()
            assert (problem.T, problem.n) == (steps, units)
