"""The Q-network that all agents share, and its file: safetensors with everything needed to use the weights."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from sapopt.data.files import replacing
from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.observation import ObservationSpec, Spec, ThesisObservation
from sapopt.learning.per_task import PerTask
from sapopt.learning.state_observation import StateObservation

FORMAT = "sapopt-network-1"

_MOST = 10**9  # numbers in a layer: more than fit into any memory, few enough to multiply

_SPECS: dict[str, Any] = {
    "local": ObservationSpec, "thesis": ThesisObservation, "global": GlobalSpec, "state": StateObservation,
}  # fmt: skip


class Network(torch.nn.Module):
    """Observation to one value for each listed task and one for any other task.

    Parameters
    ----------
    spec : Spec
    hidden : sequence of int
        Sizes of the hidden layers; 64 and 64 in the published code.
    outputs : int, optional
        ``spec.actions`` by default.
    per_task : bool
        Values by one function for all tasks (see `PerTask`), in place of one multilayer perceptron with ReLU from the
        whole observation to all values, which is that of the published code.

    Raises
    ------
    ValueError
        If `per_task` is asked of another observation than the thesis', or with other outputs.
    """

    def __init__(
        self, spec: Spec, hidden: Sequence[int] = (64, 64), outputs: int | None = None, per_task: bool = False
    ) -> None:
        super().__init__()
        self.spec = spec
        self.hidden = tuple(hidden)
        self.outputs = spec.actions if outputs is None else outputs
        self.per_task = per_task
        self.layers: torch.nn.Module
        if per_task:
            if self.outputs != spec.actions:
                raise ValueError(
                    f"values per task are {spec.actions} for this observation, not {self.outputs}"
                )
            self.layers = PerTask(spec, self.hidden)
            return
        sizes = [spec.size, *self.hidden, self.outputs]
        layers: list[torch.nn.Module] = []
        for inputs, outs in itertools.pairwise(sizes):
            layers += [torch.nn.Linear(inputs, outs), torch.nn.ReLU()]
        self.layers = torch.nn.Sequential(*layers[:-1])

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Values, shape (..., outputs)."""
        values: torch.Tensor = self.layers(observations)
        return values

    def values(self, observations: np.ndarray) -> np.ndarray:
        """Values of an array of observations, without gradients."""
        with torch.no_grad():
            out: np.ndarray = self(torch.from_numpy(observations)).numpy()
        return out


def new_network(
    spec: Spec,
    seed: int,
    hidden: Sequence[int] = (64, 64),
    outputs: int | None = None,
    per_task: bool = False,
) -> Network:
    """A network with random weights that depend on `seed` alone; torch's global generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Network(spec, hidden, outputs, per_task)


def listing(network: Network, tasks: int) -> Network:
    """The same weights for agents that list another number of tasks than in training.

    Parameters
    ----------
    network : Network
        With values per task: its weights do not depend on how many there are.
    tasks : int
        M.

    Raises
    ------
    ValueError
        If the network is one perceptron over the whole observation, whose weights are of one M.
    """
    if not network.per_task:
        raise ValueError("only a network with values per task can list another number of tasks")
    out = Network(replace(network.spec, tasks=tasks), network.hidden, per_task=True)  # type: ignore[type-var]  # every spec is a dataclass, which a protocol cannot say
    out.load_state_dict(network.state_dict())
    return out


def save_network(network: Network, path: str | Path, about: dict[str, Any] | None = None) -> None:
    """Write weights, sizes and `about` (anything JSON can hold: command, seed, results) to a safetensors file."""
    meta = {
        "format": FORMAT,
        "spec": json.dumps(_described(network.spec)),
        "hidden": json.dumps(network.hidden),
        "outputs": str(network.outputs),
        "per_task": json.dumps(network.per_task),
        "about": json.dumps(about or {}),
    }
    tensors = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    with replacing(path) as file:
        file.write(save(tensors, metadata=meta))


def load_network(path: str | Path) -> tuple[Network, dict[str, Any]]:
    """Read a network and what was noted about it.

    Only safetensors files are read: they hold numbers, never code.

    Raises
    ------
    ValueError
        If the file is no such file, is damaged, or its weights do not fit the sizes it names; the message says which.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of weights")
    try:
        with safe_open(str(path), framework="pt") as file:
            meta = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator
    except (SafetensorError, ValueError) as error:
        raise ValueError(f"{path}: not a safetensors file, or a damaged one ({error})") from None
    if meta.get("format") != FORMAT:
        raise ValueError(
            f"{path}: not weights of sapopt (format {meta.get('format')!r}, expected {FORMAT!r})"
        )
    try:
        described = json.loads(meta["spec"])
        spec = _SPECS[described.pop("kind", "local")](**described)
        hidden = [int(size) for size in json.loads(meta["hidden"])]
        outputs = int(meta["outputs"])
        per_task = json.loads(meta.get("per_task", "false"))  # files of the first version do not say
        if not isinstance(per_task, bool):
            raise ValueError("per_task is neither true nor false")
        about = dict(json.loads(meta["about"]))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError) as error:
        raise ValueError(f"{path}: damaged description of the network ({error})") from None
    try:
        if len(hidden) >= len(tensors):
            raise ValueError(f"{len(tensors)} arrays of weights do not fit {len(hidden)} hidden layers")
        wanted = _shapes(spec, hidden, outputs, per_task)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if wanted != found:
        raise ValueError(f"{path}: weights {found} do not fit the network it names, {wanted}")
    network = Network(spec, hidden, outputs, per_task)
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise ValueError(f"{path}: weights {name!r} are not finite numbers")
    network.load_state_dict(tensors)
    return network, about


def _shapes(spec: Spec, hidden: list[int], outputs: int, per_task: bool) -> dict[str, tuple[int, ...]]:
    """Shapes of the weights of a network, without taking memory for the sizes that a file names."""
    if not all(0 < size <= _MOST for size in (spec.size, *hidden, outputs)):
        raise ValueError(f"weights do not fit layers of {spec.size}, {hidden} and {outputs}")
    with torch.device("meta"):
        network = Network(spec, hidden, outputs, per_task)
    return {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}


def _described(spec: Any) -> dict[str, Any]:
    kind = next(kind for kind, cls in _SPECS.items() if type(spec) is cls)
    return {"kind": kind, **asdict(spec)}
