"""Bids as actions (Holder 2024, section 7.2): agents say what tasks are worth to them, and alpha of the bids is played.

A shared network names each agent's bid for every task that it lists, and for any other. In training the bids are drawn
around those (a Gaussian policy), the assignment is alpha of what was drawn, so it is always feasible, and the network
is improved by the clipped objective of Schulman et al. (2017). REDA's values say what an agent will earn, because they
are trained to; bids are whatever pays. If every agent is paid for itself, nothing keeps it from bidding more than a
task is worth to it.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch

from sapopt.data.types import FloatArray
from sapopt.learning.actor_critic import ActorCritic
from sapopt.learning.choices import legal
from sapopt.learning.environment import Environment
from sapopt.learning.ippo import advantages
from sapopt.learning.learner import assigned
from sapopt.learning.logs import TrainingLog
from sapopt.learning.network import Network
from sapopt.learning.observation import Spec, ThesisObservation
from sapopt.learning.options import FRESH, Problems
from sapopt.learning.train import Training
from sapopt.problem.sap import SAP
from sapopt.running.control import Run

Reward = Literal["common", "own"]


@dataclass(frozen=True)
class BidOptions:
    """Options of a training of bids.

    Parameters
    ----------
    episodes, gathered : int
        Episodes in all, and those after which the network is improved.
    epochs : int
        Gradient steps on the gathered episodes.
    spread : float
        Deviation of the bids in training, positive.
    reward : {"common", "own"}
        What an agent is paid: the mean over all agents, or what it earns itself.
    learning_rate, discount, trace, ratio, clip : float
        As in `sapopt.learning.ippo.PPOOptions`.
    hidden, spec, seed, evaluate_every, evaluations, checkpoint_every
        As in `TrainOptions`; in episodes, and rounded up to the next improvement.
    """

    episodes: int = 400
    gathered: int = 4
    epochs: int = 4
    spread: float = 0.3
    reward: Reward = "common"
    learning_rate: float = 1e-3
    discount: float = 0.97
    trace: float = 0.9
    ratio: float = 0.2
    clip: float = 10.0
    hidden: tuple[int, ...] = (64, 64)
    spec: Spec = field(default_factory=ThesisObservation)
    seed: int = 0
    evaluate_every: int = 20
    evaluations: int = 2
    checkpoint_every: int = 20

    def __post_init__(self) -> None:
        for name in ("episodes", "gathered", "epochs", "evaluate_every", "evaluations", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("discount", "trace", "ratio"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie between 0 and 1, got {getattr(self, name)}")
        for name in ("spread", "learning_rate", "clip"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if self.reward not in get_args(Reward):
            raise ValueError(f"reward must be one of {', '.join(get_args(Reward))}, got {self.reward!r}")


@dataclass(frozen=True, eq=False)
class Bidden:
    """An episode of bids.

    Attributes
    ----------
    observations : ndarray of float32, shape (T, n, size)
    mask : ndarray of bool, shape (T, n, M + 1)
        Bids that stand for a task.
    bids : ndarray of float32, shape (T, n, M + 1)
    rewards : ndarray of float64, shape (T, n)
        What every agent earned itself.
    """

    observations: np.ndarray
    mask: np.ndarray
    bids: np.ndarray
    rewards: FloatArray


def play_bids(
    problem: SAP, actor: Network, spread: float = 0.0, rng: np.random.Generator | None = None
) -> Bidden:
    """Play an episode: alpha of the bids at every step.

    Parameters
    ----------
    problem : SAP
    actor : Network
        Its outputs are bids, in the order of the tasks that an agent lists, then one for any other task.
    spread : float
        Deviation of the draws around them; 0 plays the bids themselves.
    rng : Generator, optional
        Draws the bids; not needed without spread.
    """
    env = Environment(problem)
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, FloatArray]] = []
    while not env.done:
        seen, listed = env.observe(actor.spec)
        bids = actor.values(seen)
        if spread and rng is not None:
            bids = bids + (spread * rng.standard_normal(bids.shape)).astype(np.float32)
        rows.append((seen, legal(listed), bids, env.step(assigned(bids, listed, problem.m))))
    return Bidden(*(np.stack(column) for column in zip(*rows, strict=True)))


def train_bids(
    problems: Problems, options: BidOptions, folder: str | Path, run: Run | None = None
) -> Training:
    """Train a network whose outputs are bids; `sapopt.learning.REDA` plays it like one of values.

    Parameters
    ----------
    problems : callable
        ``problems(seed)`` makes the problem of an episode.
    options : BidOptions
    folder : path
        For the log and the checkpoint. A run that was killed goes on from its checkpoint, and ends as one without a
        break does, bit for bit (on one machine, with the same number of threads).
    run : Run, optional
        Clock and callback; when it expires, a checkpoint is written.

    Raises
    ------
    ValueError
        If the folder holds a checkpoint of other options or shapes, or a damaged one.
    """
    run = run or Run()
    state = ActorCritic.begin(
        options.spec, options.seed, options.hidden, options.learning_rate, asdict(options) | {"method": "bids"},
        Path(folder), stream=2,
    )  # fmt: skip
    with TrainingLog(Path(folder), state.done) as record:
        while state.done < options.episodes and not run.expired:
            began = time.perf_counter()
            seeds = range(state.done, min(state.done + options.gathered, options.episodes))
            played = [
                play_bids(problems(options.seed * 100_000 + seed), state.actor, options.spread, state.rng)
                for seed in seeds
            ]
            state.scale = state.scale or max(float(played[0].rewards.std()), 1e-6)
            loss = _improve(played, state.scale, state.actor, state.critic, state.adam, options)
            before, state.done = state.done, seeds.stop
            row = {
                "episode": state.done, "steps": state.done * len(played[0].rewards),
                "gradient_steps": -(-state.done // options.gathered) * options.epochs, "epsilon": 0.0,
                "value": float(np.mean([one.rewards.sum() for one in played])), "loss": loss,
            }  # fmt: skip
            if _passes(before, state.done, options.evaluate_every) or state.done == options.episodes:
                fresh = [problems(FRESH + seed) for seed in range(options.evaluations)]
                row["evaluation"] = float(np.mean([play_bids(p, state.actor).rewards.sum() for p in fresh]))
                state.keep_if_best(row["evaluation"])
            row["seconds"] = time.perf_counter() - began
            record.write(row)
            run.report(state.done, options.episodes, row.get("evaluation", row["value"]), message="training")
            if _passes(before, state.done, options.checkpoint_every):
                state.save(record)
        state.save(record)
    return Training(state.best, state.best_value, state.done, state.actor)


def _passes(before: int, after: int, every: int) -> bool:
    """Whether a multiple of `every` lies above `before` and not above `after`."""
    return after // every > before // every


def _improve(
    played: list[Bidden],
    scale: float,
    actor: Network,
    critic: Network,
    adam: torch.optim.Adam,
    options: BidOptions,
) -> float:
    gains, goals = [], []
    for one in played:
        earned = (
            one.rewards
            if options.reward == "own"
            else one.rewards.mean(axis=1, keepdims=True) + 0 * one.rewards
        )
        with torch.no_grad():
            values = critic(torch.from_numpy(one.observations))[..., 0].numpy()
        gain = advantages((earned / scale).astype(np.float32), values, options.discount, options.trace)
        gains.append(gain.ravel())
        goals.append((gain + values).ravel())
    gain, goal = (torch.from_numpy(np.concatenate(parts)) for parts in (gains, goals))
    gain = (gain - gain.mean()) / (gain.std() + 1e-8)
    seen, mask, bids = (
        torch.from_numpy(
            np.concatenate([getattr(one, name).reshape(-1, getattr(one, name).shape[-1]) for one in played])
        )
        for name in ("observations", "mask", "bids")
    )

    def likelihood() -> torch.Tensor:
        """Logarithm of the density of the bids that stand for tasks, up to a constant."""
        away = torch.where(mask, (bids - actor(seen)) / options.spread, torch.zeros_like(bids))
        return -0.5 * (away * away).sum(dim=1)

    with torch.no_grad():
        before = likelihood()
    losses = []
    for _ in range(options.epochs):
        ratio = torch.exp(likelihood() - before)
        held = ratio.clamp(1 - options.ratio, 1 + options.ratio)
        value = torch.nn.functional.mse_loss(critic(seen)[:, 0], goal)
        loss = -torch.minimum(ratio * gain, held * gain).mean() + 0.5 * value
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], options.clip)
        adam.step()
        losses.append(float(loss.detach()))
    return float(np.mean(losses))
