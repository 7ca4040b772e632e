"""Layers that value every listed task by the same function, for the observation of section 6.2.2."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch

from sapopt.learning.observation import Spec, ThesisObservation


class PerTask(torch.nn.Module):
    """One value for each listed task and one for any other task, by one function for all of them.

    What an observation says of a task makes a row: the benefits of the agent and of its neighbours for it, and who of
    them held it before; with the charges of all of them where these are seen. "Any other task" is one more row, of
    zeros and a mark. `embed` turns every row into numbers, and the largest of each over the rows tells what else the
    agent could do; `own`, `others` and `head` value a row from both. So what is learned of a task in one place of the
    list holds in every place.

    Parameters
    ----------
    spec : ThesisObservation
    hidden : sequence of int
        The first is the size of the embedding, the second and further ones are hidden layers behind it.

    Raises
    ------
    ValueError
        If the observation is another one, or fewer than two layers are given.
    """

    def __init__(self, spec: Spec, hidden: Sequence[int]) -> None:
        super().__init__()
        if not isinstance(spec, ThesisObservation):
            raise ValueError("values per task need the observation of the thesis (ThesisObservation)")
        if len(hidden) < 2:
            raise ValueError(f"values per task need at least two hidden layers, got {tuple(hidden)}")
        self.spec = spec
        self.embed = torch.nn.Linear(row_size(spec), hidden[0])
        self.own = torch.nn.Linear(hidden[0], hidden[1])
        self.others = torch.nn.Linear(hidden[0], hidden[1], bias=False)
        layers: list[torch.nn.Module] = [torch.nn.ReLU()]
        for inputs, outs in itertools.pairwise([*hidden[1:], 1]):
            layers += [torch.nn.Linear(inputs, outs), torch.nn.ReLU()]
        self.head = torch.nn.Sequential(*layers[:-1])

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Values, shape (..., M + 1), of observations of shape (..., size)."""
        found = torch.relu(self.embed(self.rows(observations)))
        largest = found.amax(dim=-2, keepdim=True)
        values: torch.Tensor = self.head(self.own(found) + self.others(largest))
        return values[..., 0]

    def rows(self, observations: torch.Tensor) -> torch.Tensor:
        """What is known of each listed task and of any other, shape (..., M + 1, row)."""
        M, N, L = self.spec.tasks, self.spec.neighbours, self.spec.steps
        front = observations.shape[:-1]
        own, rivals, flags, charges = observations.split(
            [M * L, N * M * L, (1 + N) * M, observations.shape[-1] - M * (L + N * L + 1 + N)], dim=-1
        )
        rows = observations.new_zeros(*front, M + 1, row_size(self.spec))
        listed = rows[..., :M, :]
        listed[..., :L] = own.unflatten(-1, (M, L))
        listed[..., L : L + N * L].unflatten(-1, (N, L)).copy_(
            rivals.unflatten(-1, (N, M, L)).transpose(-3, -2)
        )
        listed[..., L + N * L : L + N * L + 1 + N] = flags.unflatten(-1, (1 + N, M)).transpose(-1, -2)
        mark = L + N * L + 1 + N
        rows[..., M, mark] = 1.0
        rows[..., mark + 1 :] = charges[..., None, :]
        return rows


def row_size(spec: ThesisObservation) -> int:
    """Numbers in a row: benefits, flags, the mark of any other task, charges."""
    N, L = spec.neighbours, spec.steps
    return L + N * L + 1 + N + 1 + (1 + N if spec.charge else 0)
