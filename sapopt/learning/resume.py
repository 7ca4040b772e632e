"""Where a training of IPPO or COMA stands, in one file to go on from: networks, optimisers and counters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sapopt.data.files import read_npz, write_npz

_FORMAT = "sapopt-policy-checkpoint-1"
_MOST_BYTES = 4 * 2**30  # of the arrays of a file: networks of half a billion numbers


@dataclass(frozen=True, eq=False)
class Standing:
    """What a run consists of; `load` and `save` move it from and to a file.

    Attributes
    ----------
    path : Path
    run : mapping
        What tells the run from others: its options, anything JSON can hold.
    modules : mapping of str to torch.nn.Module
        Networks, restored in place.
    optimisers : mapping of str to torch.optim.Optimizer
        Likewise.
    """

    path: Path
    run: Mapping[str, Any]
    modules: Mapping[str, torch.nn.Module]
    optimisers: Mapping[str, torch.optim.Optimizer]

    def save(self, counters: Mapping[str, Any]) -> None:
        """Write everything; a kill leaves the old file or the new one.

        Parameters
        ----------
        counters : mapping
            Episode, random state, best value: anything JSON can hold.
        """
        meta = {
            "format": _FORMAT,
            "run": json.dumps(self.run, sort_keys=True),
            "counters": json.dumps(counters),
        }
        write_npz(self.path, meta, self._arrays())

    def load(self) -> dict[str, Any]:
        """Restore networks and optimisers, and return the counters; empty if there is no file.

        Raises
        ------
        ValueError
            If the file is damaged, has other shapes, or belongs to a run with other options; the message names them.
        """
        if not self.path.exists():
            return {}
        meta, arrays = read_npz(self.path, _FORMAT, {}, _MOST_BYTES, prefix="")
        try:
            ours, theirs = json.loads(json.dumps(self.run)), dict(json.loads(meta["run"]))
            counters = dict(json.loads(meta["counters"]))
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"{self.path}: damaged checkpoint ({error}); remove it to start anew") from None
        if ours != theirs:
            other = sorted(key for key in ours | theirs if ours.get(key) != theirs.get(key))
            raise ValueError(
                f"{self.path}: belongs to a run with another {', '.join(other)}; give another folder, or the same "
                "options"
            )
        for name, module in self.modules.items():
            self._fill(name, module, arrays)
        for name, optimiser in self.optimisers.items():
            moments: dict[int, dict[str, torch.Tensor]] = {}
            for key, value in arrays.items():
                owner, _, rest = key.partition("/")
                if owner == f"{name}.adam":
                    index, _, what = rest.partition("/")
                    moments.setdefault(int(index), {})[what] = torch.from_numpy(value)
            groups = optimiser.state_dict()["param_groups"]
            optimiser.load_state_dict({"state": moments, "param_groups": groups})
        return counters

    def _fill(self, name: str, module: torch.nn.Module, arrays: Mapping[str, np.ndarray]) -> None:
        wanted = {key: tuple(tensor.shape) for key, tensor in module.state_dict().items()}
        prefix = f"{name}/"
        found = {key.removeprefix(prefix): a for key, a in arrays.items() if key.startswith(prefix)}
        shapes = {key: tuple(a.shape) for key, a in found.items()}
        if shapes != wanted or not all(np.isfinite(a).all() for a in found.values()):
            raise ValueError(
                f"{self.path}: the weights of {name} ({shapes}) do not fit this run ({wanted}), or are not finite; "
                "remove the file to start anew"
            )
        module.load_state_dict({key: torch.from_numpy(a) for key, a in found.items()})

    def _arrays(self) -> dict[str, np.ndarray]:
        out = {
            f"{name}/{key}": tensor.numpy()
            for name, module in self.modules.items()
            for key, tensor in module.state_dict().items()
        }
        for name, optimiser in self.optimisers.items():
            for index, moments in optimiser.state_dict()["state"].items():
                out |= {f"{name}.adam/{index}/{what}": np.asarray(value) for what, value in moments.items()}
        return out
