"""Longest paths under prices: against enumeration, the generic oracle, and differences of the soft values."""

from __future__ import annotations

import itertools
import logging
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from local_dynamics import Dictator, Tiring

from sapopt import SAP, Benefits, SwitchingCost, bound, solve
from sapopt.dynamics.paths.arcs_build import model_graph
from sapopt.dynamics.paths.oracles import (
    FirstValueOracle,
    LocalOracle,
    PathOracle,
    SoftPathOracle,
    compiled,
    path_oracle,
)
from sapopt.dynamics.switching.paths import StrictSwitching, oracle
from sapopt.dynamics.switching.states import SwitchingStates
from sapopt.proofs.plain import plain_bound
from sapopt.solvers import DualDecomposition, DualLookahead, Exact

RULES = ("strict", "idle is free", "matrix", "matrix, idle is free")


@dataclass(frozen=True, eq=False)
class Case:
    """A small window with prices, and everything by the definition."""

    benefits: np.ndarray
    cost: Any
    idle_is_free: bool
    initial: np.ndarray | None
    prices: np.ndarray

    @property
    def dynamics(self) -> SwitchingCost:
        return SwitchingCost(self.cost, self.idle_is_free)

    def value(self, agent: int, path: Any, *, first_price: bool = True) -> float:
        """Priced value of a path."""
        total, before = 0.0, None if self.initial is None else int(self.initial[agent])
        for k, j in enumerate(path):
            total += self.benefits[k, agent, j] - (self.prices[k, j] if k or first_price else 0.0)
            charged = before is not None and before != j
            if charged and (not self.idle_is_free or self.benefits[k, agent, j] > 0):
                total -= self.cost if np.ndim(self.cost) == 0 else self.cost[before, j]
            before = j
        return float(total)

    def paths(self) -> Any:
        T, _, m = self.benefits.shape
        return itertools.product(range(m), repeat=T)

    def best(self, agent: int) -> float:
        return max(self.value(agent, path) for path in self.paths())


def make_case(seed: int, rule: str, *, kind: str = "plain") -> Case:
    """`kind`: plain (benefits >= 0, finite prices), signed (negative too), forbidden (-inf pairs, +inf prices)."""
    rng = np.random.default_rng([seed, RULES.index(rule)])
    T, n, m = (int(x) for x in (rng.integers(1, 6), rng.integers(1, 4), rng.integers(3, 5)))
    worth = rng.normal(0.5, 1.0, (T, n, m)) if kind != "plain" else rng.random((T, n, m)) * 2
    benefits = np.where(rng.random((T, n, m)) < 0.4, worth, 0.0)
    prices = rng.random((T, m)) * rng.integers(0, 2, (T, m))
    if kind == "forbidden":
        benefits[rng.random(benefits.shape) < 0.1] = -np.inf
        prices[rng.random(prices.shape) < 0.1] = np.inf
    cost: Any = float(rng.random() * 1.5)
    if rule.startswith("matrix"):
        cost = rng.random((m, m))
        np.fill_diagonal(cost, 0.0)
    initial = None if rng.random() < 0.4 else rng.permutation(m)[:n]
    return Case(benefits, cost, rule.endswith("idle is free"), initial, prices)


def sparse(benefits: np.ndarray) -> Benefits:
    T, n, m = benefits.shape
    rows, tasks = np.nonzero(benefits.reshape(T * n, m))
    indptr = np.searchsorted(rows, np.arange(T * n + 1)).astype(np.int64)
    return Benefits.from_flat(
        indptr, tasks.astype(np.int32), benefits.reshape(T * n, m)[rows, tasks], (T, n, m)
    )


def with_parking(case: Case) -> StrictSwitching:
    """The strict oracle with slots for seen tasks only, which it would not choose at this size by itself."""
    made = oracle(case.benefits, case.dynamics, case.initial)
    assert isinstance(made, StrictSwitching)
    made._set_slots(True)
    return made


def oracles(case: Case) -> list[PathOracle]:
    made = [
        oracle(case.benefits, case.dynamics, case.initial),
        oracle(sparse(case.benefits), case.dynamics, case.initial),
    ]
    if np.ndim(case.cost) == 0 and not case.idle_is_free:
        made.append(with_parking(case))
    return made


def check_paths(case: Case, made: PathOracle) -> None:
    values, plan = made.best_paths(case.prices)
    for i in range(made.shape[1]):
        best = case.best(i)
        value, path = made.best_path(i, case.prices)
        for found, way in ((values[i], plan[:, i]), (value, path)):
            assert found == pytest.approx(best, abs=1e-9)
            if math.isfinite(best):
                assert case.value(i, way) == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("kind", ["plain", "signed", "forbidden"])
@pytest.mark.parametrize("rule", RULES)
def test_paths_are_the_longest_and_attain_their_value(rule: str, kind: str) -> None:
    """All cost rules, dense and sparse, with shared parking or without, against enumeration."""
    for seed in range(15):
        case = make_case(seed, rule, kind=kind)
        for made in oracles(case):
            check_paths(case, made)


@pytest.mark.parametrize("rule", RULES)
def test_first_values_are_the_best_paths_by_first_task(rule: str) -> None:
    """The price of the first step does not count."""
    for seed in range(10):
        case = make_case(seed, rule, kind="forbidden")
        values = oracle(case.benefits, case.dynamics, case.initial).first_values(case.prices)  # type: ignore[attr-defined]
        _, n, m = case.benefits.shape
        for i in range(n):
            for j in range(m):
                best = max(case.value(i, path, first_price=False) for path in case.paths() if path[0] == j)
                assert values[i, j] == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("rule", RULES)
def test_the_generic_oracle_agrees(rule: str) -> None:
    """`LocalOracle` on the states of a switching cost gives the compiled recursions' values."""
    for seed in range(8):
        case = make_case(seed, rule, kind="signed")
        states = SwitchingStates(case.dynamics, case.benefits.shape[2], case.initial)
        generic = LocalOracle(Benefits(case.benefits), states)
        assert isinstance(generic, FirstValueOracle)
        check_paths(case, generic)
        fast = oracle(case.benefits, case.dynamics, case.initial)
        assert isinstance(fast, FirstValueOracle)
        np.testing.assert_allclose(
            generic.first_values(case.prices), fast.first_values(case.prices), atol=1e-9
        )


def soft_oracles(case: Case) -> list[SoftPathOracle]:
    made = [o for o in oracles(case) if isinstance(o, SoftPathOracle)]
    assert made
    return made


@pytest.mark.parametrize("rule", ["strict", "idle is free"])
@pytest.mark.parametrize("kind", ["plain", "signed"])
def test_soft_values_bound_the_hard_ones_and_usage_is_their_slope(rule: str, kind: str) -> None:
    """Soft values lie above the hard ones, approach them, and -usage is their derivative by the prices."""
    for seed in range(6):
        case = make_case(seed, rule, kind=kind)
        for made in soft_oracles(case):
            hard, _ = made.best_paths(case.prices)
            for temperature in (0.3, 0.02):
                temperature = max(temperature, 1.05 * made.coldest)
                values, usage = made.soft_paths(case.prices, temperature)
                assert (values >= hard - 1e-9).all()
                np.testing.assert_allclose(usage.sum(axis=1), made.shape[1], atol=1e-4)
                if case.prices.min() > 1e-4 or temperature > 0.1:
                    _check_slope(made, case.prices, temperature, usage)
            cold, _ = made.soft_paths(case.prices, max(1e-3, 1.01 * made.coldest))
            paths = case.benefits.shape[0] * math.log(2.0 * case.benefits.shape[2])
            assert (cold <= hard + 1.01 * max(1e-3, 1.01 * made.coldest) * 2 * paths).all()


def _check_slope(made: SoftPathOracle, prices: np.ndarray, temperature: float, usage: np.ndarray) -> None:
    h = 1e-5
    for k, j in itertools.product(range(prices.shape[0]), range(prices.shape[1])):
        up, down = prices.copy(), prices.copy()
        up[k, j] += h
        down[k, j] -= h
        rise = made.soft_paths(up, temperature)[0].sum() - made.soft_paths(down, temperature)[0].sum()
        assert -rise / (2 * h) == pytest.approx(usage[k, j], abs=1e-4)


def test_soft_paths_stay_finite_where_all_prices_are_high() -> None:
    """Long horizons, high and uneven prices and low temperatures: weights far outside the range of floats."""
    rng = np.random.default_rng(5)
    T, n, m = 60, 6, 90
    benefits = np.where(rng.random((T, n, m)) < 0.03, rng.random((T, n, m)) * 2, 0.0)
    prices = rng.random((T, m)) * 3
    prices[np.arange(T), rng.integers(0, m, T)] = 0.0
    for idle_is_free in (False, True):
        made = oracle(benefits, SwitchingCost(0.5, idle_is_free), None)
        assert isinstance(made, SoftPathOracle)
        hard, _ = made.best_paths(prices)
        values, usage = made.soft_paths(prices, 0.002)
        assert np.isfinite(usage).all()
        np.testing.assert_allclose(usage.sum(axis=1), n, atol=1e-4)
        assert (values >= hard - 1e-6).all()
        assert (values <= hard + 0.5).all()


def test_switching_cost_offers_the_oracle() -> None:
    """The hook of the dynamics leads here."""
    problem = SAP(np.ones((2, 1, 2)), SwitchingCost(0.5))
    made = problem.model.path_oracle(problem.benefits, problem.initial_state())
    assert isinstance(made, PathOracle)
    assert made.shape == (2, 1, 2)


def test_what_makes_no_sense_is_refused() -> None:
    """Prices of a wrong shape, a state of a wrong length, benefits of +inf."""
    made = oracle(np.ones((2, 1, 2)), SwitchingCost(0.5), None)
    with pytest.raises(ValueError, match="prices"):
        made.best_paths(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="state"):
        oracle(np.ones((2, 1, 2)), SwitchingCost(0.5), [0, 1])
    with pytest.raises(ValueError, match="state"):
        oracle(np.ones((2, 1, 2)), SwitchingCost(0.5), [2])
    with pytest.raises(ValueError, match="benefits"):
        oracle(np.full((2, 1, 2), np.inf), SwitchingCost(0.5), None)
    with pytest.raises(ValueError, match="cost"):
        oracle(np.ones((2, 1, 2)), SwitchingCost(np.zeros((3, 3))), None)


class _Wandering:
    """A local model drawn at random: states with arbitrary successors and gains, most tasks alike, some forbidden."""

    def __init__(self, seed: int, shape: tuple[int, int, int], states: int = 4) -> None:
        rng = np.random.default_rng(seed)
        T, n, m = shape
        size = (T, n, states, m)
        own = rng.random((T, n, 1, m)) < 0.4
        successor = np.where(own, rng.integers(0, states, size), rng.integers(0, states, (*size[:3], 1)))
        handover = np.where(own, rng.normal(size=size), rng.normal(size=(*size[:3], 1)))
        forbidden = own & (rng.random(size) < 0.2)
        self.successor, self.handover = successor, np.where(forbidden, -np.inf, handover)
        self.benefits = np.where(own[:, :, 0] & (rng.random((T, n, m)) < 0.7), rng.random((T, n, m)), 0.0)
        self.first = rng.integers(0, states, n)

    def state_count(self) -> int:
        return self.successor.shape[2]

    def start(self, agent: int) -> int:
        return int(self.first[agent])

    def step(self, k: int, agent: int, benefit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.successor[k, agent], self.handover[k, agent]


@pytest.mark.parametrize("seed", range(12))
def test_any_local_model_is_compiled(seed: int) -> None:
    """The compiled oracle gives the plain one's values: hard, from every first task, and in the limit soft."""
    model = _Wandering(seed, (5, 3, 6))
    made = compiled(Benefits(model.benefits), model)
    plain = LocalOracle(model.benefits, model)
    assert isinstance(made, SoftPathOracle)
    assert isinstance(made, FirstValueOracle)
    prices = np.random.default_rng(seed).random((5, 6))
    values, plan = made.best_paths(prices)
    np.testing.assert_allclose(values, plain.best_paths(prices)[0], atol=1e-9)
    np.testing.assert_allclose(made.first_values(prices), plain.first_values(prices), atol=1e-9)
    for i in range(3):
        state, total = model.start(i), 0.0
        for k, j in enumerate(plan[:, i]):
            total += model.benefits[k, i, j] + model.handover[k, i, state, j] - prices[k, j]
            state = model.successor[k, i, state, j]
        assert total == pytest.approx(values[i], abs=1e-9)
    soft, usage = made.soft_paths(prices, 1e-3)
    np.testing.assert_allclose(soft, values, atol=0.02)
    np.testing.assert_allclose(usage.sum(axis=1), 3.0, atol=1e-9)


def test_a_model_that_cannot_be_compressed_stays_plain(caplog: pytest.LogCaptureFixture) -> None:
    """The log says that its paths are slow."""
    model = _Wandering(0, (5, 3, 6))
    assert model_graph(model, Benefits(model.benefits), most=10) is None
    with pytest.MonkeyPatch.context() as patch, caplog.at_level(logging.WARNING):
        patch.setattr(model_graph, "__defaults__", (10,))
        assert isinstance(compiled(Benefits(model.benefits), model), LocalOracle)
    assert "too many arcs" in caplog.text


def test_states_alone_give_bounds_and_dual_solvers() -> None:
    """A dynamics with nothing but a `local_model`: bound, dual lookahead and dual decomposition against brute force."""
    rng = np.random.default_rng(1)
    for _ in range(4):
        benefits = np.where(rng.random((4, 2, 4)) < 0.5, rng.random((4, 2, 4)), 0.0)
        problem = SAP(benefits, Tiring(0.7))
        exact = solve(problem, Exact(method="dp")).value
        assert exact - 1e-9 <= bound(problem).value <= exact + 0.7
        for solver in (DualLookahead(3), DualDecomposition(iterations=80, rounds=1, sweeps=5)):
            result = solve(problem, solver)
            assert exact - 0.5 <= result.value <= exact + 1e-9
        prices = bound(problem).prices
        assert prices is not None
        assert plain_bound(problem, prices) >= exact - 1e-9


def test_what_is_not_local_is_refused() -> None:
    """A global state has no paths."""
    with pytest.raises(ValueError, match="agent-local"):
        path_oracle(SAP(np.ones((2, 2, 3)), Dictator()).model, np.ones((2, 2, 3)), (0, 2, 3))
