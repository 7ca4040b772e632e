"""REDA where the state is no previous assignment: what agents see of it, and that training works in every domain."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from rule_problems import MAKERS

from sapopt import SAP, SwitchingCost, solve
from sapopt.domains.instances import instance
from sapopt.dynamics import UnitCommitment
from sapopt.learning import (
    REDA,
    Environment,
    StateObservation,
    TrainOptions,
    load_network,
    save_network,
    train,
)
from sapopt.solvers import HAA, AssignmentPolicy, myopic

DOMAINS: dict[str, dict[str, Any]] = {
    "ride-hailing": {"drivers": 6, "requests": 30, "steps": 12, "width": 4},
    "attitude": {"steps": 8, "tasks": 20, "planes": 3, "per_plane": 4, "altitude_km": 1200.0},
    "unit-commitment": {"units": 6, "steps": 12, "shut_down": 0.25},
    "interference": {"steps": 8, "tasks": 60, "planes": 3, "per_plane": 8, "strength": 0.8},  # beta_hat(s, x)
}


def plain(problem: SAP, k: int, state: Any, spec: StateObservation) -> tuple[np.ndarray, np.ndarray]:
    """Observations and listed tasks by the definition, number by number."""
    T, n, m = problem.T, problem.n, problem.m
    M, N, L = spec.tasks, spec.neighbours, spec.steps
    window = np.zeros((L, n, m))
    window[: min(L, T - k)] = problem.benefits.dense()[k : k + L]
    known = (window != 0).any(axis=0)
    eta = problem.handover(k, state)
    window[0] += eta
    features = problem.model.features(state)
    rows, lists = [], []
    for i in range(n):
        best = sorted((j for j in range(m) if known[i, j]), key=lambda j: (-window[:, i, j].sum(), j))[:M]
        rank = {}
        for a in set(range(n)) - {i}:
            sums = [window[:, a, j].sum() if known[a, j] else 0.0 for j in best]
            if sums and max(sums) > 0:
                rank[a] = max(sums)
        near = sorted(rank, key=lambda a: (-rank[a], a))[:N]
        row = np.zeros((1 + N, M, L))
        facts = np.zeros((1 + N, spec.features))
        for q, a in enumerate([i, *near]):
            for s, j in enumerate(best):
                row[q, s] = window[:, a, j] / spec.unit
            if features is not None:
                facts[q] = features[a]
        rest = [window[0, i, j] for j in range(m) if not known[i, j]]
        idle = np.mean(rest) / spec.unit if rest else 0.0
        rows.append(np.concatenate([row.ravel(), [idle], facts.ravel()]))
        lists.append(best + [-1] * (M - len(best)))
    return np.array(rows), np.array(lists)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
def test_observation_is_the_definition(make: Any, seed: int) -> None:
    """Step after step of a plan, in every domain by rule, the observation is that of the definition."""
    problem = make(seed)
    spec = StateObservation.of(problem, tasks=3, neighbours=2, steps=2)
    env = Environment(problem)
    for tasks in solve(problem, HAA()).plan:
        seen, listed = env.observe(spec)
        wanted, lists = plain(problem, env.k, env.state, spec)
        assert seen.shape == (problem.n, spec.size)
        np.testing.assert_array_equal(listed, lists)
        np.testing.assert_allclose(seen, wanted, atol=1e-6)
        env.step(tasks)


@pytest.mark.parametrize("name", DOMAINS)
def test_reda_trains(name: str, tmp_path: Path) -> None:
    """A few episodes of Algorithm 4 in each domain: it plays assignments, its weights move, and a file keeps them."""

    def problems(seed: int) -> SAP:
        return instance(name, seed, **DOMAINS[name])

    spec = StateObservation.of(problems(0), tasks=8, neighbours=3, steps=2)
    options = TrainOptions.thesis(
        episodes=4, memory=3, hidden=(8,), spec=spec, standardise="common", evaluate_every=2, evaluations=1
    )
    training = train(problems, AssignmentPolicy(myopic), options, tmp_path / "run")
    assert training.episodes == 4
    assert np.isfinite(training.value)
    moved = [bool((a != b).any()) for a, b in zip(
        training.last.parameters(), train(problems, AssignmentPolicy(myopic), TrainOptions.thesis(
            episodes=1, memory=3, hidden=(8,), spec=spec, standardise="common", evaluations=1,
        ), tmp_path / "one").last.parameters(), strict=True)]  # fmt: skip
    assert any(moved)
    save_network(training.network, tmp_path / "w.safetensors")
    again = load_network(tmp_path / "w.safetensors")[0]
    assert again.spec == spec
    problem = problems(1_000_000)
    value = solve(problem, AssignmentPolicy(REDA(again))).value
    assert value == pytest.approx(training.value, rel=1e-5)


def test_features_tell_units_apart() -> None:
    """A unit that may not stop yet shows it; a driver shows when it is free."""
    model = SAP(np.ones((3, 2, 2)), UnitCommitment([1, 1], [4, 1], [2, 2], [1, 1], [-5, 1])).model
    problem = SAP(np.ones((3, 2, 2)), model)
    state = problem.initial_state()
    np.testing.assert_allclose(model.features(state), [[0.0, 0.0], [1.0, 0.0]])
    state = problem.transition(0, state, np.array([0, 1]))
    np.testing.assert_allclose(model.features(state), [[1.0, 0.75], [1.0, 0.0]])
    city = instance("ride-hailing", drivers=6, requests=30, steps=12, width=4)
    state, plan = city.initial_state(), solve(city, HAA()).plan
    assert not city.model.features(state).any()
    for k, tasks in enumerate(plan):
        state = city.transition(k, state, tasks)
        free = np.divmod(state.local, len(city.dynamics.travel))[0]
        shown = city.model.features(state)[:, 0]
        np.testing.assert_allclose(shown, np.maximum(free - k - 1, 0) / city.dynamics.patience)


def test_forbidden_pairs_are_not_listed() -> None:
    """Nor shown: their value is no number."""
    benefits = np.array([[[1.0, -np.inf, 2.0], [0.5, 1.0, -np.inf]]])
    problem = SAP(benefits, SwitchingCost(0.25), [0, 1])
    seen, listed = StateObservation(3, 1, 1).look(
        problem.benefits, 0, problem.model, problem.initial_state(), 0
    )
    np.testing.assert_array_equal(listed, [[2, 0, -1], [1, 0, -1]])
    np.testing.assert_allclose(seen[0, :3], [1.75, 1.0, 0.0])


def test_bad_input() -> None:
    for changes in ({"tasks": 0}, {"features": -1}, {"unit": 0.0}):
        with pytest.raises(ValueError, match=next(iter(changes))):
            StateObservation(**changes)
    problem = instance("unit-commitment", units=6, steps=12)
    with pytest.raises(ValueError, match=r"0 features.*declares 2; StateObservation\.of"):
        StateObservation().look(problem.benefits, 0, problem.model, problem.initial_state(), 0)
