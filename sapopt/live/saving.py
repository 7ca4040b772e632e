"""Sessions in files: everything that is carried, as plain values and arrays."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

import sapopt.solvers
from sapopt.data.files import Entry, read_npz, write_npz
from sapopt.dynamics.base import AgentColumns, Dynamics
from sapopt.dynamics.capabilities import offers
from sapopt.dynamics.registry import is_own
from sapopt.live.decision import Assignment
from sapopt.live.limits import session_limits
from sapopt.live.names import Name, Roster, checked_name
from sapopt.live.window import DynamicsOf, Settings, Standing
from sapopt.problem.description import described, described_own, rebuilt, rebuilt_own
from sapopt.problem.limit_files import described_limits, rebuilt_limits
from sapopt.running.outlook import Carrying, Policy

_FORMAT = "sapopt-session-1"
_MOST_BYTES = 4 * 2**30
_ENTRIES = {
    "held": Entry("i", (None,), optional=True),
    "prices": Entry("f", (None, None), optional=True),
}
_PREFIXES = ("dynamics.", "limit.", "memory.", "column.tasks.", "column.values.")
_PLAIN = (bool, int, float, str, type(None))


def saved(path: str | Path, settings: Settings, standing: Standing) -> None:
    """Write a session.

    Raises
    ------
    ValueError
        If its state is not of the kind that files hold.
    """
    if standing.columns is None and standing.state is not None:
        raise ValueError(
            f"dynamics: the state of {settings.dynamics!r} is not told by agents, so no file can hold it; define "
            "agent_columns(state) and of_columns(columns) (sapopt.dynamics.base.Model)"
        )
    meta: dict[str, Any] = {
        "format": _FORMAT,
        "policy": _policy(settings.policy),
        "policy_name": settings.policy.name,
    }
    arrays: dict[str, Any] = {}
    dynamics = settings.dynamics
    if isinstance(dynamics, Dynamics) and not is_own(dynamics):
        told, parts = described(dynamics)
        meta |= told
        arrays |= parts
    elif isinstance(dynamics, Dynamics) and offers(dynamics, "fingerprint"):
        told, parts = described_own(dynamics)
        meta |= told
        arrays |= parts
    else:  # a function, or a rule that does not tell what decides its values: only its name is compared
        meta["own dynamics"] = type(dynamics).__name__
    told, parts = described_limits(settings.limits)
    meta |= told
    arrays |= parts
    capacity = settings.capacity
    meta |= {
        "idle": settings.idle,
        "capacity": capacity if isinstance(capacity, int) else list(map(list, capacity.items())),
        "announce": settings.announce, "change_cost": settings.change_cost, "prove": settings.prove,
        "seed": settings.seed, "holding": list(map(list, settings.holding.items())),
        "step": standing.step, "agents": list(standing.agents.names), "tasks": list(standing.tasks.names),
        "decided": standing.decided, "rows": list(standing.rows), "remembers": standing.memory is not None,
        "announced": [list(map(list, step.items())) for step in standing.announced],
        "used": [[number, list(map(list, count.items()))] for number, count in standing.used.items()],
    }  # fmt: skip
    if standing.held is not None:
        arrays["held"] = standing.held
    if standing.prices is not None:
        arrays["prices"] = standing.prices
    if standing.columns is not None:
        arrays |= {f"column.tasks.{name}": values for name, values in standing.columns.tasks.items()}
        arrays |= {f"column.values.{name}": values for name, values in standing.columns.values.items()}
    if isinstance(settings.policy, Carrying) and standing.memory is not None:
        stored = settings.policy.stored(standing.memory)
        arrays |= {f"memory.{name}": values for name, values in stored.items()}
    write_npz(path, meta, arrays)


def loaded(
    path: str | Path, policy: Policy | None, dynamics: Dynamics | type[Dynamics] | DynamicsOf | None
) -> tuple[Settings, Standing]:
    """Read a session.

    Raises
    ------
    ValueError
        If the file is damaged, or a policy or dynamics is needed that no file holds.
    """
    meta, arrays = read_npz(path, _FORMAT, _ENTRIES, _MOST_BYTES, prefix=_PREFIXES)
    wrong = (KeyError, TypeError, AttributeError, IndexError, OverflowError)
    try:
        policy, dynamics = _same_policy(path, meta, policy), _same_dynamics(path, meta, arrays, dynamics)
    except wrong as error:
        raise ValueError(f"{path}: damaged session file ({error})") from None
    try:
        settings = Settings(
            policy, dynamics, _truth(meta["idle"]),
            meta["capacity"] if isinstance(meta["capacity"], int) else _named(meta["capacity"]),
            session_limits(rebuilt_limits(meta, arrays)), _whole(meta["announce"]), _number(meta["change_cost"]),
            _named(meta["holding"]), _truth(meta["prove"]), _whole(meta["seed"]),
        )  # fmt: skip
        standing = _standing(settings, meta, arrays)
    except (*wrong, ValueError) as error:
        raise ValueError(f"{path}: damaged session file ({error})") from None
    return settings, standing


def _standing(settings: Settings, meta: dict[str, Any], arrays: dict[str, np.ndarray]) -> Standing:
    agents, tasks = _roster(meta["agents"]), _roster(meta["tasks"])
    step = _whole(meta["step"])
    if step == 0 or ("held" not in arrays and not len(agents)):  # no call with an agent yet
        return Standing(step)
    parts = {prefix: {key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)}
             for prefix in _PREFIXES}  # fmt: skip
    columns = AgentColumns(
        {name: values.astype(np.int64) for name, values in parts["column.tasks."].items()},
        parts["column.values."],
    )
    held = arrays["held"].astype(np.int64)
    most = len(tasks) + settings.idle
    for values in (held, *columns.tasks.values()):
        if values.shape != (len(agents),) or values.min(initial=0) < -1 or values.max(initial=-1) >= most:
            raise TypeError("its agents hold tasks that are not there")
    if any(len(values) != len(agents) for values in columns.values.values()):
        raise TypeError("its states are not one for each agent")
    prices = arrays.get("prices")
    if prices is not None and (
        prices.shape[1] != len(tasks) + settings.idle or not np.isfinite(prices).all()
    ):
        raise TypeError("its prices are not finite, or not one for each task")
    memory = None
    if isinstance(settings.policy, Carrying) and _truth(meta["remembers"]):
        memory = settings.policy.restored(parts["memory."])
    used = {
        _whole(number): {_name(key): _number(value) for key, value in count} for number, count in meta["used"]
    }
    announced = tuple(_named_or_none(entry) for entry in meta["announced"])
    return Standing(
        step, agents, tasks, held, None, columns, memory, tuple(str(row) for row in meta["rows"]),
        _whole(meta["decided"], -1), announced, used, prices,
    )  # fmt: skip


def _policy(policy: Policy) -> dict[str, Any] | None:
    """A policy of sapopt with plain options, by its class and what it was made with; None for any other."""
    name = type(policy).__name__
    if name not in sapopt.solvers.__all__ or getattr(sapopt.solvers, name) is not type(policy):
        return None
    options: dict[str, Any] = {}
    for item in dataclasses.fields(policy):  # type: ignore[arg-type]  # every solver of sapopt is a dataclass
        value = getattr(policy, item.name)
        if item.init and type(value) in _PLAIN:
            options[item.name] = value
        elif item.init and _generator(value) is not None:
            options[item.name] = {"generator": _generator(value)}
        elif item.init:
            return None
    return {"class": name, "options": options}


def _generator(value: Any) -> str | None:
    """The name of a generator of sapopt, None for anything else."""
    return next((name for name in sapopt.solvers.__all__
                 if name.islower() and getattr(sapopt.solvers, name) is value), None)  # fmt: skip


def _same_policy(path: str | Path, meta: dict[str, Any], given: Policy | None) -> Policy:
    told, name = meta["policy"], str(meta["policy_name"])
    if given is None:
        if told is None:
            raise ValueError(
                f"{path}: its policy, {name}, is in no file; pass it: Session.load(path, policy=...)"
            )
        if told["class"] not in sapopt.solvers.__all__:
            raise TypeError(f"no policy {told['class']!r}")
        options = {
            str(key): getattr(sapopt.solvers, value["generator"])
            if isinstance(value, dict) and value["generator"] in sapopt.solvers.__all__ else value
            for key, value in told["options"].items()
        }  # fmt: skip
        given = getattr(sapopt.solvers, told["class"])(**options)
    if not isinstance(given, Policy):
        raise ValueError(f"policy must decide step by step, such as DualLookahead(6), got {given!r}")
    if given.name != name:
        raise ValueError(f"policy: the session was saved with {name}, got {given.name}")
    return given


def _same_dynamics(
    path: str | Path, meta: dict[str, Any], arrays: dict[str, np.ndarray], given: Any
) -> Dynamics | DynamicsOf:
    if "own" in meta:
        own: Dynamics = rebuilt_own(meta, arrays, given, path, "Session.load")
        return own
    if "own dynamics" not in meta:
        if given is not None:
            raise ValueError(f"dynamics: {path} holds the dynamics itself, so none is to be passed")
        built: Dynamics = rebuilt(meta, arrays)
        return built
    name = meta["own dynamics"]
    if given is None:
        raise ValueError(
            f"{path}: its dynamics, {name}, is in no file; pass it: Session.load(path, dynamics=...)"
        )
    if type(given).__name__ != name:
        raise ValueError(f"dynamics: the session was saved with {name}, got {type(given).__name__}")
    return given


def _roster(names: Any) -> Roster:
    out = tuple(_name(name) for name in names)
    if len(set(out)) < len(out):
        raise TypeError("an id is there twice")
    return Roster(out)


def _name(value: Any) -> Name:
    return checked_name(value, "ids")


def _named(pairs: Any) -> dict[Name, Any]:
    return {_name(key): value for key, value in pairs}


def _named_or_none(pairs: Any) -> Assignment:
    return {_name(key): None if value is None else _name(value) for key, value in pairs}


def _truth(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{value!r} is not true or false")
    return value


def _whole(value: Any, least: int = 0) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise TypeError(f"{value!r} is not a whole number from {least} on")
    return value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise TypeError(f"{value!r} is not a finite number")
    return float(value)
