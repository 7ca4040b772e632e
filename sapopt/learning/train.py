"""Training by Q-learning: REDA (Algorithm 4 of Holder 2024) and IQL, resumable bit for bit."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from sapopt.learning.checkpoint import load_checkpoint, save_checkpoint
from sapopt.learning.learner import Learner
from sapopt.learning.logs import TrainingLog
from sapopt.learning.network import Network
from sapopt.learning.options import Problems, TrainOptions
from sapopt.running.control import Run
from sapopt.running.outlook import Policy


@dataclass(frozen=True, eq=False)
class Training:
    """A finished or interrupted training.

    Attributes
    ----------
    network : Network
        The best weights that an evaluation met.
    value : float
        Their mean value in that evaluation.
    episodes : int
        Episodes played.
    last : Network
        The weights at the end.
    """

    network: Network
    value: float
    episodes: int
    last: Network


def train(
    problems: Problems, guide: Policy, options: TrainOptions, folder: str | Path, run: Run | None = None
) -> Training:
    """Train a network by Algorithm 4 (or as IQL, see `TrainOptions.choose`), or go on where a killed run stopped.

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
    about = asdict(options) | {"guide": guide.name, "chance": repr(options.chance)}
    for name in ("chance", "per_task"):  # checkpoints from before there was such an option go on
        if not getattr(options, name):
            del about[name]
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
                record.save()
                save_checkpoint(path, learner.checkpoint(), about)
    save_checkpoint(path, learner.checkpoint(), about)
    if not np.isfinite(learner.best_value):  # stopped before the first evaluation
        learner.evaluate()
    return Training(learner.best, learner.best_value, learner.episode, learner.online)
