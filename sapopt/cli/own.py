"""The class of a user's own dynamics that the command line hands over: ``--dynamics MODULE:CLASS``."""

from __future__ import annotations

from contextvars import ContextVar

_NAMED: ContextVar[str | None] = ContextVar("dynamics", default=None)


def hand_over(name: str | None) -> None:
    """Note what this run of the program was given; a ValueError if there is no such class."""
    from sapopt.sweeps.handed import handed_over

    _NAMED.set(name)
    if name is not None:
        handed_over(name)


def named() -> str | None:
    """``MODULE:CLASS``, or None."""
    return _NAMED.get()


def dynamics() -> type | None:
    """The class itself, or None."""
    from sapopt.sweeps.handed import handed_over

    name = _NAMED.get()
    return None if name is None else handed_over(name)
