"""What the command line's words mean: solver specifications such as ``haal:6``, and instances by name or file."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import sapopt.solvers


@dataclass(frozen=True)
class Method:
    """A solver as the command line offers it: its name, class, its parameter if any, and a line of help."""

    name: str
    class_name: str
    about: str
    parameter: str | None = None
    default: int | None = None
    options: tuple[tuple[str, Any], ...] = ()


METHODS = (
    Method("no-handover", "NoHandover", "the best assignment of each step, as if handovers were free"),
    Method("greedy", "Greedy", "GA: serve a task until it is out of view, then the best free one"),
    Method("myopic-greedy", "MyopicGreedy", "agent by agent, the task that is best now"),
    Method("haa", "HAA", "Algorithm 1: the best assignment of each step, handovers charged"),
    Method("haal", "HAAL", "Algorithm 2: HAA with lookahead L", "lookahead", 3),
    Method(
        "haal-exact",
        "HAAL",
        "HAAL with intervals chosen by what they really yield",
        "lookahead",
        3,
        options=(("exact_intervals", True),),
    ),
    Method("haal-d", "HAALD", "Algorithm 3: HAAL by auctions between the agents", "lookahead", 3),
    Method("cbba", "CBBA", "consensus-based bundle algorithm between the agents", "lookahead", 1),
    Method("dual-lookahead", "DualLookahead", "receding horizon of W steps with task prices", "window", 6),
    Method(
        "dual-lookahead-d",
        "DistributedDualLookahead",
        "dual-lookahead with prices from the neighbours",
        "window",
        6,
    ),
    Method("dual-decomposition", "DualDecomposition", "the whole horizon with task prices; proves a bound"),
    Method("exact", "Exact", "an optimal plan, if time allows; proves a bound"),
    Method("exact-dp", "Exact", "the same for tiny problems of any dynamics", options=(("method", "dp"),)),
    Method("iterated", "IteratedAssignment", "alpha again and again, for benefits that interact"),
)


@dataclass(frozen=True)
class NamedSolver:
    """A solver object and the name under which tables and files show it."""

    name: str
    solver: Any


def methods_help() -> str:
    """The solver names on one line."""
    return ", ".join(m.name if m.parameter is None else f"{m.name}:{m.parameter[0].upper()}" for m in METHODS)


def nearest(word: str, known: Iterable[str], what: str) -> str:
    """The text of the error for an unknown word, with the nearest known one."""
    known = list(known)
    close = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"
    return f"unknown {what} {word!r}; {hint}"


def parse_solver(spec: str, number: int | None = None) -> NamedSolver:
    """Build the solver that a specification ``name`` or ``name:number`` means.

    Parameters
    ----------
    spec : str
        Case, hyphens and underscores do not matter: ``HAAL:6``, ``dual_lookahead``.
    number : int, optional
        The parameter, where the specification leaves it out.

    Raises
    ------
    ValueError
        If the solver is unknown (the message suggests the nearest) or its parameter is not a number it accepts.
    """
    name, colon, text = spec.strip().partition(":")
    method = {_plain(m.name): m for m in METHODS}.get(_plain(name))
    if method is None:
        raise ValueError(nearest(name, [m.name for m in METHODS], "solver"))
    if colon:
        if number is not None:
            raise ValueError(
                f"solver {spec!r} already names its {method.parameter or 'parameter'}; leave one of them out"
            )
        if not re.fullmatch(r"[+-]?\d+", text):
            raise ValueError(f"solver {spec!r}: {text!r} is not a whole number")
        number = int(text)
    cls = getattr(sapopt.solvers, method.class_name)
    if method.parameter is None:
        if number is not None:
            raise ValueError(f"solver {method.name!r} takes no number, got {number}")
        return NamedSolver(method.name, cls(**dict(method.options)))
    value = method.default if number is None else number
    return NamedSolver(f"{method.name}:{value}", cls(**{method.parameter: value} | dict(method.options)))


def parse_solvers(specs: str) -> list[NamedSolver]:
    """Build the solvers of a comma-separated list; each may appear once."""
    solvers = [parse_solver(spec) for spec in specs.split(",") if spec.strip()]
    names = [solver.name for solver in solvers]
    if not solvers:
        raise ValueError(f"no solver given; known: {methods_help()}")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"solver {name!r} is listed twice")
    return solvers


def _plain(name: str) -> str:
    return re.sub(r"[-_ ]", "", name).lower()
