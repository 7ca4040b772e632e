"""Everything that decides a training run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from sapopt.learning.observation import ObservationSpec, Spec, ThesisObservation
from sapopt.problem.sap import SAP
from sapopt.running.chance import Chance

Problems = Callable[[int], SAP]
"""``problems(seed)``: the problem of an episode, the same for the same seed; all with the same number of agents."""

Standardise = Literal["agent", "common", "none"]
Choose = Literal["alpha", "self"]
After = Literal["episode", "step"]
Perturb = Literal["outputs", "pairs"]

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
        Gradient steps after every episode, or after every time step, see `after`.
    after : {"episode", "step"}
        When the network learns.
    stretches, stretch : int
        A batch is this many stretches of this many successive steps (of all agents), drawn from the whole memory.
    trace : float
        lambda of the returns along a stretch; 0 is the one-step target of the thesis (see `traced`).
    memory : int
        Episodes remembered.
    learning_rate, discount, clip : float
        Of Adam; gamma; largest norm of a gradient.
    soft_target : float
        Share of the online weights that the target network takes over at every gradient step.
    target_every : int
        Gradient steps after which the target network takes over all weights, in place of `soft_target`; 0: never.
    explore : float
        Share of the episodes over which epsilon falls from 1 to 0.
    noise : float
        Deviation of the perturbation of the values, in parts of epsilon times their mean size; 2 in the thesis, whose
        N(0, 2 Q_avg epsilon) is read as a deviation: it is to scale with the values.
    perturb : {"outputs", "pairs"}
        Whether the outputs of the network are perturbed, so that all tasks that an agent does not list get one draw,
        or every pair of agent and task (Algorithm 4); where agents choose for themselves it is the outputs.
    standardise : {"agent", "common", "none"}
        See `Replay.reward_scale`.
    fade : float
        Share of the episodes, at the end, over which the learning rate falls to a tenth.
    choose : {"alpha", "self"}
        Whether the assignment of the values is played (REDA), or every agent's own best choice, conflicts shared (IQL).
    hidden : tuple of int
    per_task : bool
        One function that values every task, in place of one from the whole observation to all values; see `PerTask`.
    spec : Spec
    chance : Chance, optional
        Draws the states of every episode, by the episode's seed; None: nothing is random.
    seed : int
    evaluate_every, evaluations : int
        Episodes between evaluations without exploration, and fresh episodes in each; the best weights are kept.
    checkpoint_every : int
        Episodes between checkpoints.
    threads : int
        Threads of torch; with 1 a run repeats bit for bit.

    Notes
    -----
    `TrainOptions.thesis` has the options of Algorithm 4. The published code differs from both: one gradient step
    after each episode of 100 steps, on 5 whole episodes, for 5000 episodes, with the rewards of each agent
    standardised: ``episodes=5000, gradient_steps=1, stretches=5, stretch=100, trace=0, discount=0.99, noise=1,
    standardise="agent", explore=0.6``. The defaults, more and smaller steps and traces, need far fewer episodes.
    """

    episodes: int = 400
    gradient_steps: int = 20
    after: After = "episode"
    stretches: int = 2
    stretch: int = 10
    trace: float = 0.9
    memory: int = 100
    learning_rate: float = 5e-4
    discount: float = 0.97
    soft_target: float = 0.01
    target_every: int = 0
    clip: float = 10.0
    explore: float = 0.6
    noise: float = 0.1
    perturb: Perturb = "outputs"
    standardise: Standardise = "common"
    fade: float = 0.3
    choose: Choose = "alpha"
    hidden: tuple[int, ...] = (64, 64)
    per_task: bool = False
    spec: Spec = field(default_factory=ObservationSpec)
    chance: Chance | None = None
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
        if self.target_every < 0:
            raise ValueError(f"target_every must not be negative, got {self.target_every}; 0: soft updates")
        if not 0 <= self.noise < np.inf:
            raise ValueError(f"noise must be a finite number of at least 0, got {self.noise}")
        for name in ("discount", "soft_target", "explore", "trace", "fade"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie between 0 and 1, got {getattr(self, name)}")
        for name, known in (
            ("standardise", Standardise), ("choose", Choose), ("after", After), ("perturb", Perturb),
        ):  # fmt: skip
            if getattr(self, name) not in get_args(known):
                raise ValueError(
                    f"{name} must be one of {', '.join(get_args(known))}, got {getattr(self, name)!r}"
                )

    @classmethod
    def thesis(cls, **changes: Any) -> TrainOptions:
        """The options of Algorithm 4 of Holder (2024), with `changes`.

        From the text: a gradient step after every time step on a batch of single steps, one-step targets, hard
        updates of the target network, perturbations of deviation 2 Q_avg epsilon on all pairs, rewards as they are,
        and the observation of section 6.2.2. The guide is the caller's: the greedy policy, ``alpha(beta_hat)``.
        Not in the text, and so free: the size of the batch (5 steps of all agents here), the memory, the time
        between hard updates (100 steps), the rates, the discount, the network.
        """
        given: dict[str, Any] = {
            "gradient_steps": 1, "after": "step", "stretches": 5, "stretch": 1, "trace": 0.0, "target_every": 100,
            "noise": 2.0, "perturb": "pairs", "standardise": "none", "discount": 0.99, "fade": 0.0,
            "spec": ThesisObservation(),
        }  # fmt: skip
        return cls(**(given | changes))

    @classmethod
    def per_task_values(cls, **changes: Any) -> TrainOptions:
        """The options with which REDA is above HAAL in section 6.3 of Holder (2024), with `changes`.

        They depart from Algorithm 4, see `TrainOptions.thesis`, in this: one function values every task (`PerTask`),
        where the published code has a perceptron over the whole observation; 30 gradient steps follow each episode,
        on two stretches of five steps each; the target network takes over 3 % of the weights at every gradient step;
        later rewards count 0.7 a step; rewards are divided by one common deviation; the perturbation is a twentieth,
        on the outputs. As in Algorithm 4 the greedy policy guides, targets are of one step, and agents see what
        section 6.2.2 lists, with L = 5, which the thesis does not give.
        """
        given: dict[str, Any] = {
            "episodes": 60, "gradient_steps": 30, "stretches": 2, "stretch": 5, "trace": 0.0, "discount": 0.7,
            "learning_rate": 2e-3, "soft_target": 0.03, "explore": 0.2, "hidden": (32, 32), "per_task": True,
            "evaluate_every": 5, "checkpoint_every": 5, "spec": ThesisObservation(steps=5, charge=False),
        }  # fmt: skip
        return cls(**(given | changes))

    def epsilon(self, episode: int) -> float:
        """Exploration of an episode: falls from 1 to 0."""
        return max(0.0, 1.0 - episode / (self.explore * self.episodes)) if self.explore > 0 else 0.0

    def rate(self, episode: int) -> float:
        """Learning rate of an episode."""
        left = (self.episodes - episode) / max(self.fade * self.episodes, 1e-9)
        return self.learning_rate * (1.0 if left >= 1.0 else 0.1 + 0.9 * left)
