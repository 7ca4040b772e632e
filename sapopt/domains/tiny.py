"""Tiny problems of every kind: each built-in dynamics with its variants, benefits dense and sparse.

Running a method on all of them compiles every kernel that it may ever need (`sapopt warm`), and shows in a second that
it takes what it says it takes. A dynamics that joins `sapopt.dynamics.registry` gets its problem here; a test counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray
from sapopt.dynamics.base import Model
from sapopt.dynamics.battery.model import Battery
from sapopt.dynamics.copies.model import SyntheticSwitching
from sapopt.dynamics.joint.dictator import Dictator
from sapopt.dynamics.joint.interference import Interference
from sapopt.dynamics.registry import BUILT_IN
from sapopt.dynamics.rules.in_a_row import AtMostInARow
from sapopt.dynamics.rules.jobs import Jobs
from sapopt.dynamics.rules.ride_hailing import RideHailing
from sapopt.dynamics.rules.slewing import SlewCost
from sapopt.dynamics.rules.unit_commitment import UnitCommitment
from sapopt.dynamics.rules.waiting_rides import WaitingRides
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.problem.sap import SAP

_STEPS, _AGENTS, _TASKS = 5, 3, 6


def tiny_problems() -> Iterator[tuple[str, SAP]]:
    """Names such as ``Battery, sparse`` and the problems, all of one size.

    Raises
    ------
    ValueError
        If a built-in dynamics has no problem here.
    """
    missing = sorted(set(BUILT_IN.values()) - set(_MODELS), key=lambda cls: cls.__name__)
    if missing:
        raise ValueError(f"no tiny problem of {missing[0].__name__}; add one to {__name__}")
    for cls, models in _MODELS.items():
        for model in models():
            benefits = _benefits()
            if cls in _OFFERED_ONCE:
                benefits *= np.arange(_STEPS)[:, None, None] == np.arange(_TASKS) % _STEPS
            yield f"{cls.__name__}, dense", SAP(benefits, model)
            yield f"{cls.__name__}, sparse", SAP([sp.csr_array(step) for step in benefits], model)
            yield (
                f"{cls.__name__}, begun",
                SAP([sp.csr_array(step) for step in benefits], model, np.arange(_AGENTS)),
            )


def _benefits() -> FloatArray:
    rng = np.random.default_rng(0)
    shape = (_STEPS, _AGENTS, _TASKS)
    return np.round(rng.random(shape), 1) * (rng.random(shape) < 0.4)


def _switching() -> list[Model]:
    costs = np.full((_TASKS, _TASKS), 0.3) - 0.3 * np.eye(_TASKS)
    return [SwitchingCost(0.3), SwitchingCost(0.3, idle_is_free=True), SwitchingCost(costs)]


def _copies() -> list[Model]:
    twins = np.arange(_TASKS) // 2
    return [
        SyntheticSwitching(0.3, forfeit=0.5, task_of=twins),
        SyntheticSwitching(0.3, agent_of=np.arange(_AGENTS) // 2),
    ]


def _interference() -> list[Model]:
    return [Interference(np.array([[0, 1], [2, 3]]), 0.2, 0.3)]


def _battery() -> list[Model]:
    return [Battery(0.3, 0.5, 0.25, 1.0), Battery(0.3, 0.5, 0.25, 1.0, pay_for="entries")]


def _dictator() -> list[Model]:
    values = np.random.default_rng(1).random((2, _AGENTS, _TASKS))
    return [Dictator(values, np.arange(2 * _TASKS).reshape(2, _TASKS) % 2)]


def _slewing() -> list[Model]:
    rng = np.random.default_rng(2)
    return [SlewCost(0.3, 7000.0 + rng.random((_STEPS, _AGENTS, 3)), 3000.0 * rng.random((_TASKS, 3)))]


def _riding() -> list[Model]:
    travel = np.array([[0, 1, 2], [1, 0, 1], [2, 1, 0]])
    ends = np.arange(_TASKS) % 3, (np.arange(_TASKS) + 1) % 3
    return [RideHailing(travel, *ends, np.arange(_AGENTS) % 3, 2, 0.3)]


def _committing() -> list[Model]:
    ones = np.ones(_AGENTS, np.int64)
    return [UnitCommitment(np.full(_AGENTS, 0.3), 2 * ones, ones, np.full(_AGENTS, 0.1), -ones)]


def _in_a_row() -> list[Model]:
    return [AtMostInARow(_STEPS, 0.1)]  # whoever works at every step may: policies need not know when to rest


def _jobs() -> list[Model]:
    return [Jobs(np.ones(_TASKS, np.int64), 0.1)]  # nobody is ever busy, as not all policies look at that


def _waiting() -> list[Model]:
    travel = np.array([[0, 1, 2], [1, 0, 1], [2, 1, 0]])
    ends = np.arange(_TASKS) % 3, (np.arange(_TASKS) + 1) % 3
    return [WaitingRides(travel, *ends, np.arange(_TASKS) % _STEPS, np.arange(_AGENTS) % 3, 0.3)]


_OFFERED_ONCE = {RideHailing}
"""Dynamics whose tasks may be worth something at one step only."""
_MODELS: dict[Any, Callable[[], list[Model]]] = {
    SwitchingCost: _switching,
    SyntheticSwitching: _copies,
    Battery: _battery,
    Interference: _interference,
    Dictator: _dictator,
    SlewCost: _slewing,
    RideHailing: _riding,
    UnitCommitment: _committing,
    AtMostInARow: _in_a_row,
    Jobs: _jobs,
    WaitingRides: _waiting,
}
