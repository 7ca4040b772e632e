"""Training REDA: Algorithm 4 of Holder (2024) on arrays, resumable bit for bit."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch

from sapopt.assignment import best_assignment
from sapopt.control import Run
from sapopt.learning.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from sapopt.learning.environment import Environment, charge_of
from sapopt.learning.logs import TrainingLog
from sapopt.learning.network import new_network
from sapopt.learning.observation import ObservationSpec, gain_matrix
from sapopt.learning.reda import REDA
from sapopt.learning.replay import Batch, Episode, Replay
from sapopt.outlook import Policy, rollout
from sapopt.problem import SAP
from sapopt.types import IntArray

log = logging.getLogger(__name__)

Problems = Callable[[int], SAP]
"""``problems(seed)``: the problem of an episode, the same for the same seed; all with the same number of agents."""

Standardise = Literal["agent", "common", "none"]

FRESH = 1_000_000
"""Seeds from here on are for evaluation: no training episode has them."""


@dataclass(frozen=True)
class TrainOptions:
    """Everything that decides a training run.

    Parameters
    ----------
    episodes : int
        Episodes to play.
    gradient_steps : int
        Gradient steps after every episode.
    stretches, stretch : int
        A batch is this many stretches of this many successive steps (of all agents), drawn from the whole memory.
    trace : float
        lambda of the returns along a stretch; 0 is the one-step target of the thesis (see `traced`).
    memory : int
        Episodes remembered.
    learning_rate, discount, soft_target, clip : float
        Of Adam; gamma; share of the online weights taken over by the target network at every gradient step; largest
        norm of a gradient.
    explore, noise : float
        Share of the episodes over which epsilon falls from 1 to 0; deviation of the perturbation of the values, in
        parts of epsilon times their mean size.
    standardise : {"agent", "common", "none"}
        See `Replay.reward_scale`.
    fade : float
        Share of the episodes, at the end, over which the learning rate falls to a tenth.
    hidden : tuple of int
    spec : ObservationSpec
    seed : int
    evaluate_every, evaluations : int
        Episodes between evaluations without exploration, and fresh episodes in each; the best weights are kept.
    checkpoint_every : int
        Episodes between checkpoints.
    threads : int
        Threads of torch; with 1 a run repeats bit for bit.

    Notes
    -----
    The thesis makes one gradient step after each episode of 100 steps, on 5 whole episodes, for 5000 episodes, and
    standardises the rewards of each agent: ``episodes=5000, gradient_steps=1, stretches=5, stretch=100, trace=0,
    discount=0.99, noise=1, standardise="agent", explore=0.6``. More and smaller steps, and traces, need far fewer
    episodes.
    """

    episodes: int = 400
    gradient_steps: int = 40
    stretches: int = 2
    stretch: int = 10
    trace: float = 0.9
    memory: int = 100
    learning_rate: float = 5e-4
    discount: float = 0.97
    soft_target: float = 0.01
    clip: float = 10.0
    explore: float = 0.6
    noise: float = 0.1
    standardise: Standardise = "common"
    fade: float = 0.3
    hidden: tuple[int, ...] = (64, 64)
    spec: ObservationSpec = field(default_factory=ObservationSpec)
    seed: int = 0
    evaluate_every: int = 20
    evaluations: int = 2
    checkpoint_every: int = 20
    threads: int = 1

    def __post_init__(self) -> None:
        for name in (
            "episodes", "gradient_steps", "stretches", "stretch", "memory", "evaluate_every", "evaluations",
            "checkpoint_every", "threads",
        ):  # fmt: skip
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("learning_rate", "clip"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("discount", "soft_target", "explore", "noise", "trace", "fade"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie between 0 and 1, got {getattr(self, name)}")
        if self.standardise not in get_args(Standardise):
            raise ValueError(
                f"standardise must be one of {', '.join(get_args(Standardise))}, got {self.standardise!r}"
            )

    def epsilon(self, episode: int) -> float:
        """Exploration of an episode: falls from 1 to 0."""
        return max(0.0, 1.0 - episode / (self.explore * self.episodes)) if self.explore > 0 else 0.0

    def rate(self, episode: int) -> float:
        """Learning rate of an episode."""
        left = (self.episodes - episode) / max(self.fade * self.episodes, 1e-9)
        return self.learning_rate * (1.0 if left >= 1.0 else 0.1 + 0.9 * left)


@dataclass(frozen=True, eq=False)
class Training:
    """A finished or interrupted training.

    Attributes
    ----------
    reda : REDA
        The best weights that an evaluation met.
    value : float
        Their mean value in that evaluation.
    episodes : int
        Episodes played.
    """

    reda: REDA
    value: float
    episodes: int


def train_reda(
    problems: Problems, guide: Policy, options: TrainOptions, folder: str | Path, run: Run | None = None
) -> Training:
    """Train a network by Algorithm 4, or go on where a killed run stopped.

    Parameters
    ----------
    problems : callable
        ``problems(seed)`` makes the problem of an episode.
    guide : Policy
        Plays a step with probability epsilon: any policy that knows nothing of learning.
    options : TrainOptions
    folder : path
        Checkpoint, log and weights go here. If it holds a checkpoint of the same options the run goes on from it,
        and the result is that of a run without the break, bit for bit (on one machine, with one thread).
    run : Run, optional
        Clock and callback; when it expires, a checkpoint is written.

    Raises
    ------
    ValueError
        If the folder holds a checkpoint of other options.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(options.threads)
    try:
        return _train(problems, guide, options, Path(folder), run or Run())
    finally:
        torch.set_num_threads(threads)


def _train(problems: Problems, guide: Policy, options: TrainOptions, folder: Path, run: Run) -> Training:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "checkpoint.safetensors"
    learner = Learner(problems, guide, options)
    about = asdict(options) | {"guide": guide.name}
    if path.exists():
        learner.restore(load_checkpoint(path, about, learner.checkpoint()))
    with TrainingLog(folder, learner.episode) as record:
        while learner.episode < options.episodes and not run.expired:
            began = time.perf_counter()
            row = learner.play_and_learn()
            if learner.episode % options.evaluate_every == 0 or learner.episode == options.episodes:
                row["evaluation"] = learner.evaluate()
            row["seconds"] = time.perf_counter() - began
            record.write(row)
            run.report(
                learner.episode, options.episodes, row.get("evaluation", row["value"]), message="training"
            )
            if learner.episode % options.checkpoint_every == 0:
                save_checkpoint(path, learner.checkpoint(), about)
    save_checkpoint(path, learner.checkpoint(), about)
    return Training(REDA(learner.best), learner.best_value, learner.episode)


class Learner:
    """The state of a training run, and one episode of it."""

    def __init__(self, problems: Problems, guide: Policy, options: TrainOptions) -> None:
        self.problems, self.guide, self.options = problems, guide, options
        self.rng = np.random.default_rng([options.seed, 0])
        self.online = new_network(options.spec, options.seed, options.hidden)
        self.target = new_network(options.spec, options.seed, options.hidden)
        self.best = new_network(options.spec, options.seed, options.hidden)
        self.best_value = -np.inf
        self.adam = torch.optim.Adam(self.online.parameters(), lr=options.learning_rate)
        self.replay = Replay(options.memory, options.spec)
        self.episode = 0

    def play_and_learn(self) -> dict[str, float]:
        """One episode and the gradient steps after it; the row of the log."""
        options = self.options
        epsilon = options.epsilon(self.episode)
        episode = self._play(self.problems(options.seed * 100_000 + self.episode), epsilon)
        self.replay.add(episode)
        for group in self.adam.param_groups:
            group["lr"] = options.rate(self.episode)
        mean, deviation = self.replay.reward_scale(options.standardise)
        losses = [
            self._learn(self.replay.sample(options.stretches, options.stretch, self.rng), mean, deviation)
            for _ in range(options.gradient_steps)
        ]
        self.episode += 1
        return {
            "episode": self.episode,
            "steps": self.episode * episode.problem.T,
            "gradient_steps": self.episode * options.gradient_steps,
            "epsilon": epsilon,
            "value": float(episode.rewards.sum(dtype=np.float64)),
            "loss": float(np.mean(losses)),
        }

    def evaluate(self) -> float:
        """Mean value over fresh episodes without exploration; the best weights are remembered."""
        from sapopt.solvers import AssignmentPolicy

        policy = AssignmentPolicy(REDA(self.online))
        values = []
        for seed in range(self.options.evaluations):
            problem = self.problems(FRESH + seed)
            values.append(problem.evaluate(rollout(problem, policy).plan).value)
        value = float(np.mean(values))
        if value > self.best_value:
            self.best_value = value
            self.best.load_state_dict(self.online.state_dict())
        return value

    def _play(self, problem: SAP, epsilon: float) -> Episode:
        options = self.options
        env = Environment(problem)
        memory = self.guide.begin(problem, self.rng)
        plan = np.empty((problem.T, problem.n), np.int64)
        rewards = np.empty((problem.T, problem.n), np.float32)
        charges = []
        parking = np.arange(problem.m)
        while not env.done:
            k = env.k
            charge = charge_of(problem.model, env.state)
            if charge is not None:
                charges.append(charge.astype(np.float32))
            if self.rng.random() < epsilon:
                plan[k], memory = self.guide.act(env.outlook(), memory)
            else:
                seen, tasks = env.observe(options.spec)
                q = self.online.values(seen)
                if epsilon > 0:
                    q = q + self.rng.standard_normal(q.shape) * (options.noise * epsilon * np.abs(q).mean())
                plan[k] = best_assignment(gain_matrix(q, tasks, problem.m), parking).tasks
            rewards[k] = env.step(plan[k])
        seed = options.seed * 100_000 + self.episode
        return Episode(seed, problem, plan, rewards, np.stack(charges) if charges else None)

    def _learn(self, batch: Batch, mean: np.ndarray, deviation: np.ndarray) -> float:
        """One gradient step: double Q-learning whose next assignment is alpha of the online values."""
        options = self.options
        observations = torch.from_numpy(batch.observations)
        values = self.online(observations)
        with torch.no_grad():
            later = self.target(observations[:, 1:])
            chosen = torch.from_numpy(best_outputs(values.detach().numpy(), batch))
            later = later.gather(3, chosen[..., None])[..., 0]
            later[:, -1] *= torch.from_numpy(batch.going.astype(np.float32))[:, None]
            rewards = torch.from_numpy((batch.rewards - mean) / deviation)
            goal = traced(rewards, later, options.discount, options.trace)
        taken = values[:, :-1].gather(3, torch.from_numpy(batch.actions)[..., None])[..., 0]
        loss = torch.nn.functional.mse_loss(taken, goal)
        self.adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.online.parameters(), options.clip)
        self.adam.step()
        with torch.no_grad():
            for slow, fast in zip(self.target.parameters(), self.online.parameters(), strict=True):
                slow.lerp_(fast, options.soft_target)
        return float(loss.detach())

    def checkpoint(self) -> Checkpoint:
        """Everything that the rest of the run depends on."""
        return Checkpoint(
            self.online, self.target, self.best, self.best_value, self.adam, self.episode,
            self.rng.bit_generator.state, [(e.seed, e.plan) for e in self.replay.episodes],
        )  # fmt: skip

    def restore(self, saved: Checkpoint) -> None:
        """Go on from a checkpoint; the remembered episodes are played again from their plans."""
        self.online, self.target, self.best = saved.online, saved.target, saved.best
        self.best_value, self.episode = saved.best_value, saved.episode
        self.adam = saved.adam
        self.rng.bit_generator.state = saved.rng
        for seed, plan in saved.plans:
            self.replay.add(replayed(seed, self.problems(seed), plan))


def traced(rewards: torch.Tensor, later: torch.Tensor, discount: float, trace: float) -> torch.Tensor:
    """Returns along stretches: ``G_s = r_s + discount ((1 - trace) later_s + trace G_{s+1})``.

    Parameters
    ----------
    rewards, later : Tensor, shape (B, S, n)
        Rewards, and values of the state after every step. Beyond a stretch the last of these stands for the return.
    discount, trace : float
        With ``trace=0`` this is the one-step target of Algorithm 4. Larger traces carry what happened later in the
        stretch back at once; they follow the assignments that were played, not those of alpha (Peng and Williams,
        1994), a bias that goes as exploration ends.
    """
    goal = torch.empty_like(rewards)
    following = later[:, -1]
    for s in range(rewards.shape[1] - 1, -1, -1):
        goal[:, s] = rewards[:, s] + discount * ((1 - trace) * later[:, s] + trace * following)
        following = goal[:, s]
    return goal


def best_outputs(q: np.ndarray, batch: Batch) -> IntArray:
    """The network's output that alpha(q) plays after every step of a batch, shape (B, S, n)."""
    from sapopt.learning.observation_kernels import action_index

    B, steps, n, _ = q.shape
    out = np.empty((B, steps - 1, n), np.int64)
    for b, m in enumerate(batch.m):
        order = np.arange(m)
        for s in range(1, steps):
            tasks = batch.listed[b][s]
            out[b, s - 1] = action_index(tasks, best_assignment(gain_matrix(q[b, s], tasks, m), order).tasks)
    return out


def replayed(seed: int, problem: SAP, plan: IntArray) -> Episode:
    """The episode that a plan makes."""
    env = Environment(problem)
    rewards = np.empty(plan.shape, np.float32)
    charges = []
    while not env.done:
        charge = charge_of(problem.model, env.state)
        if charge is not None:
            charges.append(charge.astype(np.float32))
        k = env.k
        rewards[k] = env.step(plan[k])
    return Episode(seed, problem, plan, rewards, np.stack(charges) if charges else None)
