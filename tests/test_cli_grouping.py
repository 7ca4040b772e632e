"""Options of a command that stand in a dataclass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from sapopt.cli.grouping import grouped


@dataclass(frozen=True)
class Paint:
    """Two options."""

    colour: Annotated[str, typer.Option(help="Of the wall.")] = "white"
    coats: Annotated[int, typer.Option(min=1, help="How often.")] = 2


def painter(seen: list[tuple[Paint, str, bool]]) -> typer.Typer:
    """A program that notes what its command is called with."""
    app = typer.Typer()

    @app.command()
    @grouped
    def paint(paint: Paint, wall: Annotated[str, typer.Argument()], dry: bool = False) -> None:
        """Paint a wall."""
        seen.append((paint, wall, dry))

    return app


@pytest.mark.parametrize(
    ("words", "paint", "dry"),
    [
        ("north", Paint(), False),
        ("north --coats 3", Paint(coats=3), False),
        ("--colour red north --dry --coats 1", Paint("red", 1), True),
    ],
)
def test_fields_are_options(words: str, paint: Paint, dry: bool) -> None:
    """The command gets the dataclass made of the options, defaults where they are left out."""
    seen: list[tuple[Paint, str, bool]] = []
    assert CliRunner().invoke(painter(seen), words.split()).exit_code == 0
    assert seen == [(paint, "north", dry)]


def test_fields_are_checked_and_explained() -> None:
    """Bounds of a field hold, and the help shows the options and what the command does."""
    assert CliRunner().invoke(painter([]), ["north", "--coats", "0"]).exit_code == 2
    shown = CliRunner().invoke(painter([]), ["--help"], env={"NO_COLOR": "1", "TERM": "dumb"}).stdout
    assert all(text in shown for text in ("Paint a wall.", "--colour", "How often.", "white"))
