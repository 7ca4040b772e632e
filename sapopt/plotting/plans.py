"""Figures of plans: what agents do and gain, and where capacity is scarce."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from sapopt.data.types import IntArray
from sapopt.plotting.style import (
    BLUES,
    BOUND,
    GRID,
    HEAT,
    IDLE,
    MUTED,
    PALETTE,
    axes_or_new,
    despine,
    few_ticks,
    name_of,
    step_axis,
)  # fmt: skip

if TYPE_CHECKING:
    from sapopt.problem.result import Result
    from sapopt.problem.sap import SAP


def benefit_history(
    problem: SAP, results: Mapping[str, Result], agent: int | str = 0, ax: Axes | None = None
) -> Axes:
    """Draw the benefit of the tasks that one agent holds over the steps, handovers marked (Holder 2024, Figure 4.4b).

    Parameters
    ----------
    problem : SAP
    results : mapping of str to Result
        One line for each. The legend tells how often the agent changed its task and what it earned in all.
    agent : int or str
        The agent, 0-based, or its label.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If there is no such agent.
    """
    if not isinstance(agent, str) and not 0 <= agent < problem.n:
        raise ValueError(f"agent must lie in 0..{problem.n - 1}, got {agent}")
    agent = int(_rows([agent], problem.n, problem.agents, "agent")[0])
    ax = axes_or_new(ax, (8.0, 3.6))
    steps = np.arange(problem.T)
    for number, (name, result) in enumerate(results.items()):
        color = PALETTE[number % len(PALETTE)]
        benefit = problem.held_benefits(result.plan)[:, agent]
        changed = _changes(problem, result.plan)[:, agent]
        label = f"{name}: benefit {benefit.sum():.1f}, {int(changed.sum())} handovers"
        # The later lines are thinner, so that equal stretches stay visible under each other.
        width = max(3.2 - 1.1 * number, 1.1)
        ax.plot(
            steps, benefit, color=color, lw=width, label=label, zorder=2 + number, solid_joinstyle="round"
        )
        ax.plot(
            steps[changed],
            benefit[changed],
            ls="none",
            marker="o",
            ms=5.5 - 0.6 * min(number, 3),
            mfc="white",
            mec=color,
            mew=1.3,
            zorder=10 + number,
        )
    ax.set_xlim(0, max(problem.T - 1, 1))
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    step_axis(ax)
    ax.set_ylabel(f"benefit of {problem.naming.agent(agent)}")
    ax.grid(axis="y", color=GRID, zorder=0)
    ax.set_axisbelow(True)
    ax.legend(
        loc="lower left", bbox_to_anchor=(0, 1.01), frameon=False, fontsize=9, title="circles: handovers",
        title_fontsize=9, alignment="left", ncols=2 if len(results) > 3 else 1,
    )  # fmt: skip
    despine(ax)
    return ax


def _rows(chosen: Sequence[int | str], count: int, labels: Sequence[str] | None, name: str) -> IntArray:
    """Numbers of agents or tasks that are given by number or by label."""
    known = {label: i for i, label in reversed(list(enumerate(labels or ())))}
    if isinstance(chosen, str) or len(chosen) == 0:
        raise ValueError(f"{name} must be a list of numbers in 0..{count - 1} or of labels, got {chosen!r}")
    rows = []
    for one in chosen:
        if isinstance(one, str) and one not in known:
            like = f"the first label is {labels[0]!r}" if labels else "there are no labels"
            raise ValueError(f"{name}: there is none called {one!r}; {like}")
        number = np.asarray(known[one] if isinstance(one, str) else one)
        if number.ndim or not np.issubdtype(number.dtype, np.integer) or not 0 <= number < count:
            raise ValueError(f"{name} must be numbers in 0..{count - 1} or labels, got {one!r}")
        rows.append(int(number))
    return np.array(rows, dtype=np.int64)


def timeline(
    problem: SAP, result: Result, agents: Sequence[int | str] | None = None, ax: Axes | None = None
) -> Axes:
    """Draw what every agent does at every step: the benefit of its task as colour, handovers as strokes.

    Parameters
    ----------
    problem : SAP
    result : Result
    agents : sequence of int or str, optional
        The agents to draw, from top to bottom, as numbers or by their labels; by default the first 40.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    rows = (
        np.arange(min(problem.n, 40))
        if agents is None
        else _rows(agents, problem.n, problem.agents, "agents")
    )
    ax = axes_or_new(ax, (9.0, 0.13 * len(rows) + 1.6))
    benefit = problem.held_benefits(result.plan)[:, rows].T
    changed = _changes(problem, result.plan)[:, rows].T
    image = ax.imshow(
        np.where(benefit > 0, benefit, np.nan),
        aspect="auto",
        interpolation="nearest",
        cmap=BLUES.with_extremes(bad=IDLE),
        vmin=0.0,
        vmax=max(float(benefit.max()), 1e-12),
    )
    row, step = np.nonzero(changed)
    x = step - 0.5
    strokes = np.stack([np.stack([x, row - 0.42], axis=1), np.stack([x, row + 0.42], axis=1)], axis=1)
    ax.add_collection(LineCollection(list(strokes), colors=BOUND, linewidths=1.1))
    ax.hlines(np.arange(len(rows) - 1) + 0.5, -0.5, problem.T - 0.5, color="white", lw=1.0)
    ax.set_yticks(*few_ticks(rows, problem.agents))
    step_axis(ax)
    ax.set_ylabel("agent")
    ax.set_title(
        f"{name_of(result)}: colour is the benefit of the task held, grey is idle, an orange stroke is a handover",
        fontsize=9,
        loc="left",
        color=MUTED,
    )
    bar = ax.figure.colorbar(image, ax=ax, pad=0.015, fraction=0.03)
    bar.set_label("benefit")
    bar.outline.set_visible(False)
    ax.tick_params(length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    return ax


def price_heat_map(
    prices: Any,
    tasks: int | Sequence[int | str] = 40,
    labels: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the price of the tasks over the steps: where capacity is scarce.

    Parameters
    ----------
    prices : array_like, shape (T, m)
        Task prices, for example ``bound(problem).prices``.
    tasks : int or sequence of int or str
        So many of the scarcest tasks (by the sum of their prices), or these tasks, as numbers or by `labels`; from top
        to bottom.
    labels : sequence of str, optional
        Names of all m tasks, for example ``problem.tasks``; their numbers if omitted.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If the prices are no matrix, or a task does not exist.
    """
    price = np.asarray(prices, dtype=np.float64)
    if price.ndim != 2 or not np.isfinite(price).all():
        raise ValueError(f"prices must be finite, of shape (T, m), got {price.shape}")
    m = price.shape[1]
    if isinstance(tasks, int):
        rows = np.argsort(-price.sum(axis=0), kind="stable")[: max(tasks, 0)]
        if len(rows) == 0:
            raise ValueError(f"tasks must be a positive count or numbers in 0..{m - 1}, got {tasks}")
    else:
        rows = _rows(tasks, m, labels, "tasks")
    ax = axes_or_new(ax, (9.0, 0.13 * len(rows) + 1.6))
    image = ax.imshow(
        price[:, rows].T,
        aspect="auto",
        interpolation="nearest",
        cmap=HEAT,
        vmin=0.0,
        vmax=price.max() if price.max() > 0 else 1.0,
    )
    ax.set_yticks(*few_ticks(rows, labels))
    step_axis(ax)
    ax.set_ylabel("task")
    bar = ax.figure.colorbar(image, ax=ax, pad=0.015, fraction=0.03)
    bar.set_label("price")
    bar.outline.set_visible(False)
    ax.tick_params(length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    return ax


def _changes(problem: SAP, plan: np.ndarray) -> np.ndarray:
    """Where an agent holds a task that it did not hold at the step before, shape (T, n)."""
    first = plan[:1] if problem.initial_assignment is None else np.asarray(problem.initial_assignment)[None]
    return (np.diff(plan, axis=0, prepend=first) != 0) & (plan >= 0)
