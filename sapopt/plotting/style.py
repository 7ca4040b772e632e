"""Colours and axes that all figures share."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import MaxNLocator

from sapopt.problem.result import Result

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
BAR, BEST, BOUND, MUTED, IDLE, GRID = "#9DB8CF", "#0072B2", "#D55E00", "#666666", "#E4E4E4", "#EEEEEE"
BLUES = LinearSegmentedColormap.from_list("held", ["#D6E6F2", "#0072B2", "#06304D"])
HEAT = LinearSegmentedColormap.from_list("price", ["#FFFFFF", "#FFE2B2", "#F69848", "#B22418", "#4A0816"])


def axes_or_new(ax: Axes | None, size: tuple[float, float]) -> Axes:
    """The axes given, or those of a new pyplot figure of this size in inches."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt  # only here: whoever brings an axes needs no window system

    return plt.subplots(figsize=size, layout="constrained")[1]


def despine(ax: Axes, left: bool = False) -> None:
    """Take away the frame but for the axes that are read."""
    for side in ("top", "right", *(("left",) if left else ())):
        ax.spines[side].set_visible(False)


def step_axis(ax: Axes) -> None:
    """Name the horizontal axis of the steps, which are whole numbers and counted from 0."""
    ax.set_xlabel("step")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))


def few_ticks(rows: np.ndarray, labels: Any = None) -> tuple[np.ndarray, list[str]]:
    """Places and labels of at most about 20 rows."""
    shown = np.arange(0, len(rows), -(-len(rows) // 20))
    return shown, [str(rows[k] if labels is None else labels[rows[k]]) for k in shown]


def name_of(result: Any) -> str:
    """What to call a result."""
    return result.solver if isinstance(result, Result) else "plan"
