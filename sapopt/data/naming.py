"""What messages call agents, tasks and steps: by their names where they have some, else by their numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sapopt.data.times import Time, as_text

_MOST = 8
"""Agents that a message lists."""


@dataclass(frozen=True)
class Naming:
    """The names of a problem.

    Attributes
    ----------
    agents, tasks : tuple of str or None
    times : tuple of datetime, int or float, or None
        When the steps begin.
    """

    agents: tuple[str, ...] | None = None
    tasks: tuple[str, ...] | None = None
    times: tuple[Time, ...] | None = None

    def agent(self, i: Any) -> str:
        """``agent 3``, or ``agent 'Eva'``."""
        return f"agent {_called(self.agents, int(i))}"

    def several(self, agents: Iterable[Any]) -> str:
        """``agents 0, 1``, or ``agents 'Eva', 'Ada'``; the first eight."""
        names = [_called(self.agents, int(i)) for i in agents]
        return f"agents {', '.join(names[:_MOST])}" + (", ..." if len(names) > _MOST else "")

    def task(self, j: Any) -> str:
        """``task 3``, or ``task 'ward'``."""
        return f"task {_called(self.tasks, int(j))}"

    def step(self, k: Any) -> str:
        """``step 3``, or ``step 3 (2026-03-01T06:00:00)``."""
        return f"step {k}" if self.times is None else f"step {k} ({as_text(self.times[int(k)])})"


def _called(labels: tuple[str, ...] | None, number: int) -> str:
    return repr(labels[number]) if labels is not None and 0 <= number < len(labels) else str(number)
