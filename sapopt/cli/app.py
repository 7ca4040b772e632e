"""The commands. ``sapopt.cli.main`` is the entry point of the ``sapopt`` program."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

import typer
from typer.core import TyperGroup

import sapopt
from sapopt.problem.sap import SAP

log = logging.getLogger(__name__)

DEFAULT_SOLVER = "haal"
EXIT_BAD_ARGUMENT = 2
EXIT_INTERRUPTED = 130


class _OneLineErrors(TyperGroup):
    """Turns every error of the user into one line on stderr and exit status 2."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command; `standalone_mode` ends the process with the exit status."""
        try:
            args = _dynamics_first(sys.argv[1:] if args is None else list(args))
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except typer.Abort:
            code = EXIT_INTERRUPTED
        except SystemError as error:
            # Ctrl-C in the middle of a compiled kernel comes out like this.
            if not isinstance(error.__cause__, KeyboardInterrupt):
                raise
            code = EXIT_INTERRUPTED
        except Exception as error:
            message = _message(error)
            if message is None:
                raise
            log.debug("bad argument", exc_info=True)
            if message:
                print(f"sapopt: {message}", file=sys.stderr)
            code = EXIT_BAD_ARGUMENT
        if standalone_mode:
            sys.exit(code or 0)
        return code


def _dynamics_first(args: list[str]) -> list[str]:
    """The arguments with ``--dynamics X``, an option of the program, before the name of the command."""
    if "--" in args:
        return args
    moved: list[str] = []
    rest: list[str] = []
    words = iter(args)
    for word in words:
        if word == "--dynamics":
            moved += [word, *([value] if (value := next(words, None)) is not None else [])]
        elif word.startswith("--dynamics="):
            moved.append(word)
        else:
            rest.append(word)
    return moved + rest


@runtime_checkable
class _UsageError(Protocol):
    """An error of the argument parser."""

    def format_message(self) -> str:
        """What is wrong."""


def _message(error: Exception) -> str | None:
    """One line for an error that the user can mend, None for one that is ours."""
    if isinstance(error, _UsageError):
        text = str(error.format_message())
    elif isinstance(error, ValueError | OSError | ImportError):  # an import fails where an extra is missing
        text = str(error)
    else:
        return None
    return " ".join(text.split())


app = typer.Typer(
    cls=_OneLineErrors,
    name="sapopt",
    help="Sequential assignment problems: solve them, and prove how far each answer is from the optimum.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

InstanceArgument = Annotated[
    str,
    typer.Argument(
        metavar="INSTANCE",
        help="A built-in name (see `sapopt instances`) or an .npz file; with --dynamics MODULE:CLASS if its dynamics "
        "is your own.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of a built-in instance and of the solvers.")]
Cost = Annotated[
    float | None, typer.Option(min=0.0, help="Handover cost of a built-in instance, instead of its own.")
]
TimeLimit = Annotated[
    float | None, typer.Option(help="Seconds for each solver and bound; then the best so far is returned.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON to stdout, and nothing else.")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for JSON, npz and PNG files.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
Lookahead = Annotated[
    int | None, typer.Option("--lookahead", "--window", "-L", help="Steps that the solver looks ahead.")
]
RangeKm = Annotated[
    float | None,
    typer.Option(
        "--range-km",
        help="Satellites closer than this hear each other in distributed solvers; 2500 if omitted, inf for all.",
    ),
]
Agent = Annotated[
    str, typer.Option(help="The agent whose benefit history is drawn, by name or number (from 0).")
]


def _version(wanted: bool) -> None:
    if wanted:
        print(sapopt.__version__)
        raise typer.Exit


@app.callback(invoke_without_command=False)
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and stop.", is_eager=True, callback=_version),
    ] = False,
    dynamics: Annotated[
        str | None,
        typer.Option(
            metavar="MODULE:CLASS",
            help="The class of the dynamics in problem files, where it is your own; may also stand behind a command.",
        ),
    ] = None,
) -> None:
    from sapopt.cli import own

    own.hand_over(dynamics)


@app.command(name="instances")
def _instances(as_json: AsJson = False) -> None:
    """List the built-in instances."""
    from rich.table import Table

    from sapopt.cli.show import print_json, print_table
    from sapopt.domains.instances import instances

    known = instances()
    if as_json:
        print_json(
            [
                {
                    "name": i.name,
                    "summary": i.summary,
                    "steps": i.shape[0],
                    "agents": i.shape[1],
                    "tasks": i.shape[2],
                    "cost": i.cost,
                }
                for i in known
            ]
        )
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("name", "what it is"):
        table.add_column(column, no_wrap=column == "name")
    for entry in known:
        table.add_row(entry.name, entry.summary)
    print_table(table)


def check_time(time_limit: float | None) -> None:
    """Refuse a time limit that is not a positive number, before any work."""
    if time_limit is not None and not 0 < time_limit < float("inf"):
        raise ValueError(f"--time-limit must be a positive number of seconds, got {time_limit}")


def agent_number(agent: str, problem: SAP) -> int:
    """The agent that a name or number means; a ValueError if the problem does not have it."""
    if problem.agents is not None and agent in problem.agents:
        return problem.agents.index(agent)
    if agent.isdecimal() and int(agent) < problem.n:
        return int(agent)
    named = "" if problem.agents is None else f", or be a name such as {problem.agents[0]!r}"
    raise ValueError(f"--agent must lie in 0..{problem.n - 1}{named}, got {agent}")
