"""Softened longest paths where the cost of a move depends on both tasks: products of matrices.

With the weights ``exp(-cost / eps)`` of the moves in one matrix, a step of the recursion of all agents is one product,
which numpy hands to a tuned library; no kernel is compiled. The numbers of a step are divided by their sum, whose
logarithm is kept, so that none leaves the range of floats.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray
from sapopt.dynamics.switching.layout import Window

_AT_ONCE = 4_000_000
"""Most numbers of the agents' recursions that are in memory at a time."""


def soft_matrix_paths(
    window: Window, idle_is_free: bool, prices: FloatArray, temperature: float
) -> tuple[FloatArray, FloatArray]:
    """Soft values (n,) and expected usage (T, m) at `prices` (T, m), which must be finite."""
    (T, m), n = prices.shape, window.n
    values, usage = np.empty(n), np.zeros((T, m))
    rows = sp.csr_array((window.data, window.indices, window.indptr), shape=(T * n, m))
    move = np.exp(-window.cost / temperature)
    size = max(1, _AT_ONCE // max(T * m, 1))
    with np.errstate(all="ignore"):  # what an agent may nowhere do has no weight at all: its value is -inf
        for first in range(0, n, size):
            agents = slice(first, min(first + size, n))
            benefit = np.stack([rows[k * n + agents.start : k * n + agents.stop].toarray() for k in range(T)])
            charged = benefit > 0.0 if idle_is_free else None
            values[agents], part = _of_agents(
                benefit, charged, prices, move, window.held[agents], temperature
            )
            usage += part
    return values, usage


def _of_agents(
    benefit: FloatArray,
    charged: np.ndarray | None,
    prices: FloatArray,
    move: FloatArray,
    held: np.ndarray,
    temperature: float,
) -> tuple[FloatArray, FloatArray]:
    """Soft values and usage of some agents with benefits (T, agents, m)."""
    T, agents, _ = benefit.shape
    weight = (benefit - prices[:, None, :]) / temperature
    top = weight.max(axis=2, keepdims=True)
    top[~np.isfinite(top)] = 0.0
    weight = np.exp(weight - top)
    logs = top[:, :, 0].sum(axis=0)
    ahead = np.empty_like(weight)
    for k in range(T):
        if k == 0:
            enter = np.where(held[:, None] >= 0, move[np.maximum(held, 0)], 1.0)
            free = 1.0
        else:
            enter, free = ahead[k - 1] @ move, 1.0  # the weights of a step add up to 1
        if charged is not None:
            enter = np.where(charged[k], enter, free)
        ahead[k] = enter * weight[k]
        total = ahead[k].sum(axis=1)
        ahead[k] /= np.maximum(total, 1e-300)[:, None]
        logs += np.log(total)
    usage = np.empty(prices.shape)
    later = np.ones((agents, prices.shape[1]))
    for k in range(T - 1, -1, -1):
        share = ahead[k] * later
        total = share.sum(axis=1, keepdims=True)
        usage[k] = np.where(total > 0.0, share / np.maximum(total, 1e-300), ahead[k]).sum(axis=0)
        entered = weight[k] * later
        if charged is None:
            later = entered @ move.T
        else:
            later = (entered * charged[k]) @ move.T + (entered * ~charged[k]).sum(axis=1, keepdims=True)
        later /= np.maximum(later.max(axis=1, keepdims=True), 1e-300)
    return temperature * logs, usage
