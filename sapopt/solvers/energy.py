"""Benefit matrices of agents on batteries that put a price on energy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.matrices import GainMatrix, Matrix
from sapopt.data.types import FloatArray
from sapopt.running.outlook import Outlook


def priced_work(outlook: Outlook, price: Callable[[FloatArray], FloatArray]) -> Matrix:
    """beta_hat, less a price for every pair that means work; work that would kill the agent is forbidden.

    Parameters
    ----------
    outlook : Outlook
    price : callable
        ``price(charge)`` gives the price (n,) of a step of work from the charge (n,) as a share of the capacity.

    Returns
    -------
    Matrix
        Sparse if the benefits are.

    Raises
    ------
    ValueError
        If the dynamics is not a `Battery`.
    """
    state, batteries = outlook.state, outlook.model.batteries()
    if batteries is None:
        raise ValueError(
            f"the dynamics must be a Battery, not {outlook.model.called}; without charge there is "
            "no energy to price"
        )
    levels, units = batteries.levels_of(state), batteries.units
    toll = price(levels / units.capacity)
    toll = np.where(levels <= units.drain, np.inf, toll)  # of the living, see `works`
    benefit = outlook.benefits(1).step(0)
    if isinstance(benefit, np.ndarray):
        works = (benefit > 0) & (levels > 0)[:, None]
        hat: FloatArray = dense_step(outlook.beta_hat())
        return np.where(works, hat - toll[:, None], hat)
    from sapopt.kernels.windows import window_gains

    n, m = benefit.shape
    agents = np.repeat(np.arange(n), np.diff(benefit.indptr))
    moves = (benefit.indices != batteries.serving(state)[agents]) & (not batteries.is_first(state))
    worth = np.where(levels[agents] > 0, benefit.data - batteries.cost * moves - toll[agents], 0.0)
    gains = np.where(benefit.data > 0, worth, benefit.data)
    negative = bool(gains.min(initial=0.0) < 0)
    row_start, tasks, gains = window_gains(
        benefit.indptr.astype(np.int64), benefit.indices, gains, 0, 1, n, m, 0.0
    )
    return GainMatrix(row_start, tasks, gains, np.full(n, -1), np.zeros(n), 0.0, m, negative)
