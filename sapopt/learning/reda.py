"""REDA as a benefit generator: the assignment alpha of learned values (Holder 2024, section 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from sapopt.data.matrices import GainMatrix
from sapopt.learning.network import Network, load_network
from sapopt.learning.observation import gain_matrix
from sapopt.running.outlook import Outlook


@dataclass(frozen=True, eq=False)
class REDA:
    """Q-values of a trained network in place of beta_hat, for `sapopt.solvers.AssignmentPolicy`.

    Parameters
    ----------
    network : Network
        Trained weights; `REDA.load` reads them from a file.
    about : dict
        What is noted in the file: the command, the seed, what was reached.

    Examples
    --------
    >>> from sapopt import solve
    >>> from sapopt.domains.instances import instance
    >>> from sapopt.learning import REDA
    >>> from sapopt.solvers import AssignmentPolicy
    >>> result = solve(instance("power", seed=1), AssignmentPolicy(REDA.load("power")))
    """

    network: Network
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def __name__(self) -> str:  # what AssignmentPolicy calls its generator
        return "REDA"

    @classmethod
    def load(cls, name: str | Path) -> REDA:
        """Read weights by the name of a built-in set or from a safetensors file.

        Raises
        ------
        ValueError
            If the file is damaged or does not fit; see `load_network`.
        OSError
            If there is no such file.
        """
        folder = resources.files("sapopt.learning") / "weights"
        known = sorted(entry.name.removesuffix(".safetensors") for entry in folder.iterdir()
                       if entry.name.endswith(".safetensors"))  # fmt: skip
        if str(name) in known:
            with resources.as_file(folder / f"{name}.safetensors") as path:
                network, about = load_network(path)
        elif not Path(name).exists():
            raise FileNotFoundError(f"{name}: no file, and no built-in weights; built-in: {', '.join(known)}")
        else:
            network, about = load_network(name)
        if network.outputs != network.spec.actions:
            raise ValueError(
                f"{name}: a network with {network.outputs} outputs has no value for each of the "
                f"{network.spec.actions} choices of an agent"
            )
        return cls(network, about)

    def __call__(self, outlook: Outlook) -> GainMatrix:
        """Values (n, m) of the current step, in sparse form (see `gain_matrix`).

        Raises
        ------
        ValueError
            If the network's observation does not fit the problem.
        """
        spec, problem = self.network.spec, outlook.problem
        known = outlook.benefits(spec.steps)
        observations, listed = spec.look(known, 0, problem.model, outlook.state, outlook.k)
        return gain_matrix(self.network.values(observations), listed, problem.m)
