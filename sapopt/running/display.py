"""Progress on the terminal (standard error)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sapopt.running.control import Callback, Progress
from sapopt.running.streams import standard_error


@contextmanager
def progress_bar(name: str, callback: Callback | None) -> Iterator[Callback]:
    """Show the reports of a run as a bar with value, bound and gap; pass them on to `callback`."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Bar(*columns, console=Console(file=standard_error()), transient=True) as bar:
        task = bar.add_task(name, total=None, note="starting (the first run compiles the kernels)")

        def report(progress: Progress) -> bool | None:
            total = progress.total if progress.total > 0 else None
            bar.update(task, completed=progress.done, total=total, note=describe(progress))
            return callback(progress) if callback is not None else None

        yield report


def describe(progress: Progress) -> str:
    """One line: phase, value, bound, gap."""
    parts = [progress.message] if progress.message else []
    if progress.value is not None:
        parts.append(f"value {progress.value:,.1f}")
    if progress.bound is not None:
        parts.append(f"bound {progress.bound:,.1f}")
    if progress.gap is not None:
        parts.append(f"gap {100 * progress.gap:.2f} %")
    return "  ".join(parts)
