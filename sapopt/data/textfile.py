"""Text files that others made: decoded by their byte order mark, tables read row by row, numbers taken strictly."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from collections.abc import Iterator
from pathlib import Path

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", flags=re.ASCII)

_MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
"""Byte order marks, and the encodings that they announce."""


def read_text(path: str | Path) -> str:
    """A whole file as text: UTF-8, with a byte order mark or none, or UTF-16 with one.

    What is not UTF-8 is read as Latin-1, which changes names at most: the numbers of all the formats here are ASCII.

    Raises
    ------
    ValueError
        If the file holds a NUL, which no text does; the message names the line.
    OSError
        If the file cannot be read.
    """
    data = Path(path).read_bytes()
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise ValueError(f"{path}, line {line}: a NUL byte; this is not a text file, or a damaged one")
    return text


def lines_of(text: str) -> list[str]:
    """The lines as an editor counts them; `str.splitlines` breaks at form feeds and other characters as well."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def plain_number(text: str) -> float:
    """A finite decimal number.

    `float` would also take nan, inf, underscores and the digits of other scripts.

    Raises
    ------
    ValueError
        If the text is none.
    """
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"{text!r} is no number")
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is too large")
    return value


def csv_rows(file: Iterator[str] | io.TextIOBase, source: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of each row of a CSV table that is not blank.

    Parameters
    ----------
    file : iterator of str
        An open file, or lines.
    source : str
        What messages call it.

    Raises
    ------
    ValueError
        At the first row that cannot be read (a quote that is never closed, a field of more than 131 072 characters, a
        NUL, a damaged or cut archive, bytes that are not UTF-8).
    """
    reader = csv.reader(file, strict=True)
    line = 0
    while True:
        line = reader.line_num + 1
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise ValueError(f"{source}, line {line}: {_csv_fault(error)}") from None
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise ValueError(f"{source}, line {line}: the archive is damaged or cut ({error})") from None
        except UnicodeError as error:
            raise ValueError(f"{source}, line {line}: not UTF-8 text ({error})") from None
        if any("\0" in field for field in row):
            raise ValueError(f"{source}, line {line}: a NUL byte; this is not a table, or a damaged one")
        if any(field.strip() for field in row):
            yield line, row


def _csv_fault(error: csv.Error) -> str:
    text = str(error)
    if "unexpected end of data" in text:
        return "a quote is opened here and never closed"
    if "field larger than field limit" in text:
        return f"a field of more than {csv.field_size_limit()} characters; is a quote left open?"
    if "NUL" in text:
        return "a NUL byte; this is not a table, or a damaged one"
    return f"not CSV ({text})"
