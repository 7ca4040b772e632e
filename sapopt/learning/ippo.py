"""IPPO: proximal policy optimisation by every agent for itself, with shared networks and individual rewards.

de Witt et al. (2020), with the clipped objective and generalised advantages of Schulman et al. (2016, 2017).
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch

from sapopt.learning.actor_critic import ActorCritic
from sapopt.learning.logs import TrainingLog
from sapopt.learning.network import Network
from sapopt.learning.observation import ObservationSpec, Spec
from sapopt.learning.options import FRESH, Problems
from sapopt.learning.sampling import Sampled, masked_logits, sample_episode
from sapopt.learning.train import Training
from sapopt.running.control import Run


@dataclass(frozen=True)
class PPOOptions:
    """Options of IPPO.

    Parameters
    ----------
    episodes : int
    epochs, batch : int
        Passes over every episode; samples (agent and step) in a batch.
    learning_rate, discount, trace, ratio, entropy, clip : float
        Of Adam; gamma; lambda of the advantages; how far the ratio of probabilities may leave 1; weight of the entropy;
        largest norm of a gradient.
    hidden, spec, seed, evaluate_every, evaluations, checkpoint_every
        As in `TrainOptions`.
    """

    episodes: int = 300
    epochs: int = 4
    batch: int = 4096
    learning_rate: float = 5e-4
    discount: float = 0.97
    trace: float = 0.9
    ratio: float = 0.2
    entropy: float = 0.01
    clip: float = 10.0
    hidden: tuple[int, ...] = (64, 64)
    spec: Spec = field(default_factory=ObservationSpec)
    seed: int = 0
    evaluate_every: int = 20
    evaluations: int = 2
    checkpoint_every: int = 20

    def __post_init__(self) -> None:
        for name in ("episodes", "epochs", "batch", "evaluate_every", "evaluations", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("discount", "trace", "ratio"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie between 0 and 1, got {getattr(self, name)}")


def train_ippo(
    problems: Problems, options: PPOOptions, folder: str | Path, run: Run | None = None
) -> Training:
    """Train a shared stochastic policy; the network's outputs are logits of the choices.

    Parameters
    ----------
    problems : callable
        ``problems(seed)`` makes the problem of an episode.
    options : PPOOptions
    folder : path
        For the log and the checkpoint. If it holds a checkpoint of the same options the run goes on from it, and the
        result is that of a run without the break, bit for bit (on one machine, with the same number of threads).
    run : Run, optional
        Clock and callback; when it expires, a checkpoint is written.

    Raises
    ------
    ValueError
        If the folder holds a checkpoint of other options or shapes, or a damaged one.
    """
    run = run or Run()
    state = ActorCritic.begin(
        options.spec, options.seed, options.hidden, options.learning_rate, asdict(options) | {"method": "ippo"},
        Path(folder), stream=1,
    )  # fmt: skip
    actor, rng = state.actor, state.rng
    with TrainingLog(Path(folder), state.done) as record:
        while state.done < options.episodes and not run.expired:
            began = time.perf_counter()
            played = sample_episode(problems(options.seed * 100_000 + state.done), actor, rng)
            state.scale = state.scale or max(float(played.rewards.std()), 1e-6)
            loss = _improve(played, state.scale, actor, state.critic, state.adam, options, rng)
            state.done += 1
            row = {
                "episode": state.done,
                "steps": state.done * len(played.rewards),
                "gradient_steps": state.done * options.epochs * -(-played.choices.size // options.batch),
                "epsilon": 0.0,
                "value": float(played.rewards.sum()),
                "loss": loss,
            }
            if state.done % options.evaluate_every == 0 or state.done == options.episodes:
                fresh = [problems(FRESH + seed) for seed in range(options.evaluations)]
                value = float(np.mean([sample_episode(p, actor, rng).rewards.sum() for p in fresh]))
                row["evaluation"] = value
                state.keep_if_best(value)
            row["seconds"] = time.perf_counter() - began
            record.write(row)
            run.report(state.done, options.episodes, row.get("evaluation", row["value"]), message="training")
            if state.done % options.checkpoint_every == 0:
                state.save(record)
        state.save(record)
    return Training(state.best, state.best_value, state.done, actor)


def advantages(rewards: np.ndarray, values: np.ndarray, discount: float, trace: float) -> np.ndarray:
    """Generalised advantages (T, n) of rewards (T, n) and values of the states before them; the episode ends then."""
    out = np.empty_like(values)
    later_value, later = np.zeros_like(values[0]), np.zeros_like(values[0])
    for k in range(len(rewards) - 1, -1, -1):
        surprise = rewards[k] + discount * later_value - values[k]
        later = surprise + discount * trace * later
        out[k] = later
        later_value = values[k]
    return out


def _improve(
    played: Sampled, scale: float, actor: Network, critic: Network, adam: torch.optim.Adam, options: PPOOptions,
    rng: np.random.Generator,
) -> float:  # fmt: skip
    size = played.choices.size
    seen = torch.from_numpy(played.observations.reshape(size, -1))
    mask = played.mask.reshape(size, -1)
    choices = torch.from_numpy(played.choices.reshape(size, 1))
    with torch.no_grad():
        before = masked_logits(actor(seen), mask).gather(1, choices)[:, 0]
        values = critic(seen)[:, 0].numpy().reshape(played.choices.shape)
    gain = advantages((played.rewards / scale).astype(np.float32), values, options.discount, options.trace)
    goal = torch.from_numpy((gain + values).ravel())
    gain = torch.from_numpy(((gain - gain.mean()) / (gain.std() + 1e-8)).ravel())
    losses = []
    for _ in range(options.epochs):
        for part in np.array_split(rng.permutation(size), -(-size // options.batch)):
            rows = torch.from_numpy(part)
            logs = masked_logits(actor(seen[rows]), mask[part])
            ratio = torch.exp(logs.gather(1, choices[rows])[:, 0] - before[rows])
            held = ratio.clamp(1 - options.ratio, 1 + options.ratio)
            policy = -torch.minimum(ratio * gain[rows], held * gain[rows]).mean()
            entropy = -(logs.exp() * logs).sum(dim=1).mean()
            value = torch.nn.functional.mse_loss(critic(seen[rows])[:, 0], goal[rows])
            loss = policy + 0.5 * value - options.entropy * entropy
            adam.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], options.clip)
            adam.step()
            losses.append(float(loss.detach()))
    return float(np.mean(losses))
