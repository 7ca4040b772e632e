"""The guarantee computed anew: equal to the one that is made, and to brute force; nothing is shared between the two."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from own_conditions import Tired
from test_package import PACKAGE, imports

from sapopt import SAP, CertificateError, SwitchingCost, certify, solve, verify
from sapopt.proofs.guarantees import guarantee
from sapopt.proofs.plain_guarantee import Pairs, _proven, plain_guarantee
from sapopt.solvers import HAA

SCALES = (1e-300, 1e-12, 1.0, 1e12, 1e150)


def drawn(seed: int) -> SAP:
    """Problems of all kinds: forms, scales, signs, forbidden pairs, costs of every shape, free idling, a start."""
    rng = np.random.default_rng(seed)
    T, n = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    m = n + int(rng.integers(0, 3))
    scale = float(rng.choice(SCALES))
    values = scale * (
        rng.random((T, n, m)), rng.integers(0, 3, (T, n, m)) * 1.0,
        rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.4), rng.random((T, n, m)) - 0.3,
        np.where(rng.random((T, n, m)) < 0.1, -np.inf, 1.0 + rng.random((T, n, m))),
    )[seed % 5]  # fmt: skip
    costs: tuple[Any, ...] = (0.0, 0.5 * scale, scale * rng.random((m, m)) * (1 - np.eye(m)))
    rows = np.repeat(scale * rng.random((m, 1)), m, axis=1) * (1 - np.eye(m))
    rule = SwitchingCost((*costs, rows, scale * (1 - np.eye(m)))[int(rng.integers(5))], bool(rng.integers(2)))
    form: Any = [sp.csr_array(step) for step in values] if seed % 2 and np.isfinite(values).all() else values
    return SAP(form, rule, rng.permutation(m)[:n] if rng.integers(2) else None)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 10**6))
def test_equal_to_the_guarantee_that_is_made(seed: int) -> None:
    """Every number to rounding and every condition to the letter, at any scale."""
    try:
        problem = drawn(seed)
    except ValueError:  # forbidden pairs may leave no plan
        return
    made, plain = guarantee(problem), plain_guarantee(problem)
    assert made.excess(plain) == plain.excess(made) == ""
    assert repr(made.conditions) == repr(plain.conditions)


@pytest.mark.parametrize("dynamics", [Tired(True), Tired(False)])
def test_equal_for_rules_of_users(dynamics: Any) -> None:
    """Conditions read off the states, with those that are unknown."""
    for shape in ((3, 2, 3), (1, 2, 3)):
        problem = SAP(np.random.default_rng(0).random(shape), dynamics)
        assert repr(guarantee(problem)) == repr(plain_guarantee(problem))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6))
def test_against_all_assignments(seed: int) -> None:
    """Least benefit and |H| are those over all (pairs of) assignments; the ratios follow."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 3)), 3
    cost = rng.integers(0, 5, (m, m)) * (1 - np.eye(m))
    problem = SAP(rng.integers(0, 9, (3, n, m)) * 1.0, SwitchingCost(cost))
    every = [list(x) for x in itertools.permutations(range(m), n)]
    worth = [[step[range(n), x].sum() for x in every] for step in problem.benefits.dense()]
    dearest = max(cost[a, b].sum() for a in every for b in every)
    plain = plain_guarantee(problem)
    assert plain.least_benefit == min(map(min, worth))
    assert plain.handover_size == dearest
    assert plain.ratio == pytest.approx(
        1.0 if dearest == 0 else plain.least_benefit / (plain.least_benefit + dearest)
    )
    most = sum(map(max, worth))
    sure = sum(max(min(step), max(step) - dearest) for step in worth)
    assert plain.refined_ratio == pytest.approx(max(0.0, sure / most) if most else 0.0)


def test_a_wrong_guess_is_not_proven() -> None:
    """Prices come down to the best assignment alone, whether agents may pass or not."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        worth = rng.integers(1, 9, (3, 4)) * 1.0
        agent, task = np.nonzero(worth)
        pairs = Pairs(agent, task, worth[agent, task])
        every = [np.array(x) for x in itertools.permutations(range(4), 3)]
        best = max(worth[range(3), x].sum() for x in every)
        for x in every:
            for can_pass in (True, False):
                if worth[range(3), x].sum() == best:
                    assert _proven(pairs, x, 3, 4, can_pass=can_pass) == best
                else:
                    with pytest.raises(ValueError, match="cannot be proven"):
                        _proven(pairs, x, 3, 4, can_pass=can_pass)


def test_nothing_is_shared_with_what_makes_it() -> None:
    """The module imports the problem, its types and the definitions, and these definitions import nothing of sapopt."""
    used = {name.rpartition(".")[0] for name in imports(PACKAGE / "proofs" / "plain_guarantee.py")}
    assert {name for name in used if name.startswith("sapopt")} == {
        "sapopt.data.benefits", "sapopt.data.types", "sapopt.dynamics.base", "sapopt.problem.sap",
        "sapopt.proofs.promises",
    }  # fmt: skip
    assert not {name for name in imports(PACKAGE / "proofs" / "promises.py") if name.startswith("sapopt")}


def test_verify_does_not_ask_what_made_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A maker that promises too much is found out by `verify`."""
    problem = SAP(1.0 + np.random.default_rng(0).random((3, 2, 3)), SwitchingCost(0.5))

    def boastful(problem: SAP) -> Any:
        return dataclasses.replace(guarantee(problem), ratio=0.999)

    monkeypatch.setattr("sapopt.proofs.certificate.guarantee", boastful)
    certify(problem, solve(problem, HAA())).save(tmp_path / "c.npz")
    with pytest.raises(CertificateError, match="promises a ratio"):
        verify(tmp_path / "c.npz", problem)


def test_what_is_not_said_promises_nothing() -> None:
    """Without a size of handovers c is unknown and both ratios are 0."""
    plain = plain_guarantee(SAP(np.ones((3, 2, 3)), Tired(False)))
    assert math.isnan(plain.c)
    assert plain.ratio == plain.refined_ratio == 0.0
