"""From the limits that a user wrote to the rows that are counted (`sapopt.problem.rows.Rows`)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray, real_array, real_csr
from sapopt.problem.limit import Limit, Team, chosen
from sapopt.problem.rows import AgentWeights, Rows, Weights

_SLACK = 1e-9
"""By which a sum of numbers that are not whole may be beyond its bound, relative to the bound or 1."""


class _Row(NamedTuple):
    """One row while it is being built; cells are pairs ``(k * n + i, j)`` flattened with m tasks."""

    name: str
    pair: tuple[Any, Any] | None = None
    taken: tuple[Any, Any] | None = None
    stayed: tuple[Any, Any] | None = None
    agents: IntArray | None = None


def compiled(
    limits: tuple[Limit | Team, ...],
    benefits: Benefits,
    idle: bool,
    initial: IntArray | None,
    agents: tuple[str, ...] | None,
    tasks: tuple[str, ...] | None,
    capacity: IntArray | None,
) -> Rows:
    """The rows of some limits.

    Parameters
    ----------
    limits : tuple of Limit and Team
    benefits : Benefits
        Of the tasks (T, n, m), without idleness.
    idle : bool
        Whether there is a further place for holding nothing.
    initial : ndarray or None
    agents, tasks : tuple of str or None
        Labels.
    capacity : ndarray of int64, shape (T, m), or None

    Raises
    ------
    ValueError
        If a limit does not fit the problem; the message names it.
    """
    T, n, m = benefits.shape
    places = m + idle
    reader = _Reader(benefits, agents, tasks)
    names: list[str] = []
    low, high, told_low, told_high, penalty = [], [], [], [], []
    parts: dict[str, list[tuple[Any, Any, Any]]] = {"pair": [], "taken": [], "stayed": [], "agents": []}
    teams: list[tuple[int, int, float]] = []
    for number, limit in enumerate(limits):
        try:
            if isinstance(limit, Team):
                teams += _team(limit, reader, capacity, places)
                continue
            up = math.inf if limit.at_most is None else limit.at_most
            down = -math.inf if limit.at_least is None else limit.at_least
            for row in reader.rows(limit):
                whole, least, most = _added(row, len(names), parts, (T, m, places))
                if limit.penalty is None and (most < down or least > up):
                    bound, reach = (f"at_least={down:g}", most) if most < down else (f"at_most={up:g}", least)
                    raise ValueError(
                        f"{bound} is out of reach: no plan brings the sum of {row.name!r} beyond {reach:g}"
                    )
                names.append(row.name)
                told_low.append(down)
                told_high.append(up)
                low.append(down - _slack(down, whole))
                high.append(up + _slack(up, whole))
                penalty.append(math.inf if limit.penalty is None else limit.penalty)
        except ValueError as error:
            raise ValueError(f"limits: number {number} ({limit.called}): {error}") from None
    bounds = [np.array(values, dtype=np.float64) for values in (low, high, told_low, told_high, penalty)]
    pair, taken, stayed = (Weights(*_joined(parts[key])) for key in ("pair", "taken", "stayed"))
    cell, needs = (np.array([team[c] for team in teams], dtype=np.int64) for c in range(2))
    return Rows(
        (T, n, places), m if idle else -1, tuple(names), bounds[0], bounds[1], bounds[2], bounds[3], bounds[4],
        pair, taken, stayed, AgentWeights(*_joined(parts["agents"])), initial is not None,
        cell, needs, np.array([team[2] for team in teams], dtype=np.float64),
    )  # fmt: skip


def _added(
    row: _Row, number: int, parts: dict[str, list[tuple[Any, Any, Any]]], sizes: tuple[int, int, int]
) -> tuple[bool, float, float]:
    """Add the entries of a row; whether all are whole, and the least and the greatest sum that could ever be."""
    T, m, places = sizes
    whole, least, most = True, 0.0, 0.0
    for key, entries in (("pair", row.pair), ("taken", row.taken), ("stayed", row.stayed)):
        if entries is None:
            continue
        cell = np.asarray(entries[0], dtype=np.int64)
        weight = np.broadcast_to(np.asarray(entries[1], dtype=np.float64), cell.shape)
        keep = weight != 0
        cell, weight = cell[keep], weight[keep]
        pair, task = np.divmod(cell, m)
        parts[key].append((pair * places + task, np.full(len(cell), number), weight))
        whole = whole and bool((weight == np.rint(weight)).all())
        most += float(weight[weight > 0].sum())
        least += float(weight[weight < 0].sum())
    if row.agents is not None:
        count = len(row.agents)
        parts["agents"].append((row.agents, np.full(count, number), np.ones(count)))
        most += float(T * count)
    return whole, least, most


def _slack(bound: float, whole: bool) -> float:
    if not math.isfinite(bound) or (whole and bound == round(bound)):
        return 0.0
    return _SLACK * max(1.0, abs(bound))


def _joined(parts: list[tuple[Any, Any, Any]]) -> tuple[IntArray, IntArray, FloatArray]:
    columns = [np.concatenate([part[c] for part in parts]) if parts else np.zeros(0) for c in range(3)]
    return columns[0].astype(np.int64), columns[1].astype(np.int64), columns[2].astype(np.float64)


def _team(
    team: Team, reader: _Reader, capacity: IntArray | None, places: int
) -> list[tuple[int, int, float]]:
    T, n, m = reader.benefits.shape
    (task,) = chosen(team.task, m, reader.tasks, "task")
    steps = chosen(team.steps, T, None, "steps")
    room = np.ones(T, dtype=np.int64) if capacity is None else capacity[:, task]
    most = min(n, int(room[steps].max(initial=0)))
    if team.needs > most:
        raise ValueError(
            f"needs={team.needs} agents, but at most {most} may hold task {team.task}; raise capacity="
        )
    return [(int(k) * places + int(task), int(team.needs), team.reward) for k in steps]


class _Reader:
    """Reads limits against a problem's sizes, labels and benefits."""

    def __init__(
        self, benefits: Benefits, agents: tuple[str, ...] | None, tasks: tuple[str, ...] | None
    ) -> None:
        self.benefits = benefits
        self.agents, self.tasks = agents, tasks
        self._served: IntArray | None = None

    @property
    def served(self) -> IntArray:
        """Cells of positive benefit, ascending."""
        if self._served is None:
            _, _, m = self.benefits.shape
            flat = self.benefits.flat()
            good = flat.data > 0
            pair = np.repeat(np.arange(len(flat.indptr) - 1), np.diff(flat.indptr))
            self._served = pair[good] * m + flat.indices[good].astype(np.int64)
        return self._served

    def rows(self, limit: Limit) -> Iterator[_Row]:
        """The rows of a limit."""
        T, n, m = self.benefits.shape
        if limit.kind == "weight":
            yield _Row(limit.called, self._weights(limit.weight))
            return
        tasks = chosen(limit.tasks, m, self.tasks, "tasks")
        agents = chosen(limit.agents, n, self.agents, "agents")
        if limit.kind == "cover":
            for k in chosen(limit.steps, T, None, "steps"):
                if limit.served:
                    span = np.searchsorted(self.served, [k * n * m, (k + 1) * n * m])
                    cells = self.served[span[0] : span[1]]
                    cells = cells[np.isin(cells % m, tasks)]
                else:
                    cells = ((k * n + np.arange(n))[:, None] * m + tasks).ravel()
                task = f"{self._task(tasks[0])}, " if limit.tasks is not None and len(tasks) == 1 else ""
                yield _Row(f"{limit.called}[{task}step {k}]", (cells, 1.0))
        elif limit.kind == "handovers":
            groups = [agents[a : a + 1] for a in range(len(agents))] if limit.each else [agents]
            for group in groups:
                label = f"[{self._agent(group[0])}]" if limit.each else ""
                yield _Row(limit.called + label, agents=group)
        elif limit.kind == "work":
            who = self.served // m % n
            for i in agents:
                yield _Row(f"{limit.called}[{self._agent(i)}]", (self.served[who == i], 1.0))
        else:
            yield from self._services(limit, tasks)

    def _services(self, limit: Limit, tasks: IntArray) -> Iterator[_Row]:
        _, n, m = self.benefits.shape
        order = np.argsort(self.served % m, kind="stable")
        spans = np.searchsorted((self.served % m)[order], np.arange(m + 1))
        for j in tasks:
            name = f"{limit.called}[{self._task(j)}]"
            cells = self.served[order[spans[j] : spans[j + 1]]]
            if limit.kind == "once":
                yield _Row(name, (cells, 1.0))
                continue
            # A visit begins where the task is taken up, and where it comes into view of an agent that stayed on it.
            first = cells < n * m
            later = cells[~first]
            new = later[~np.isin(later - n * m, cells)]
            yield _Row(name, (cells[first], 1.0), (later, 1.0), (new, 1.0))

    def _weights(self, weight: Any) -> tuple[IntArray, FloatArray]:
        T, n, m = self.benefits.shape
        if isinstance(weight, (list, tuple)) and any(sp.issparse(w) for w in weight):
            if len(weight) != T or any(not sp.issparse(w) or w.shape != (n, m) for w in weight):
                raise ValueError(f"weight must be {T} sparse matrices of shape {(n, m)}, one for each step")
            stacked = sp.coo_array(sp.vstack([real_csr(w, "weight") for w in weight]))
            stacked.sum_duplicates()
            cell, value = stacked.row.astype(np.int64) * m + stacked.col, stacked.data
        else:
            dense = real_array(weight, "weight")
            try:
                dense = np.broadcast_to(dense, (T, n, m))
            except ValueError:
                raise ValueError(
                    f"weight has shape {dense.shape}, which does not broadcast to (T, n, m) = {(T, n, m)}"
                ) from None
            cell = np.flatnonzero(dense != 0)
            value = dense.ravel()[cell]
        if not np.isfinite(value).all():
            raise ValueError("weight must be finite; forbid a pair by a benefit of -inf")
        return cell, value

    def _agent(self, i: int) -> str:
        return str(i) if self.agents is None else self.agents[i]

    def _task(self, j: int) -> str:
        return str(j) if self.tasks is None else self.tasks[j]
