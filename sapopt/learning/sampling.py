"""Play an episode with a stochastic policy that all agents share: what IPPO and COMA learn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from sapopt.data.types import FloatArray, IntArray
from sapopt.learning.choices import legal, tasks_of
from sapopt.learning.environment import Environment
from sapopt.learning.network import Network
from sapopt.problem.sap import SAP

_NEVER = -1e9
"""Added to the logit of a choice that is not allowed."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """An episode of choices.

    Attributes
    ----------
    observations : ndarray of float32, shape (T, n, size)
    mask : ndarray of bool, shape (T, n, M + 1)
    choices, plan : ndarray of int64, shape (T, n)
        Slots, and the tasks they stand for.
    rewards : ndarray of float64, shape (T, n)
        Conflicts are shared.
    """

    observations: np.ndarray
    mask: np.ndarray
    choices: IntArray
    plan: IntArray
    rewards: FloatArray


def masked_logits(logits: torch.Tensor, mask: np.ndarray) -> torch.Tensor:
    """Log-probabilities of the allowed choices."""
    closed = torch.from_numpy(np.where(mask, 0.0, _NEVER).astype(np.float32))
    return torch.log_softmax(logits + closed, dim=-1)


def sample_episode(
    problem: SAP, actor: Network, rng: np.random.Generator | None, explore: float = 0.0
) -> Sampled:
    """Play one episode.

    Parameters
    ----------
    problem : SAP
    actor : Network
        Its outputs are logits of the choices.
    rng : Generator or None
        Draws the choices; None plays the most likely ones.
    explore : float
        Probability of a uniform allowed choice.
    """
    env = Environment(problem, conflicts_shared=True)
    rows: list[tuple[np.ndarray, np.ndarray, IntArray, IntArray, FloatArray]] = []
    while not env.done:
        seen, listed = env.observe(actor.spec)
        mask = legal(listed, problem.m)
        logits = np.where(mask, actor.values(seen).astype(np.float64), -np.inf)
        if rng is not None:
            flat = np.where(mask, 0.0, -np.inf)
            uniform = rng.random(len(mask)) < explore
            logits = np.where(uniform[:, None], flat, logits) + rng.gumbel(size=mask.shape)
        choices = logits.argmax(axis=1)
        tasks = tasks_of(choices, listed, problem.m)
        rows.append((seen, mask, choices, tasks, env.step(tasks)))
    return Sampled(*(np.stack(column) for column in zip(*rows, strict=True)))
