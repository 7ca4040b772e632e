"""COMA: counterfactual policy gradients with a critic that sees everybody's choices (Foerster et al., 2018).

The reward is the total of all agents. The critic's input is an agent's observation and the choices of the others, so
its size grows with the number of agents: for small problems such as the dictator's.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch

from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.learner import traced
from sapopt.learning.logs import TrainingLog
from sapopt.learning.network import Network, new_network
from sapopt.learning.observation import Spec
from sapopt.learning.options import FRESH, Problems
from sapopt.learning.resume import Standing
from sapopt.learning.sampling import Sampled, masked_logits, sample_episode
from sapopt.learning.train import Training
from sapopt.running.control import Run


@dataclass(frozen=True)
class COMAOptions:
    """Options of COMA.

    Parameters
    ----------
    episodes, gathered : int
        Episodes to play; episodes between gradient steps.
    learning_rate, critic_rate, discount, trace, clip : float
        As in `TrainOptions`, with a rate of its own for the critic.
    critic_steps : int
        Gradient steps of the critic for one of the policy.
    explore : float
        Probability of a random choice, falling from this to 0 over the first half.
    hidden, spec, seed, evaluate_every, checkpoint_every
        As in `TrainOptions`; checkpoints are written after whole batches.
    """

    episodes: int = 2000
    gathered: int = 8
    learning_rate: float = 3e-3
    critic_rate: float = 3e-3
    discount: float = 0.99
    trace: float = 0.8
    clip: float = 10.0
    critic_steps: int = 4
    explore: float = 0.5
    hidden: tuple[int, ...] = (64, 64)
    spec: Spec = field(default_factory=GlobalSpec)
    seed: int = 0
    evaluate_every: int = 80
    checkpoint_every: int = 80

    def __post_init__(self) -> None:
        for name in ("episodes", "gathered", "critic_steps", "evaluate_every", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")


def train_coma(
    problems: Problems, options: COMAOptions, folder: str | Path, run: Run | None = None
) -> Training:
    """Train a shared stochastic policy; parameters, checkpoints and errors as for `train_ippo`."""
    run = run or Run()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([options.seed, 2])
    actor = new_network(options.spec, options.seed, options.hidden)
    best, best_value = new_network(options.spec, options.seed, options.hidden), -np.inf
    critic = _critic(options, problems(0).n)
    target = _critic(options, problems(0).n)
    target.load_state_dict(critic.state_dict())
    adam = torch.optim.Adam(actor.parameters(), lr=options.learning_rate)
    critic_adam = torch.optim.Adam(critic.parameters(), lr=options.critic_rate)
    standing = Standing(
        folder / "checkpoint.npz", asdict(options) | {"method": "coma"},
        {"actor": actor, "critic": critic, "target": target, "best": best},
        {"actor": adam, "critic": critic_adam},
    )  # fmt: skip
    saved = standing.load()
    episode, best_value = int(saved.get("episode", 0)), float(saved.get("best_value", best_value))
    rng.bit_generator.state = saved.get("rng", rng.bit_generator.state)

    def save() -> None:
        standing.save({"episode": episode, "best_value": best_value, "rng": rng.bit_generator.state})

    with TrainingLog(folder, episode) as record:
        while episode < options.episodes and not run.expired:
            began = time.perf_counter()
            explore = options.explore * max(0.0, 1.0 - 2.0 * episode / options.episodes)
            first = options.seed * 100_000 + episode
            batch = [
                sample_episode(problems(first + g), actor, rng, explore) for g in range(options.gathered)
            ]
            loss = _improve(batch, actor, critic, target, adam, critic_adam, options)
            before, episode = episode, episode + options.gathered
            row = {
                "episode": episode,
                "steps": episode * len(batch[0].rewards),
                "gradient_steps": episode // options.gathered * (1 + options.critic_steps),
                "epsilon": explore,
                "value": float(np.mean([played.rewards.sum() for played in batch])),
                "loss": loss,
            }
            if (
                episode // options.evaluate_every > before // options.evaluate_every
                or episode >= options.episodes
            ):
                value = float(sample_episode(problems(FRESH), actor, None).rewards.sum())
                row["evaluation"] = value
                if value > best_value:
                    best_value = value
                    best.load_state_dict(actor.state_dict())
            row["seconds"] = time.perf_counter() - began
            record.write(row)
            run.report(episode, options.episodes, row.get("evaluation", row["value"]), message="training")
            if episode // options.checkpoint_every > before // options.checkpoint_every:
                record.save()
                save()
    save()
    return Training(best, best_value, episode, actor)


def _critic(options: COMAOptions, n: int) -> torch.nn.Module:
    """Observation and the others' choices (one-hot, the own block empty) to the value of every own choice."""
    inputs = options.spec.size + n * options.spec.actions
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(options.seed + 7)
        return torch.nn.Sequential(
            torch.nn.Linear(inputs, 64), torch.nn.ReLU(),
            torch.nn.Linear(64, 64), torch.nn.ReLU(),
            torch.nn.Linear(64, options.spec.actions),
        )  # fmt: skip


def others_choices(choices: np.ndarray, actions: int) -> np.ndarray:
    """One-hot choices (..., n, n * actions) of all agents but the one of the row, from choices (..., n)."""
    n = choices.shape[-1]
    hot = np.eye(actions, dtype=np.float32)[choices]
    shown = np.broadcast_to(hot[..., None, :, :], (*choices.shape[:-1], n, n, actions)).copy()
    shown[..., np.arange(n), np.arange(n), :] = 0.0
    return shown.reshape(*choices.shape, n * actions)


def _improve(
    batch: list[Sampled], actor: Network, critic: torch.nn.Module, target: torch.nn.Module, adam: torch.optim.Adam,
    critic_adam: torch.optim.Adam, options: COMAOptions,
) -> float:  # fmt: skip
    seen = np.stack([played.observations for played in batch])  # (B, T, n, size)
    choices = np.stack([played.choices for played in batch])
    mask = np.stack([played.mask for played in batch])
    total = np.stack([played.rewards.sum(axis=1, keepdims=True) for played in batch])
    inputs = torch.from_numpy(np.concatenate([seen, others_choices(choices, options.spec.actions)], axis=-1))
    taken = torch.from_numpy(choices[..., None])
    rewards = torch.from_numpy((total / len(choices[0, 0])).astype(np.float32)).expand(choices.shape)
    loss = torch.zeros(())
    for _ in range(options.critic_steps):
        with torch.no_grad():
            later = torch.zeros(rewards.shape)
            later[:, :-1] = target(inputs).gather(3, taken)[:, 1:, :, 0]
            goal = traced(rewards, later, options.discount, options.trace)
        loss = torch.nn.functional.mse_loss(critic(inputs).gather(3, taken)[..., 0], goal)
        critic_adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(critic.parameters(), options.clip)
        critic_adam.step()
        with torch.no_grad():
            for slow, fast in zip(target.parameters(), critic.parameters(), strict=True):
                slow.lerp_(fast, 0.05)
    logs = masked_logits(actor(torch.from_numpy(seen)), mask)
    with torch.no_grad():
        q = critic(inputs)
        advantage = q.gather(3, taken)[..., 0] - (logs.exp() * q).sum(dim=3)
    policy = -(logs.gather(3, taken)[..., 0] * advantage).mean()
    adam.zero_grad()
    policy.backward()
    torch.nn.utils.clip_grad_norm_(actor.parameters(), options.clip)
    adam.step()
    return float(loss.detach())
