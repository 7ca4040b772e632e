"""What the figures of the domains share."""

from __future__ import annotations

from matplotlib.axes import Axes


def axes(ax: Axes | None, size: tuple[float, float]) -> Axes:
    """The axes given, or those of a new figure of this size in inches."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt  # only here: whoever brings an axes needs no window system

    return plt.subplots(figsize=size, layout="constrained")[1]
