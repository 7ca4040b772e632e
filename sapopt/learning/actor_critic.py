"""An actor and a critic that learn side by side: what a run of IPPO or of bids keeps, from checkpoint to checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch

from sapopt.learning.logs import TrainingLog
from sapopt.learning.network import Network, new_network
from sapopt.learning.observation import Spec
from sapopt.learning.resume import Standing


@dataclass(eq=False)
class ActorCritic:
    """The state of a run.

    Attributes
    ----------
    actor, critic, best : Network
        The last one is the actor that did best when it was evaluated.
    adam : Adam
        Of actor and critic together.
    rng : Generator
    standing : Standing
        The checkpoint.
    done : int
        Episodes so far.
    scale : float
        Of the rewards; 0 before the first episode.
    best_value : float
    """

    actor: Network
    critic: Network
    best: Network
    adam: torch.optim.Adam
    rng: np.random.Generator
    standing: Standing
    done: int = 0
    scale: float = 0.0
    best_value: float = -np.inf

    @classmethod
    def begin(
        cls, spec: Spec, seed: int, hidden: tuple[int, ...], learning_rate: float, told: Mapping[str, Any],
        folder: Path, stream: int,
    ) -> Self:  # fmt: skip
        """A new run, or the one whose checkpoint lies in a folder, which is made.

        Parameters
        ----------
        spec, seed, hidden, learning_rate
            As in the options of the method.
        told : mapping
            All options, by which a checkpoint of others is recognised.
        folder : Path
        stream : int
            Of the random numbers, beside the seed.

        Raises
        ------
        ValueError
            If the folder holds a checkpoint of other options or shapes, or a damaged one.
        """
        folder.mkdir(parents=True, exist_ok=True)
        actor, critic = new_network(spec, seed, hidden), new_network(spec, seed + 1, hidden, outputs=1)
        best = new_network(spec, seed, hidden)
        adam = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=learning_rate)
        standing = Standing(
            folder / "checkpoint.npz",
            dict(told),
            {"actor": actor, "critic": critic, "best": best},
            {"both": adam},
        )
        run = cls(actor, critic, best, adam, np.random.default_rng([seed, stream]), standing)
        saved = standing.load()
        run.done, run.scale = int(saved.get("episode", 0)), float(saved.get("scale", 0.0))
        run.best_value = float(saved.get("best_value", run.best_value))
        run.rng.bit_generator.state = saved.get("rng", run.rng.bit_generator.state)
        return run

    def keep_if_best(self, value: float) -> None:
        """Keep the actor as it is if an evaluation gives the best value so far."""
        if value > self.best_value:
            self.best_value = value
            self.best.load_state_dict(self.actor.state_dict())

    def save(self, record: TrainingLog) -> None:
        """Write the log, then the checkpoint: a checkpoint never knows of an episode that the log does not."""
        record.save()
        self.standing.save({
            "episode": self.done, "scale": self.scale, "best_value": self.best_value,
            "rng": self.rng.bit_generator.state,
        })  # fmt: skip
