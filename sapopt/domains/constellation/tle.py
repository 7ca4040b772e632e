"""Two-line element sets, checked line by line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sgp4.api import Satrec

_LENGTH = 69

_SCALED = r"[ +-] *\d+[+-]\d"
_FIELDS = {
    "1": (
        ("catalogue number", 2, 7, r" *[A-Z]?\d+"),
        ("classification", 7, 8, r"[A-Z ]"),
        ("epoch", 18, 32, r"\d\d *\d+\.\d+"),
        ("first derivative of the mean motion", 33, 43, r" *[ +-]?\d?\.\d+"),
        ("second derivative of the mean motion", 44, 52, _SCALED),
        ("drag term", 53, 61, _SCALED),
        ("ephemeris type", 62, 63, r"[\d ]"),
        ("element set number", 64, 68, r" *\d+"),
    ),
    "2": (
        ("catalogue number", 2, 7, r" *[A-Z]?\d+"),
        ("inclination", 8, 16, r" *\d+\.\d+"),
        ("right ascension of the node", 17, 25, r" *\d+\.\d+"),
        ("eccentricity", 26, 33, r"\d+"),
        ("argument of perigee", 34, 42, r" *\d+\.\d+"),
        ("mean anomaly", 43, 51, r" *\d+\.\d+"),
        ("mean motion", 52, 63, r" *\d+\.\d+"),
        ("revolution number", 63, 68, r" *\d*"),
    ),
}
"""Columns and form of the fields of each line. The checksum does not see letters in place of a zero, and the parser of
`sgp4` reads such a field as 0 without a word."""

_BLANKS = {"1": (1, 8, 17, 32, 43, 52, 61, 63), "2": (1, 7, 16, 25, 33, 42, 51)}


def tle_records(text: str, source: str) -> Iterator[tuple[str, Satrec]]:
    """Names and satellites of a TLE file, with or without name lines.

    Parameters
    ----------
    text : str
    source : str
        What messages call the file.

    Raises
    ------
    ValueError
        At the first damaged line; the message names its number (from 1) and what is wrong.
    """
    from sgp4.api import Satrec

    lines = [
        (number, line.rstrip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()
    ]
    at = 0
    while at < len(lines):
        name = ""
        number, line = lines[at]
        if not line.startswith("1 "):
            if line.startswith("2 ") and len(line) > 24:
                raise ValueError(
                    f"{source}, line {number}: second line of an element set without its first line"
                )
            # Three-line files of Space-Track mark the name with a zero.
            name = line.removeprefix("0 ").strip()
            at += 1
            if at == len(lines):
                raise ValueError(
                    f"{source}, line {number}: the file ends after {name!r}; its element set is missing"
                )
            named_at, (number, line) = number, lines[at]
            if not line.startswith("1 "):
                raise ValueError(
                    f"{source}, line {number}: expected line 1 of the element set of {name!r} (line {named_at}), "
                    f"found {_shown(line)}"
                )
        _check_line(line, f"{source}, line {number}")
        at += 1
        if at == len(lines):
            raise ValueError(
                f"{source}, line {number}: the file ends here; line 2 of this element set is missing"
            )
        second_number, second = lines[at]
        if not second.startswith("2 "):
            raise ValueError(
                f"{source}, line {second_number}: expected line 2 of the set, found {_shown(second)}"
            )
        _check_line(second, f"{source}, line {second_number}")
        if line[2:7] != second[2:7]:
            raise ValueError(
                f"{source}, line {second_number}: catalogue number {second[2:7]} does not match "
                f"{line[2:7]} of line {number}"
            )
        at += 1
        try:
            satellite = Satrec.twoline2rv(line, second)
        except ValueError as error:
            raise ValueError(f"{source}, line {number}: not a valid element set ({error})") from None
        yield name, satellite


def _check_line(line: str, where: str) -> None:
    if len(line) != _LENGTH:
        raise ValueError(f"{where}: {len(line)} characters instead of {_LENGTH}")
    stated, counted = line[68], sum(int(c) if c in "0123456789" else c == "-" for c in line[:68]) % 10
    if stated != str(counted):
        raise ValueError(f"{where}: wrong checksum, the line says {stated!r} and its digits give {counted}")
    for name, start, stop, form in _FIELDS[line[0]]:
        if not re.fullmatch(form, line[start:stop], flags=re.ASCII):
            raise ValueError(
                f"{where}: {name} (columns {start + 1} to {stop}) cannot be {line[start:stop]!r}"
            )
    for column in _BLANKS[line[0]]:
        if line[column] != " ":
            raise ValueError(f"{where}: column {column + 1} must be blank, found {line[column]!r}")


def _shown(line: str) -> str:
    return repr(line if len(line) <= 30 else line[:27] + "...")
