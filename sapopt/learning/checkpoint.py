"""Checkpoints of a training run: one safetensors file, replaced in one move."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from sapopt.data.files import replacing
from sapopt.data.types import IntArray
from sapopt.learning.network import Network

FORMAT = "sapopt-checkpoint-2"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """State of a training run.

    Attributes
    ----------
    online, target, best : Network
        Best is the one that evaluated best so far, at `best_value`.
    best_value : float
    adam : torch.optim.Adam
        Optimiser of the online network.
    episode, updates : int
        Episodes played, and gradient steps taken.
    rng : dict
        State of the random generator.
    plans : list of (int, ndarray)
        Seed and plan of every remembered episode; the rest of it follows from these.
    """

    online: Network
    target: Network
    best: Network
    best_value: float
    adam: torch.optim.Adam
    episode: int
    updates: int
    rng: Any
    plans: list[tuple[int, IntArray]]


def save_checkpoint(path: Path, state: Checkpoint, run: dict[str, Any]) -> None:
    """Write a checkpoint next to the old one, then put it in its place: a kill leaves one of the two.

    `run` says what kind of run it belongs to: anything JSON can hold.
    """
    tensors: dict[str, torch.Tensor] = {}
    for name in ("online", "target", "best"):
        network: Network = getattr(state, name)
        tensors |= {f"{name}.{key}": value for key, value in network.state_dict().items()}
    for index, moments in state.adam.state_dict()["state"].items():
        tensors |= {f"adam.{index}.{key}": value for key, value in moments.items()}
    for slot, (_, plan) in enumerate(state.plans):
        tensors[f"plan.{slot}"] = torch.from_numpy(plan.astype(np.int32))
    meta = {
        "format": FORMAT,
        "run": json.dumps(run, sort_keys=True),
        "episode": str(state.episode),
        "updates": str(state.updates),
        "best_value": repr(float(state.best_value)),
        "rng": json.dumps(state.rng),
        "seeds": json.dumps([seed for seed, _ in state.plans]),
    }
    with replacing(path) as file:
        file.write(save({key: value.contiguous() for key, value in tensors.items()}, metadata=meta))


def load_checkpoint(path: Path, run: dict[str, Any], like: Checkpoint) -> Checkpoint:
    """Read a checkpoint of the run described by `run`, with networks and optimiser built like those of `like`.

    Raises
    ------
    ValueError
        If the file is damaged, or belongs to a run with other options; the message names them.
    """
    try:
        with safe_open(str(path), framework="pt") as file:
            meta = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator
    except (SafetensorError, ValueError) as error:
        raise ValueError(f"{path}: damaged checkpoint ({error}); remove it to start anew") from None
    if meta.get("format") != FORMAT:
        raise ValueError(f"{path}: not a checkpoint of sapopt; remove it to start anew")
    try:
        ours, theirs = json.loads(json.dumps(run)), dict(json.loads(meta["run"]))
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: damaged checkpoint ({error}); remove it to start anew") from None
    if ours != theirs:
        other = sorted(key for key in ours | theirs if ours.get(key) != theirs.get(key))
        raise ValueError(
            f"{path}: belongs to a run with another {', '.join(other)}; give another folder, or the same options"
        )
    networks = {}
    try:
        for name in ("online", "target", "best"):
            model: Network = getattr(like, name)
            networks[name] = Network(model.spec, model.hidden, model.outputs, model.per_task)
            prefix = f"{name}."
            networks[name].load_state_dict(
                {key.removeprefix(prefix): v for key, v in tensors.items() if key.startswith(prefix)}
            )
        groups = like.adam.state_dict()["param_groups"]
        adam = torch.optim.Adam(networks["online"].parameters(), lr=groups[0]["lr"])
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for key, value in tensors.items():
            if key.startswith("adam."):
                _, index, name = key.split(".")
                moments.setdefault(int(index), {})[name] = value
        adam.load_state_dict({"state": moments, "param_groups": groups})
        seeds = json.loads(meta["seeds"])
        plans = [(seed, tensors[f"plan.{slot}"].numpy().astype(np.int64)) for slot, seed in enumerate(seeds)]
        return Checkpoint(
            networks["online"], networks["target"], networks["best"], float(meta["best_value"]), adam,
            int(meta["episode"]), int(meta["updates"]), json.loads(meta["rng"]), plans,
        )  # fmt: skip
    except (KeyError, TypeError, AttributeError, IndexError, RuntimeError, ValueError) as error:
        raise ValueError(f"{path}: damaged checkpoint ({error}); remove it to start anew") from None
