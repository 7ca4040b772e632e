"""What charge is worth: a terminal value for short windows, learned from the duals of whole episodes.

A window that ends at step k sees no use for the charge left then, and empties every battery. What the charge would
really have earned is known after the fact: under the task prices that solve the dual of a whole episode, the longest
path from level l at step k on is worth N_k[l] (see `sapopt.dynamics.battery.hard`). Averaged over agents and
episodes, by the number of steps that are left, this is a table that knows neither tasks nor agents, and serves for
episodes that were never seen.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from sapopt.data.files import write_text
from sapopt.data.types import FloatArray
from sapopt.problem.sap import SAP

_FORMAT = "sapopt-charge-value-1"


@dataclass(frozen=True, eq=False)
class ChargeValue:
    """Value of a charge by the steps that are left; the `end_value` of `DualLookahead`.

    Parameters
    ----------
    table : array_like, shape (R + 1, G)
        Entry ``[left, g]``: value of the share ``g / (G - 1)`` of the capacity when `left` steps are left. Beyond R
        steps the last row counts: only differences between levels matter then.
    about : str
        Where the table comes from.

    Raises
    ------
    ValueError
        If the table is not of this form.
    """

    table: FloatArray
    about: str = ""

    def __post_init__(self) -> None:
        table = np.asarray(self.table, dtype=np.float64)
        if table.ndim != 2 or table.shape[1] < 2 or not np.isfinite(table).all():
            raise ValueError(f"table must hold finite numbers (steps left, levels), got shape {table.shape}")
        object.__setattr__(self, "table", table)

    def __call__(self, problem: SAP, left: int) -> FloatArray:
        """Value of every level of the problem's batteries, `left` steps before the end."""
        row = self.table[min(left, len(self.table) - 1)]
        batteries = problem.model.batteries()
        if batteries is None:
            raise ValueError(f"problem: {problem.model.called} has no charge to value")
        levels = batteries.units.capacity + 1
        return np.asarray(np.interp(np.linspace(0, 1, levels), np.linspace(0, 1, len(row)), row))

    @classmethod
    def learn(cls, problems: Sequence[SAP], iterations: int = 600) -> ChargeValue:
        """Learn the table from whole episodes.

        Parameters
        ----------
        problems : sequence of SAP
            Episodes with one `Battery` and one horizon.
        iterations : int
            Of the dual of each episode.

        Raises
        ------
        ValueError
            If there are none, they have no batteries, or their horizons differ.
        """
        from sapopt.formulations.dual.ascent import ascend  # compiled code

        if not problems:
            raise ValueError("problems: at least one episode is needed")
        total: FloatArray | float = 0.0
        for problem in problems:
            batteries = problem.model.batteries()
            if batteries is None:
                raise ValueError(f"problems: {problem.model.called} has no charge to value")
            if problem.T != problems[0].T:
                raise ValueError("problems: all must have the same number of steps")
            oracle = batteries.path_oracle(problem.benefits, problem.initial_state())
            prices = ascend(oracle, max_iterations=iterations).prices
            total = total + oracle.mean_values(prices) / len(problems)
        return cls(np.asarray(total)[::-1], f"duals of {len(problems)} episodes of {problems[0].T} steps")

    def scaled(self, factor: float) -> ChargeValue:
        """The same with the differences between living levels multiplied by `factor`.

        The duals know the whole episode and make more of charge than a policy with a short window can; about three
        quarters serve `DualLookahead` best.

        Raises
        ------
        ValueError
            If `factor` is negative or not finite.
        """
        if not 0 <= factor < np.inf:
            raise ValueError(f"factor must be finite and not negative, got {factor}")
        table = self.table.copy()
        table[:, 1:] = table[:, 1:2] + factor * (table[:, 1:] - table[:, 1:2])
        return ChargeValue(table, f"{self.about}; differences of living levels times {factor:g}")

    def save(self, path: str | Path) -> None:
        """Write the table as JSON."""
        record = {"format": _FORMAT, "about": self.about, "table": np.round(self.table, 4).tolist()}
        write_text(path, json.dumps(record))

    @classmethod
    def load(cls, name: str | Path) -> ChargeValue:
        """Read a table: ``"power"``, which ships with sapopt, or a file written by `save`.

        Raises
        ------
        ValueError
            If the file is damaged or something else.
        """
        if str(name) == "power":
            data = (resources.files("sapopt.solvers") / "data" / "charge_value_power.json").read_bytes()
        else:
            data = Path(name).read_bytes()
        try:
            record = json.loads(data.decode("utf-8"))
            if record["format"] != _FORMAT:
                raise ValueError(f"format {record['format']!r}")
            return cls(np.array(record["table"], dtype=np.float64), str(record["about"]))
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"{name}: not a table of charge values ({error})") from None
