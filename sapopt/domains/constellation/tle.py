"""Two-line element sets, checked line by line."""

from __future__ import annotations

import calendar
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from sapopt.data.textfile import lines_of
from sapopt.domains.constellation.catalogue import catalogue_number

if TYPE_CHECKING:
    from sgp4.api import Satrec

_LENGTH = 69

_SCALED = r"[ +-] *\d+[+-]\d"
_FIELDS = {
    "1": (
        ("catalogue number", 2, 7, r" *\d+|[A-Z]\d{4}"),
        ("classification", 7, 8, r"[A-Z ]"),
        ("epoch", 18, 32, r"\d\d *\d+\.\d+"),
        ("first derivative of the mean motion", 33, 43, r" *[ +-]?\d?\.\d+"),
        ("second derivative of the mean motion", 44, 52, _SCALED),
        ("drag term", 53, 61, _SCALED),
        ("ephemeris type", 62, 63, r"[\d ]"),
        ("element set number", 64, 68, r" *\d+"),
    ),
    "2": (
        ("catalogue number", 2, 7, r" *\d+|[A-Z]\d{4}"),
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


_TIMES = r"\s+[-+.\d]+\s+[-+.\d]+\s+[-+.\d]+\s*"
"""What the verification file of SGP4 appends to second lines: first, last and step of the times to compare, minutes."""


def tle_records(text: str, source: str) -> Iterator[tuple[str, int, Satrec]]:
    """Names, catalogue numbers and satellites of a TLE file, with or without name lines.

    Parameters
    ----------
    text : str
        Lines that begin with ``#`` are comments, and three numbers after a second line are passed over, as in the
        verification file of Vallado et al. 2006.
    source : str
        What messages call the file.

    Raises
    ------
    ValueError
        At the first damaged line; the message names its number (from 1) and what is wrong.
    """
    from sgp4.api import Satrec

    lines = [
        (number, line.rstrip())
        for number, line in enumerate(lines_of(text), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    at = 0
    while at < len(lines):
        name = ""
        number, line = lines[at]
        if not _begins(line, "1"):
            if _begins(line, "2"):
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
            if not _begins(line, "1"):
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
        if re.fullmatch(_TIMES, second[_LENGTH:], flags=re.ASCII):
            second = second[:_LENGTH]
        if not _begins(second, "2"):
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
        yield name, catalogue_number(line[2:7]), satellite


def _begins(line: str, which: str) -> bool:
    """Whether this is line 1 or 2 of a set, and not a name (24 characters at most) that begins with a digit."""
    return line.startswith(which + " ") and len(line) > 24


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
    try:
        catalogue_number(line[2:7])
    except ValueError as error:
        raise ValueError(f"{where}: catalogue number (columns 3 to 7): {error}") from None
    if line[0] == "1":
        _check_epoch(line, where)
    for column in _BLANKS[line[0]]:
        if line[column] != " ":
            raise ValueError(f"{where}: column {column + 1} must be blank, found {line[column]!r}")


def _check_epoch(line: str, where: str) -> None:
    """The day of the year must be one, and the elements those of SGP4."""
    short = int(line[18:20])
    year, day = short + (1900 if short >= 57 else 2000), float(line[20:32])
    days = 365 + calendar.isleap(year)
    if not 1.0 <= day < days + 1.0:
        raise ValueError(
            f"{where}: epoch (columns 19 to 32): {year} has no day {line[20:32].strip()}, only 1 to {days}"
        )
    if line[62] == "4":
        raise ValueError(f"{where}: ephemeris type 4 (SGP4-XP); only elements of SGP4 can be propagated here")


def _shown(line: str) -> str:
    return repr(line if len(line) <= 30 else line[:27] + "...")
