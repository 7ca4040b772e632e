"""Problems as mixed-integer programmes in files that other solvers read: CPLEX LP and free MPS, with readable names.

The programme is that of the agents' paths with all that limits a plan (`sapopt.formulations.limited.programme`).
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from sapopt.data.files import write_text
from sapopt.data.types import IntArray
from sapopt.formulations.highs import Programme
from sapopt.formulations.limited.building import path_graph
from sapopt.formulations.limited.disturbed import untangled
from sapopt.formulations.limited.graph import PathGraph
from sapopt.formulations.limited.programme import LimitedProgramme, limited_programme
from sapopt.formulations.limited.useful import switching_rule
from sapopt.formulations.local import not_local
from sapopt.problem.sap import SAP

_LONGEST = 48
"""Letters of a name that are kept: a whole variable may have 255."""
_WIDTH = 110
"""Of lines; LP readers take 255 and more."""


@dataclass(frozen=True, eq=False)
class NamedProgramme:
    """A programme with a name for every column and row.

    Attributes
    ----------
    programme : Programme
    columns, rows : list of str
        Letters, digits, underscores and points; each once.
    remarks : list of str
        What the names mean, and which names of agents and tasks were changed.
    """

    programme: Programme
    columns: list[str]
    rows: list[str]
    remarks: list[str]


def named_programme(problem: SAP) -> NamedProgramme:
    """The programme of a problem, with names.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local, or the programme would be too large.
    """
    core = untangled(problem.core, exact=True)
    reason = not_local(core)
    if reason:
        raise ValueError(f"dynamics: {reason}")
    graph = path_graph(core)
    # Arcs that no path uses, behind forbidden pairs, would only be in the way.
    made = limited_programme(graph, np.isfinite(graph.through(graph.gain)))
    agents = _plain(problem.agents, problem.n, "agent")
    tasks = _plain(problem.tasks, problem.m, "task")
    if problem.idle:
        tasks = _distinct([*tasks, "nothing"])
    columns = _distinct(_columns(made, agents, tasks))
    rows = _distinct(_rows(made, agents, tasks))
    remarks = [
        f"{problem!r}",
        "take__AGENT__TASK__STEP = 1: the agent takes up the task at the step, counted from 0",
        "stay__AGENT__TASK__STEP = 1: it holds the task on; leave__AGENT__TASK__STEP = 1: it held the task last then",
        "hold__AGENT__TASK__STEP__STATE = 1: it holds the task, coming from one of its states",
    ]
    for kind, labels, names in (("agent", problem.agents, agents), ("task", problem.tasks, tasks)):
        remarks += [
            f"{kind} {name}: {label!r}"
            for label, name in zip(labels or (), names, strict=False)
            if label != name
        ]
    return NamedProgramme(made.programme, columns, rows, remarks)


def _plain(labels: Sequence[str] | None, count: int, kind: str) -> list[str]:
    """Labels in letters that every reader takes, each once."""
    if labels is None:
        return [f"{kind}{i}" for i in range(count)]
    return _distinct([_letters(label) for label in labels])


def _letters(label: str) -> str:
    """A name without accents, in letters, digits, underscores and points."""
    bare = unicodedata.normalize("NFKD", label).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9.]+", "_", bare).strip("_")[:_LONGEST] or "x"


def _distinct(names: Sequence[str]) -> list[str]:
    """The same names, those that would come twice with a number behind them."""
    taken: set[str] = set(names)
    seen: set[str] = set()
    out = []
    for name in names:
        new, number = name, 1
        while new in seen or (new != name and new in taken):
            number += 1
            new = f"{name}_{number}"
        seen.add(new)
        out.append(new)
    return out


def _columns(made: LimitedProgramme, agents: list[str], tasks: list[str]) -> list[str]:
    graph, m = made.graph, made.graph.problem.m
    kept = made.kept
    held = _held(graph)
    rule = switching_rule(graph.problem)
    by_state = (
        rule is None or rule.uniform_cost is None
    )  # else a node is the task held, and its arcs tell all
    names = []
    for arc in kept.tolist():
        cell, agent = int(graph.cell[arc]), agents[graph.agent[arc]]
        tail = int(graph.tail[arc])
        kind = "hold" if by_state else "take" if graph.taken[arc] else "stay"
        if cell < 0:
            kind, cell = "leave", int(held[tail])
        step, task = divmod(cell, m)
        state = f"__{tail - int(graph.node_ptr[graph.agent[arc]])}" if by_state else ""
        names.append(f"{kind}__{agent}__{tasks[task]}__{step}{state}")
    rows = graph.problem.rows
    limits = [_letters(rows.names[r]) for r in made.soft]
    names += [f"over__{name}" for name in limits] + [f"under__{name}" for name in limits]
    places = [divmod(int(cell), rows.shape[2]) for cell in rows.team_cell]
    return names + [f"team__{tasks[task]}__{step}" for step, task in places]


def _held(graph: PathGraph) -> IntArray:
    """The cell that is held in every node, -1 where none is."""
    held = np.full(len(graph.ends), -1, dtype=np.int64)
    held[graph.head[graph.holds]] = graph.cell[graph.holds]
    return held


def _rows(made: LimitedProgramme, agents: list[str], tasks: list[str]) -> list[str]:
    graph = made.graph
    owner = np.searchsorted(graph.node_ptr, made.nodes, side="right") - 1
    first = graph.node_ptr[owner]
    names = [
        f"flow__{agents[i]}__{node}"
        for i, node in zip(owner.tolist(), (made.nodes - first).tolist(), strict=True)
    ]
    cells = (divmod(int(cell), graph.problem.m) for cell in made.cells)
    names += [f"room__{tasks[task]}__{step}" for step, task in cells]
    rows = graph.problem.rows
    names += [f"limit__{_letters(name)}" for name in rows.names]
    places = [divmod(int(cell), rows.shape[2]) for cell in rows.team_cell]
    return names + [f"needs__{tasks[task]}__{step}" for step, task in places]


def write_programme(problem: SAP, path: str | Path) -> None:
    """Write a problem as ``.lp`` or ``.mps``; see `SAP.write`."""
    path = Path(path)
    form = {".lp": _lp, ".mps": _mps}.get(path.suffix.lower())
    if form is None:
        raise ValueError(f"{path}: a problem is written as .lp or .mps (or by save, as .npz)")
    write_text(path, "\n".join(form(named_programme(problem))) + "\n")


def _number(value: float) -> str:
    return repr(int(value)) if float(value).is_integer() and abs(value) < 2**53 else repr(float(value))


def _lp(named: NamedProgramme) -> Iterator[str]:
    programme, columns = named.programme, named.columns
    yield from (f"\\ {remark}" for remark in named.remarks)
    yield "Maximize"
    yield from _sum(
        " value:", _terms(np.arange(len(columns)), programme.gain, columns) or [f"0 {columns[0]}"]
    )
    yield "Subject To"
    rows = sp.csr_array(programme.rows)
    for r, name in enumerate(named.rows):
        span = slice(rows.indptr[r], rows.indptr[r + 1])
        terms = _terms(rows.indices[span], rows.data[span], columns) or [f"0 {columns[0]}"]
        low, high = float(programme.low[r]), float(programme.high[r])
        if low == high:
            yield from _sum(f" {name}:", [*terms, f"= {_number(high)}"])
            continue
        both = np.isfinite(low) and np.isfinite(high)
        if np.isfinite(high):
            yield from _sum(f" {name}:", [*terms, f"<= {_number(high)}"])
        if np.isfinite(low):
            yield from _sum(f" {name}{'_low' if both else ''}:", [*terms, f">= {_number(low)}"])
    whole = programme.integer & (programme.upper == 1)
    bounded = np.flatnonzero(np.isfinite(programme.upper) & ~whole)
    if len(bounded):
        yield "Bounds"
        yield from (f" 0 <= {columns[c]} <= {_number(programme.upper[c])}" for c in bounded)
    for head, mask in (("Binary", whole), ("General", programme.integer & ~whole)):
        if mask.any():
            yield head
            yield from _wrapped(" ", [columns[c] for c in np.flatnonzero(mask)])
    yield "End"


def _terms(indices: np.ndarray, values: np.ndarray, columns: list[str]) -> list[str]:
    return [
        f"{'-' if value < 0 else '+'} {_number(abs(value))} {columns[c]}"
        for c, value in zip(indices.tolist(), values.tolist(), strict=True)
        if value != 0
    ]


def _sum(head: str, terms: list[str]) -> Iterator[str]:
    yield from _wrapped(head + " ", terms)


def _wrapped(head: str, words: list[str]) -> Iterator[str]:
    line = head
    for word in words:
        if len(line) + len(word) > _WIDTH and line.strip():
            yield line.rstrip()
            line = "  "
        line += word + " "
    yield line.rstrip()


def _mps(named: NamedProgramme) -> Iterator[str]:
    programme, columns = named.programme, named.columns
    yield from (f"* {remark}" for remark in named.remarks)
    yield "NAME sapopt"
    yield "OBJSENSE"
    yield "    MAX"
    yield "ROWS"
    yield " N value"
    low, high = programme.low, programme.high
    kinds = np.where(low == high, "E", np.where(np.isfinite(high), "L", np.where(np.isfinite(low), "G", "N")))
    yield from (f" {kind} {name}" for kind, name in zip(kinds, named.rows, strict=True))
    yield "COLUMNS"
    by_column = sp.csc_array(programme.rows)
    inside = False
    for c, name in enumerate(columns):
        if bool(programme.integer[c]) != inside:
            inside = not inside
            yield f"    MARKER 'MARKER' '{'INTORG' if inside else 'INTEND'}'"
        span = slice(by_column.indptr[c], by_column.indptr[c + 1])
        yield f"    {name} value {_number(float(programme.gain[c]))}"
        for r, value in zip(by_column.indices[span].tolist(), by_column.data[span].tolist(), strict=True):
            yield f"    {name} {named.rows[r]} {_number(value)}"
    if inside:
        yield "    MARKER 'MARKER' 'INTEND'"
    yield "RHS"
    right = np.where(np.isfinite(high), high, low)
    yield from (
        f"    RHS {named.rows[r]} {_number(float(right[r]))}"
        for r in np.flatnonzero(np.isfinite(right) & (right != 0))
    )
    ranged = np.flatnonzero(np.isfinite(low) & np.isfinite(high) & (low != high))
    if len(ranged):
        yield "RANGES"
        yield from (f"    RANGE {named.rows[r]} {_number(float(high[r] - low[r]))}" for r in ranged)
    yield "BOUNDS"
    for c, name in enumerate(columns):
        if np.isfinite(programme.upper[c]):
            yield f" UP BOUND {name} {_number(float(programme.upper[c]))}"
        elif programme.integer[c]:
            yield f" PL BOUND {name}"
    yield "ENDATA"
