"""Longest priced paths of agents under a `SyntheticSwitching` that is local to the agents.

The charge of a move depends on where it leads, never on where it comes from, so one maximum over all tasks serves every
state: O(T m) an agent. Where an agent must see what it acquires and idling costs nothing, the tasks out of sight are
alike, and O(T (R + tasks in sight)) is enough (`seen`), R the number of real tasks; O(tasks in sight) when smoothed.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.dynamics.copies import hard as kernels
from sapopt.dynamics.copies import seen as seen
from sapopt.dynamics.paths.rows import most_entries
from sapopt.dynamics.paths.window import checked_prices, coldest_temperature, flat_benefits
from sapopt.kernels.blocks import summed_in_blocks

if TYPE_CHECKING:
    from sapopt.dynamics.copies.model import SyntheticSwitching


class SyntheticPaths:
    """Path oracle (`sapopt.dynamics.paths.oracles.SoftPathOracle` and `FirstValueOracle`).

    Parameters
    ----------
    benefits : Benefits or (T, n, m) float array
        The window's benefits.
    dynamics : SyntheticSwitching
        Without copies of agents.
    state : (n,) int array or None
        Real tasks held before the first step, -1 for none; None makes the first step free.
    """

    def __init__(self, benefits: Any, dynamics: SyntheticSwitching, state: IntArray | None) -> None:
        indptr, indices, data, self._shape = flat_benefits(benefits)
        _, n, m = self._shape
        real = np.ascontiguousarray(dynamics.real_tasks(m), dtype=np.int64)
        count = int(real.max()) + 1
        if state is None:
            start = np.full(n, count + 1, dtype=np.int64)
        else:
            start = np.where(state < 0, count, state).astype(np.int64)
        self.window = kernels.Window(
            n, indptr, indices, data, real, count, float(dynamics.cost), float(dynamics.forfeit),
            bool(dynamics.idle_is_free), bool(dynamics.needs_sight), start,
        )  # fmt: skip
        self.sparse = dynamics.needs_sight and (self.window.cost == 0.0 or self.window.idle_is_free)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self._shape

    @property
    def scale(self) -> float:
        """Typical size of a benefit: root mean square of the finite entries (1 if there are none)."""
        return root_mean_square(self.window.data)

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats.

        Any will do where only tasks in sight matter, for logarithms of weights stand there.
        """
        if self.sparse:
            return 0.0
        highest = float(np.max(self.window.data[np.isfinite(self.window.data)], initial=0.0))
        return coldest_temperature(self.window.cost + max(self.window.forfeit, 1e-2) * highest)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        return self._paths(np.arange(self._shape[1]), prices)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        values, plan = self._paths(np.array([agent]), prices)
        return float(values[0]), plan[:, 0]

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        out, p = np.empty(self._shape[1:]), self._prices(prices)
        if self.sparse:
            seen.first_values(self.window, p, np.argsort(p, axis=1), out)
        else:
            kernels.first_values(self.window, p, out)
        return out

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite.

        Not numbers where the weights of all tasks that an agent may hold vanish beside those of forbidden ones: a step
        of the ascent that led there is taken back.
        """
        p = self._prices(prices)
        # Every agent holds one task at every step, so what all tasks of a step cost alike changes no choice.
        alike = p.min(axis=1)
        p = p - alike[:, None]
        weight = np.exp(-p / temperature)
        if self.sparse:
            values, usage = self._soft_in_sight(p, weight, float(temperature))
        else:
            values, usage = np.empty(self._shape[1]), np.zeros(p.shape)
            kernels.soft_paths(self.window, p, weight, float(temperature), values, usage)
        return values - alike.sum(), usage

    def _soft_in_sight(
        self, p: FloatArray, weight: FloatArray, temperature: float
    ) -> tuple[FloatArray, FloatArray]:
        """`soft_paths` by what is in sight alone."""
        T, n, m = self._shape
        values = np.empty(n)
        usage, common = summed_in_blocks(
            seen.soft_paths, n, ((T, m), (T,)), self.window, p, weight, weight.sum(axis=1), temperature, values,
            scratch=partial(seen.seen_scratch, T, m, self.window.real_count, most_entries(self.window.indptr, n)),
            turns=20.0 * len(self.window.data),
        )  # fmt: skip
        usage += weight * common[:, None]
        np.maximum(usage, 0.0, out=usage)
        if np.isnan(values).any():
            values[:], usage[:] = np.nan, np.nan
        return values, usage

    def _paths(self, agents: IntArray, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        values = np.empty(len(agents))
        plan = np.empty((self._shape[0], len(agents)), dtype=np.int64)
        p = self._prices(prices)
        if self.sparse:
            # Sorting pays where many agents look for their cheapest task.
            order = np.argsort(p, axis=1) if len(agents) > 1 else np.empty((len(p), 0), dtype=np.int64)
            seen.paths(agents, self.window, p, order, values, plan)
        else:
            kernels.paths(agents, self.window, p, values, plan)
        return values, plan

    def _prices(self, prices: FloatArray) -> FloatArray:
        return checked_prices(prices, self._shape)
