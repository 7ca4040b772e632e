"""The state of a Q-learning run (REDA and IQL), and one episode of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from sapopt.data.assignment import assign, best_assignment
from sapopt.data.types import IntArray
from sapopt.learning.checkpoint import Checkpoint
from sapopt.learning.choices import legal, tasks_of
from sapopt.learning.environment import Environment
from sapopt.learning.network import new_network
from sapopt.learning.observation import dense_values, gain_matrix
from sapopt.learning.options import FRESH, Problems, TrainOptions
from sapopt.learning.replay import Batch, Episode, Replay, replayed
from sapopt.running.outlook import Policy


def assigned(q: np.ndarray, listed: IntArray, m: int) -> IntArray:
    """Tasks (n,) by alpha of the values: REDA."""
    return best_assignment(gain_matrix(q, listed, m), np.arange(m)).tasks


def own_choice(q: np.ndarray, listed: IntArray, m: int) -> IntArray:
    """Tasks (n,) where every agent takes what it values most: IQL. A task may have several holders."""
    return tasks_of(np.where(legal(listed, m), q, -np.inf).argmax(axis=1), listed, m)


class Learner:
    """The state of a training run, and one episode of it."""

    def __init__(self, problems: Problems, guide: Policy, options: TrainOptions) -> None:
        self.problems, self.guide, self.options = problems, guide, options
        self.shared = options.choose == "self"
        self.decide = own_choice if self.shared else assigned
        self.rng = np.random.default_rng([options.seed, 0])
        self.online, self.target, self.best = (
            new_network(options.spec, options.seed, options.hidden, per_task=options.per_task)
            for _ in range(3)
        )
        self.best_value = -np.inf
        self.adam = torch.optim.Adam(self.online.parameters(), lr=options.learning_rate)
        self.replay = Replay(options.memory, options.spec)
        self.episode = 0
        self.updates = 0

    def play_and_learn(self) -> dict[str, float]:
        """One episode and its gradient steps; the row of the log."""
        options = self.options
        epsilon = options.epsilon(self.episode)
        for group in self.adam.param_groups:
            group["lr"] = options.rate(self.episode)
        episode = self._begun(options.seed * 100_000 + self.episode)
        losses = []
        if options.after == "step":
            self.replay.add(episode)
            for _ in self._steps(episode, epsilon):
                losses += self._gradient_steps()
        else:
            for _ in self._steps(episode, epsilon):
                pass
            self.replay.add(episode)
            losses = self._gradient_steps()
        self.episode += 1
        return {
            "episode": self.episode,
            "steps": self.episode * episode.problem.T,
            "gradient_steps": self.updates,
            "epsilon": epsilon,
            "value": float(episode.rewards.sum(dtype=np.float64)),
            "loss": float(np.mean(losses)),
        }

    def evaluate(self) -> float:
        """Mean value over fresh episodes without exploration; the best weights are remembered."""
        values = []
        for seed in range(self.options.evaluations):
            episode = self._begun(FRESH + seed)
            for _ in self._steps(episode, None):
                pass
            values.append(episode.rewards.sum(dtype=np.float64))
        value = float(np.mean(values))
        if value > self.best_value:
            self.best_value = value
            self.best.load_state_dict(self.online.state_dict())
        return value

    def _begun(self, seed: int) -> Episode:
        """An episode of which nothing is played yet."""
        problem = self.problems(seed)
        plan = np.empty((problem.T, problem.n), np.int64)
        rewards = np.zeros((problem.T, problem.n), np.float32)
        return Episode(seed, problem, plan, rewards, [])

    def _steps(self, episode: Episode, epsilon: float | None) -> Iterator[None]:
        """Play an episode, with a stop after every step; an evaluation (epsilon None) draws no random number, so
        how often one evaluates changes nothing."""
        problem = episode.problem
        env = Environment(problem, self.shared, self.options.chance, episode.seed)
        memory = self.guide.begin(problem, self.rng)
        episode.states.append(env.state)
        while not env.done:
            k = env.k
            if epsilon is not None and self.rng.random() < epsilon:
                episode.plan[k], memory = self.guide.act(env.outlook(), memory)
            else:
                seen, listed = env.observe(self.options.spec)
                q = self.online.values(seen)
                episode.plan[k] = self._explored(q, listed, problem.m, epsilon or 0.0)
            episode.rewards[k] = env.step(episode.plan[k])
            episode.states.append(env.state)
            yield

    def _explored(self, q: np.ndarray, listed: IntArray, m: int, epsilon: float) -> IntArray:
        """Tasks (n,) for perturbed values."""
        size = self.options.noise * epsilon
        if not size:
            return self.decide(q, listed, m)
        if self.options.perturb == "outputs" or self.shared:
            q = q + self.rng.standard_normal(q.shape) * (size * np.abs(q).mean())
            return self.decide(q, listed, m)
        values = dense_values(q, listed, m)
        values += self.rng.standard_normal(values.shape) * (size * np.abs(values).mean())
        return assign(values, backend="scipy-dense")

    def _gradient_steps(self) -> list[float]:
        """The losses of the gradient steps that are due."""
        options = self.options
        mean, deviation = self.replay.reward_scale(options.standardise)
        return [
            self._learn(self.replay.sample(options.stretches, options.stretch, self.rng), mean, deviation)
            for _ in range(options.gradient_steps)
        ]

    def _learn(self, batch: Batch, mean: np.ndarray, deviation: np.ndarray) -> float:
        """One gradient step: double Q-learning whose next assignment is alpha of the online values."""
        options = self.options
        observations = torch.from_numpy(batch.observations)
        values = self.online(observations)
        with torch.no_grad():
            later = self.target(observations[:, 1:])
            chosen = torch.from_numpy(self._following(values.detach().numpy(), batch))
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
        self.updates += 1
        if options.target_every == 0:
            share = options.soft_target
        else:
            share = 1.0 if self.updates % options.target_every == 0 else 0.0
        if share:
            with torch.no_grad():
                for slow, fast in zip(self.target.parameters(), self.online.parameters(), strict=True):
                    slow.lerp_(fast, share)
        return float(loss.detach())

    def _following(self, q: np.ndarray, batch: Batch) -> IntArray:
        """Outputs (B, S, n) that would be played after every step of a batch."""
        from sapopt.learning.observation_kernels import action_index

        B, steps, n, _ = q.shape
        out = np.empty((B, steps - 1, n), np.int64)
        for b, m in enumerate(batch.m):
            for s in range(1, steps):
                listed = batch.listed[b][s]
                if listed.max() < 0 and s == steps - 1 and not batch.going[b]:
                    out[b, s - 1] = q.shape[3] - 1  # the episode is over; this value does not count
                else:
                    out[b, s - 1] = action_index(listed, self.decide(q[b, s], listed, m))
        return out

    def checkpoint(self) -> Checkpoint:
        """Everything that the rest of the run depends on."""
        return Checkpoint(
            self.online, self.target, self.best, self.best_value, self.adam, self.episode, self.updates,
            self.rng.bit_generator.state, [(e.seed, e.plan) for e in self.replay.episodes],
        )  # fmt: skip

    def restore(self, saved: Checkpoint) -> None:
        """Go on from a checkpoint; the remembered episodes are played again from their plans."""
        self.online, self.target, self.best = saved.online, saved.target, saved.best
        self.best_value, self.episode, self.updates = saved.best_value, saved.episode, saved.updates
        self.adam = saved.adam
        self.rng.bit_generator.state = saved.rng
        for seed, plan in saved.plans:
            self.replay.add(replayed(seed, self.problems(seed), plan, self.shared, self.options.chance))


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
