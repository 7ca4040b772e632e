"""Economic dispatch of running units with ramps and reserve: what a plan of unit commitment is worth in a plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray
from sapopt.formulations.highs import Ending, Programme, maximise

if TYPE_CHECKING:
    from sapopt.domains.unit_commitment import PowerSystem

_NOT_COUNTED = ("the grid", "losses", "start-up ramps beyond the least output")
_SPILL = 1e-3
"""Price of energy that must run and finds no demand, in parts of energy that is not served."""


@dataclass(frozen=True, eq=False)
class Dispatch:
    """Outputs of the running units, and what they cannot serve.

    Attributes
    ----------
    output_mw : ndarray, shape (T, n)
    shed_mwh, spilt_mwh : float
        Demand that is not served; energy that must run and finds no demand.
    reserve_short_mwh : float
        What is missing of the reserve.
    demand_mwh : float
    counted, not_counted : tuple of str
        What this calculation minds, and what it leaves out.
    """

    output_mw: FloatArray
    shed_mwh: float
    spilt_mwh: float
    reserve_short_mwh: float
    demand_mwh: float
    counted: tuple[str, ...]
    not_counted: tuple[str, ...]

    @property
    def served_share(self) -> float:
        """Served energy in parts of the demand."""
        return 1.0 - self.shed_mwh / self.demand_mwh if self.demand_mwh else 1.0

    def __str__(self) -> str:
        return (
            f"{100 * self.served_share:.2f} % of {self.demand_mwh:,.0f} MWh served, {self.shed_mwh:,.0f} MWh shed; "
            f"counted: {', '.join(self.counted)}; not counted: {', '.join(self.not_counted)}"
        )


def dispatch(system: PowerSystem, on: np.ndarray, ramp_mw: Any, reserve_mw: Any) -> Dispatch:
    """The outputs that shed least, as a linear programme; see `PowerSystem.dispatch`."""
    T, n = on.shape
    ramp = _limit(ramp_mw, n, "ramp_mw", np.inf)
    reserve = _limit(reserve_mw, T, "reserve_mw", 0.0)
    least, most = system.least_mw, system.most_mw
    count = T * n
    # Columns: output above the least (T, n), shed (T,), spilt (T,), missing reserve (T,).
    over, shed, spilt, short = (
        np.arange(count).reshape(T, n),
        *(count + T * i + np.arange(T) for i in range(3)),
    )
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, float, float]] = []

    def add(columns: Any, entries: Any, low: float, high: float) -> None:
        columns = np.asarray(columns)
        rows.append((np.full(len(columns), len(rows)), columns, np.asarray(entries, dtype=float), low, high))

    for k in range(T):
        base = float(least[on[k]].sum())
        balance = float(system.demand_mw[k]) - base
        add([*over[k], shed[k], spilt[k]], [*np.ones(n), 1.0, -1.0], balance, balance)
        room = float((most - least)[on[k]].sum())
        add([*over[k], short[k]], [*np.ones(n), -1.0], -np.inf, room - float(reserve[k]))
        for i in np.flatnonzero(np.isfinite(ramp)) if k else ():
            if on[k, i] and on[k - 1, i]:
                add([over[k, i], over[k - 1, i]], [1.0, -1.0], -float(ramp[i]), float(ramp[i]))
            elif on[k, i] or on[k - 1, i]:
                add([over[k if on[k, i] else k - 1, i]], [1.0], 0.0, float(ramp[i]))
    row, column, entry = (np.concatenate([one[part] for one in rows]) for part in range(3))
    matrix = sp.csr_array((entry, (row, column)), shape=(len(rows), count + 3 * T))
    gain = np.concatenate([np.zeros(count), np.full(T, -1.0), np.full(T, -_SPILL), np.full(T, -0.5)])
    # Energy is spilt only where the least outputs exceed the demand, not to climb ahead of it.
    surplus = np.maximum((on * least).sum(axis=1) - system.demand_mw, 0.0)
    upper = np.concatenate([(on * (most - least)).ravel(), np.full(T, np.inf), surplus, np.full(T, np.inf)])
    low, high = (np.array([one[part] for one in rows]) for part in (3, 4))
    answer = maximise(
        Programme(gain, matrix, low, high, upper, np.zeros(count + 3 * T, dtype=bool)), relaxed=True
    )
    # Shedding and spilling are always possible, so there is an optimum.
    assert answer.ending is Ending.OPTIMAL
    assert answer.x is not None
    hours = system.step_h
    counted = ["minimum up and down times", "least and greatest outputs"]
    counted += ["ramps"] if ramp_mw is not None else []
    counted += ["reserve"] if reserve_mw is not None else []
    missing = [name for name, given in (("ramps", ramp_mw), ("reserve", reserve_mw)) if given is None]
    x = answer.x
    return Dispatch(
        on * least + x[over], hours * float(x[shed].sum()), hours * float(x[spilt].sum()),
        hours * float(x[short].sum()), hours * float(system.demand_mw.sum()), tuple(counted),
        (*missing, *_NOT_COUNTED),
    )  # fmt: skip


def _limit(given: Any, count: int, name: str, default: float) -> FloatArray:
    values = np.asarray(default if given is None else given, dtype=np.float64)
    if (
        values.ndim > 1
        or (values.ndim and values.shape != (count,))
        or np.isnan(values).any()
        or (values < 0).any()
    ):
        raise ValueError(
            f"{name} must be one number or {count} of them, not negative, got shape {values.shape}"
        )
    return np.broadcast_to(values, (count,))
