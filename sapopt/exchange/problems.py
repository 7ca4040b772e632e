"""Problems from tables in long form: one row for each step, agent and task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.tables import Table
from sapopt.data.times import Time, as_text, check_one_kind, instant, moment
from sapopt.data.types import FloatArray, IntArray


def arguments(
    table: Any,
    names: Mapping[str, str | None],
    missing: str,
    agents: Sequence[str] | None,
    tasks: Sequence[str] | None,
    options: Mapping[str, Any],
) -> dict[str, Any]:
    """The arguments of `SAP` that a table stands for; see `SAP.from_table`.

    Parameters
    ----------
    table : object
    names : mapping
        The columns ``step``, ``agent``, ``task``, ``benefit`` and ``forbidden`` (None: there is none).
    missing : str
        "zero" or "forbidden".
    agents, tasks : sequence of str or None
        Labels in an order of the user's own.
    options : mapping
        Further arguments of `SAP`.
    """
    if missing not in ("zero", "forbidden"):
        raise ValueError(f"missing must be 'zero' or 'forbidden', got {missing!r}")
    for taken in ("times", "benefits"):
        if taken in options:
            raise ValueError(f"{taken}: a table brings its own")
    read = Table(table)
    step, times = _steps(read, str(names["step"]))
    agent, agents = _labelled(read, str(names["agent"]), agents, "agents")
    task, tasks = _labelled(read, str(names["task"]), tasks, "tasks")
    shape = (len(times), len(agents), len(tasks))
    worth = _worth(read, str(names["benefit"]), names["forbidden"], len(step))
    cell = (step * shape[1] + agent) * shape[2] + task
    order = np.argsort(cell, kind="stable")
    same = np.flatnonzero(cell[order[1:]] == cell[order[:-1]])
    if len(same):
        first, second = int(order[same[0]]), int(order[same[0] + 1])
        raise ValueError(
            f"table: rows {first} and {second} (counted from 0) both say what {agents[agent[first]]!r} gains from "
            f"{tasks[task[first]]!r} at step {as_text(times[step[first]])}"
        )
    out: dict[str, Any] = {
        "benefits": _benefits(cell[order], worth[order], shape, missing == "forbidden"),
        "agents": agents,
        "tasks": tasks,
        "times": None if times == list(range(len(times))) else times,
        **options,
    }
    for name, known, values in (("initial_assignment", agents, tasks), ("capacity", tasks, None)):
        if isinstance(options.get(name), Mapping):
            out[name] = _by_label(options[name], name, known, values)
    return out


def _steps(table: Table, name: str) -> tuple[IntArray, list[Time]]:
    """Step of every row, and the times of the steps."""
    codes, values = table.coded(name)
    _refuse_missing(codes, name)
    times = []
    for code, value in enumerate(values):
        try:
            times.append(moment(_plain(value)))
        except ValueError as error:
            row = int(np.argmax(codes == code))
            raise ValueError(f"{name}: row {row} (counted from 0): {error}") from None
    check_one_kind(times, name)
    distinct: dict[Any, Time] = {}
    for time in times:  # one moment may be written in two zones
        distinct.setdefault(instant(time), time)
    ordered = sorted(distinct)
    place = {moment: k for k, moment in enumerate(ordered)}
    return np.array([place[instant(time)] for time in times])[codes], [distinct[key] for key in ordered]


def _labelled(table: Table, name: str, wanted: Sequence[str] | None, kind: str) -> tuple[IntArray, list[str]]:
    """Number of every row's label, and the labels."""
    codes, values = table.coded(name)
    _refuse_missing(codes, name)
    texts = [str(_plain(value)) for value in values]
    labels = list(dict.fromkeys(texts)) if wanted is None else [str(label) for label in wanted]
    place = {label: i for i, label in enumerate(labels)}
    if len(place) < len(labels):
        raise ValueError(f"{kind}: a name is listed twice")
    unknown = [text for text in texts if text not in place]
    if unknown:
        row = int(np.argmax(codes == texts.index(unknown[0])))
        raise ValueError(f"{kind}: row {row} (counted from 0) names {unknown[0]!r}, which is not among them")
    return np.array([place[text] for text in texts])[codes], labels


def _plain(value: Any) -> Any:
    """Whole numbers as such: a column with a missing value makes floats of them in some libraries."""
    value = value.item() if isinstance(value, np.generic) and not isinstance(value, np.datetime64) else value
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _refuse_missing(codes: IntArray, name: str) -> None:
    if not len(codes):
        raise ValueError("table: it has no rows")
    if (codes < 0).any():
        raise ValueError(f"{name}: row {int(np.argmax(codes < 0))} (counted from 0) has no value")


def _worth(table: Table, name: str, forbidden: str | None, count: int) -> FloatArray:
    """Benefit of every row, -inf where it is forbidden."""
    worth = table.numbers(name)
    if len(worth) != count:
        raise ValueError(f"table: its columns have {count} and {len(worth)} rows")
    if forbidden is not None:
        closed = table.numbers(forbidden)
        bad = np.flatnonzero(~np.isin(closed, (0.0, 1.0)))
        if len(bad):
            raise ValueError(f"{forbidden}: row {int(bad[0])} (counted from 0) is neither true nor false")
        worth = np.where(closed == 1.0, -np.inf, worth)
    bad = np.flatnonzero(np.isnan(worth) | (worth == np.inf))
    if len(bad):
        row = int(bad[0])
        said = "has no value" if np.isnan(worth[row]) else "is infinite"
        raise ValueError(
            f"{name}: row {row} (counted from 0) {said}; leave the row out, or use -inf to forbid the pair"
        )
    return worth


def _benefits(cell: IntArray, worth: FloatArray, shape: tuple[int, int, int], closed: bool) -> Benefits:
    """Benefits of sorted cells ``(k * n + i) * m + j``; the others are worth nothing, or are forbidden."""
    T, n, m = shape
    if closed:
        dense = np.full(T * n * m, -np.inf)
        dense[cell] = worth
        return Benefits(dense.reshape(shape))
    row, column = np.divmod(cell, m)
    indptr = np.searchsorted(row, np.arange(T * n + 1))
    return Benefits.from_flat(indptr, column, worth, shape)


def _by_label(
    given: Mapping[Any, Any], name: str, known: Sequence[str], values: Sequence[str] | None
) -> list[int]:
    """An argument that is told by names: one number for each of `known`."""
    place = {label: i for i, label in enumerate(known)}
    out = [1 if values is None else -1] * len(known)
    for label, value in given.items():
        if str(label) not in place:
            raise ValueError(f"{name}: there is none called {label!r}; the first one is {known[0]!r}")
        if values is None:
            out[place[str(label)]] = value
        elif value is not None:
            if str(value) not in values:
                raise ValueError(f"{name}: there is no task {value!r}; the first one is {values[0]!r}")
            out[place[str(label)]] = list(values).index(str(value))
    lacking = [] if values is None else [label for label in known if label not in map(str, given)]
    if lacking:
        raise ValueError(f"{name}: {lacking[0]!r} is not in it; map it to a task, or to None for nothing")
    return out
