"""What planners must say beyond benefits: limits on the whole plan, and teams."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

import numpy as np

Kind = Literal["weight", "once", "visits", "cover", "work", "handovers"]
Chosen = int | str | Sequence[int | str] | np.ndarray | None
"""Agents, tasks or steps: one of them or several, by index or (agents and tasks) by label; None for all."""


@dataclass(frozen=True, eq=False)
class Limit:
    """A linear limit on the whole plan: ``at_least <= sum of weight * x <= at_most``.

    ``x[k, i, j]`` is 1 where agent i holds task j at step k. The class methods write the usual limits; each of them
    may stand for several sums, such as one for every task.

    Parameters
    ----------
    weight : array_like or list of T sparse matrices
        Weight of every pair: anything that broadcasts to ``(T, n, m)``, or one ``(n, m)`` sparse matrix for each step.
        Holding nothing weighs 0.
    at_most, at_least : float, optional
        The sum may be no more, and no less; at least one of the two is needed. Where a weight or a bound is no whole
        number, a sum may go beyond by ``1e-9 * max(1, |bound|)``, so that rounding decides nothing.
    name : str, optional
        For messages and reports; by default the kind of the limit.
    penalty : float, optional
        Cost of each unit by which the sum is beyond its bounds. None: the limit is hard, and a plan that breaks it is
        none.

    Raises
    ------
    ValueError
        If a bound is NaN, ``at_least`` is above ``at_most``, or no bound is given. What does not fit a problem is said
        when the problem is built.

    Examples
    --------
    >>> import numpy as np
    >>> from sapopt import SAP
    >>> problem = SAP(np.ones((4, 1, 1)), 0.0, idle=True, limits=[Limit.once()])
    >>> problem.evaluate([[-1], [0], [-1], [-1]]).limits[0]
    LimitUse(name='once[0]', use=1.0, at_most=1.0, at_least=-inf, cost=0.0)
    """

    weight: Any
    at_most: float | None = None
    at_least: float | None = None
    name: str | None = field(default=None, kw_only=True)
    penalty: float | None = field(default=None, kw_only=True)
    kind: Kind = field(default="weight", init=False)
    tasks: Any = field(default=None, init=False)
    agents: Any = field(default=None, init=False)
    steps: Any = field(default=None, init=False)
    each: bool = field(default=False, init=False)
    served: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        for which in ("at_most", "at_least", "penalty"):
            value = getattr(self, which)
            if value is not None:
                object.__setattr__(self, which, _number(value, which))
        if self.at_most is None and self.at_least is None:
            raise ValueError("at_most, at_least: a limit needs at least one of the two")
        if self.at_most is not None and self.at_least is not None and self.at_least > self.at_most:
            raise ValueError(
                f"at_least={self.at_least:g} is above at_most={self.at_most:g}; no plan is between them"
            )
        if self.penalty is not None and self.penalty <= 0:
            raise ValueError(
                f"penalty must be positive, got {self.penalty:g}; leave it out for a limit that must hold"
            )
        if self.name is not None and not isinstance(self.name, str):
            raise ValueError(f"name must be a text, got {self.name!r}")

    def __repr__(self) -> str:
        parts = [f"at_most={self.at_most:g}" if self.at_most is not None else "",
                 f"at_least={self.at_least:g}" if self.at_least is not None else "",
                 f"penalty={self.penalty:g}" if self.penalty is not None else ""]  # fmt: skip
        return f"Limit({self.called}: {', '.join(part for part in parts if part)})"

    @property
    def called(self) -> str:
        """The name, or else the kind."""
        return self.kind if self.name is None else self.name

    @classmethod
    def once(
        cls, tasks: Chosen = None, times: float = 1, *, name: str | None = None, penalty: float | None = None
    ) -> Limit:
        """Each of these tasks is served in at most `times` agent-steps over the horizon.

        An agent serves a task at a step when it holds it and the benefit there is positive.
        """
        return cls._made("once", times, None, name, penalty, tasks=tasks)

    @classmethod
    def visits(
        cls,
        tasks: Chosen = None,
        at_most: float = 1,
        *,
        name: str | None = None,
        penalty: float | None = None,
    ) -> Limit:
        """Each of these tasks is served in at most so many visits.

        A visit is an agent that serves the task for one or several steps on end.
        """
        return cls._made("visits", at_most, None, name, penalty, tasks=tasks)

    @classmethod
    def cover(
        cls,
        tasks: Chosen,
        at_least: float,
        steps: Chosen = None,
        *,
        served: bool = False,
        name: str | None = None,
        penalty: float | None = None,
    ) -> Limit:
        """At each of these steps at least so many agents hold one of these tasks.

        With `served` only those count that serve it: to whom it is worth something there.
        """
        if not isinstance(served, (bool, np.bool_)):
            raise ValueError(f"served must be True or False, got {served!r}")
        return cls._made(
            "cover", None, at_least, name, penalty, tasks=tasks, steps=steps, served=bool(served)
        )

    @classmethod
    def work(
        cls,
        agents: Chosen = None,
        at_most: float | None = None,
        at_least: float | None = None,
        *,
        name: str | None = None,
        penalty: float | None = None,
    ) -> Limit:
        """Each of these agents serves some task in at most, or at least, so many steps."""
        return cls._made("work", at_most, at_least, name, penalty, agents=agents)

    @classmethod
    def handovers(
        cls,
        at_most: float,
        agents: Chosen = None,
        each: bool = False,
        *,
        name: str | None = None,
        penalty: float | None = None,
    ) -> Limit:
        """At most so many handovers, of all these agents together or of `each` of them.

        A handover is a step at which an agent takes up a task that it did not hold the step before; going idle is none.
        Without an initial assignment there is no step before the first.
        """
        if not isinstance(each, (bool, np.bool_)):
            raise ValueError(f"each must be True or False, got {each!r}")
        return cls._made("handovers", at_most, None, name, penalty, agents=agents, each=bool(each))

    @classmethod
    def _made(
        cls,
        kind: Kind,
        at_most: float | None,
        at_least: float | None,
        name: str | None,
        penalty: float | None,
        **chosen: Any,
    ) -> Limit:
        out = cls(None, at_most, at_least, name=name, penalty=penalty)
        for key, value in {"kind": kind, **chosen}.items():
            object.__setattr__(out, key, value)
        return out


@dataclass(frozen=True, eq=False)
class Team:
    """A reward for holding one task together; it stands among the limits of a problem.

    The reward is earned at every step at which at least `needs` agents hold the task, once a step. The task's capacity
    must let so many in.

    Parameters
    ----------
    task : int or str
        Index or label.
    needs : int
        At least 1.
    reward : float
        Not negative.
    steps : int, sequence of int, or None
        The steps at which it may be earned; all by default.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    task: int | str
    needs: int
    reward: float
    steps: Any = None

    def __post_init__(self) -> None:
        if isinstance(self.needs, bool) or not isinstance(self.needs, numbers.Integral) or self.needs < 1:
            raise ValueError(f"needs must be a whole number of at least 1, got {self.needs!r}")
        object.__setattr__(self, "reward", _number(self.reward, "reward"))
        if self.reward < 0:
            raise ValueError(f"reward must not be negative, got {self.reward:g}")

    @property
    def called(self) -> str:
        """For messages."""
        return f"team[{self.task}]"


def _number(value: Any, name: str) -> float:
    if (
        isinstance(value, (bool, np.bool_))
        or not isinstance(value, numbers.Real)
        or not np.isfinite(float(value))
    ):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return float(value)


def chosen(values: Any, count: int, labels: Sequence[str] | None, name: str) -> np.ndarray:
    """Indices (ascending, none twice) that a user chose out of `count`, by index or label.

    Raises
    ------
    ValueError
        If there is no such agent, task or step.
    """
    if values is None:
        return np.arange(count)
    several = values if isinstance(values, (list, tuple, set, frozenset, range, np.ndarray)) else [values]
    if isinstance(several, np.ndarray) and several.dtype == bool:
        if several.shape != (count,):
            raise ValueError(f"{name}: a mask must have shape ({count},), got {several.shape}")
        several = np.flatnonzero(several)
    found = []
    for value in np.ravel(several) if isinstance(several, np.ndarray) else several:
        if isinstance(value, str):
            if labels is None or value not in labels:
                raise ValueError(f"{name}: there is none with the label {value!r}")
            found.append(labels.index(value))
        elif isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Integral):
            raise ValueError(f"{name} must be indices or labels, got {value!r}")
        elif not 0 <= int(value) < count:
            raise ValueError(f"{name}: {value} is outside 0..{count - 1}")
        else:
            found.append(int(value))
    return np.unique(np.array(found, dtype=np.int64))


def checked_limits(limits: Any) -> tuple[Limit | Team, ...]:
    """The limits of a problem as a tuple.

    Raises
    ------
    ValueError
        If an entry is neither a `Limit` nor a `Team`.
    """
    if isinstance(limits, (Limit, Team)):
        return (limits,)
    try:
        out = tuple(limits)
    except TypeError:
        raise ValueError(f"limits must be a list of Limit and Team, got {limits!r}") from None
    for entry in out:
        if not isinstance(entry, (Limit, Team)):
            raise ValueError(f"limits must hold Limit and Team only, got {entry!r}")
    return cast("tuple[Limit | Team, ...]", out)
