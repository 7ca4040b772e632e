"""Progress on stderr: live bars on a terminal, plain lines everywhere else. Nothing here ever touches stdout."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from sapopt.kernels import clock
from sapopt.running.streams import standard_error

_LINE_EVERY_S = 10.0
"""Without a terminal, a running phase says at most this often how far it is."""


class Phase:
    """One stretch of work that the user waits for."""

    def __init__(self, reporter: Reporter, text: str, task: TaskID | None) -> None:
        self._reporter = reporter
        self._text = text
        self._task = task
        self._said = self.started = time.perf_counter()
        self.note = ""

    def update(self, done: float | None = None, total: float | None = None, note: str | None = None) -> None:
        """Tell how far the work is: `done` of `total`, and a word such as the current bound."""
        if note is not None:
            self.note = note
        if self._task is not None:
            self._reporter.bars.update(self._task, completed=done, total=total, note=self.note)
            return
        now = time.perf_counter()
        if now - self._said >= _LINE_EVERY_S:
            self._said = now
            share = f" {100 * done / total:.0f} %" if done is not None and total else ""
            self._reporter.line(f"  {self._text}:{share} {self.note}".rstrip())


class Reporter:
    """Shows the phases of a command. Use as a context manager."""

    def __init__(self) -> None:
        self._told = ExitStack()
        self.console = Console(file=standard_error(), highlight=False, soft_wrap=True)
        self.live = self.console.is_terminal
        self.bars = Progress(
            SpinnerColumn(finished_text="[green]✓[/]"),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            console=self.console,
        )

    def __enter__(self) -> Reporter:
        if self.live:
            self.bars.start()
        self._told.enter_context(clock.told_when_long(self.line))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._told.close()
        if self.live:
            self.bars.stop()

    def line(self, text: str) -> None:
        """Print one line."""
        self.console.print(text, markup=False)

    @contextmanager
    def phase(self, text: str, total: int | None = None) -> Iterator[Phase]:
        """Show a phase while the block runs; its last note stays as its outcome."""
        task = self.bars.add_task(text, total=total, note="") if self.live else None
        if task is None:
            self.line(f"{text} ...")
        phase = Phase(self, text, task)
        try:
            yield phase
        except BaseException:
            if task is not None:
                self.bars.stop_task(task)
            raise
        if task is None:
            self.line(f"{text}: {phase.note or 'done'} ({time.perf_counter() - phase.started:.1f} s)")
        else:
            self.bars.update(task, total=1, completed=1, note=phase.note)
