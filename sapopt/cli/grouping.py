"""Commands that take many options, as dataclasses of them rather than as one long list of arguments."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any, get_type_hints


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Show the fields of a command's dataclass arguments to typer as options of the command.

    The options stand where the argument stands, under the names and with the defaults of the fields. The command gets
    the dataclass made of them.

    Parameters
    ----------
    command : callable
        An argument whose annotation is a dataclass is a group of options; every field of it has a default and is
        annotated as an argument of a command is. The other arguments are left as they are.

    Returns
    -------
    callable
        What ``app.command`` takes; all arguments by keyword.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, tuple[type, list[str]]] = {}
    shown: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
            shown.append(parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=kind))
            continue
        options = get_type_hints(kind, include_extras=True)
        fields = dataclasses.fields(kind)
        groups[name] = kind, [field.name for field in fields]
        shown += [
            inspect.Parameter(
                field.name, parameter.KEYWORD_ONLY, default=field.default, annotation=options[field.name]
            )
            for field in fields
        ]

    def run(**given: Any) -> None:
        made = {
            name: kind(**{field: given.pop(field) for field in of}) for name, (kind, of) in groups.items()
        }
        command(**given, **made)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]  # read by inspect; functions are not typed to have one
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
    return run
