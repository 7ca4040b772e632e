"""Rows of a table file, whatever its form: CSV, gzipped CSV or Parquet, told by the content and not by the suffix."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, cast

from sapopt.data.textfile import csv_rows


class MissingReaderError(ImportError):
    """An optional package is not installed; the message names the extra that brings it."""


def table_rows(path: Path) -> Iterator[Sequence[Any]]:
    """Header and rows.

    Raises
    ------
    FileNotFoundError
    ValueError
        If the file is damaged, cut, or no table; the message names it and, for CSV, the line.
    MissingReaderError
        If it is a Parquet file and pyarrow is not installed.
    """
    start = b""
    if path.is_file():
        with path.open("rb") as file:
            start = file.read(4)
    if start == b"PAR1" or path.suffix.lower() == ".parquet":
        return _parquet(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if start[:2] == b"PK":
        raise ValueError(f"{path}: a zip archive; unpack it first")
    return _csv(path, packed=start[:2] == b"\x1f\x8b")


def _csv(path: Path, packed: bool) -> Iterator[Sequence[Any]]:
    with path.open("rb") as raw:
        encoding = "utf-16" if _begin(path, packed) in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
        file = cast(BinaryIO, gzip.GzipFile(fileobj=raw)) if packed else raw
        # Names of companies may be in any encoding; the numbers and times are ASCII.
        text = io.TextIOWrapper(file, encoding=encoding, errors="replace", newline="")
        for _, row in csv_rows(text, str(path)):
            yield row


def _begin(path: Path, packed: bool) -> bytes:
    """The first two bytes of the text; none where an archive is damaged, which csv_rows tells with the line."""
    try:
        with gzip.open(path) if packed else path.open("rb") as file:
            return file.read(2)
    except (OSError, EOFError, zlib.error):
        return b""


def _parquet(path: Path) -> Iterator[Sequence[Any]]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as parquet
    except ImportError:
        raise MissingReaderError(
            "Parquet files need pyarrow: pip install 'sapopt[tables]' (CSV needs nothing)"
        ) from None
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        with parquet.ParquetFile(path) as table:
            yield table.schema_arrow.names
            for batch in table.iter_batches():
                yield from zip(*(_values(column, pa) for column in batch.columns), strict=True)
    except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        raise ValueError(f"{path}: damaged or no Parquet file ({str(error).splitlines()[0]})") from None


def _values(column: Any, pa: Any) -> list[Any]:
    if pa.types.is_timestamp(column.type) and column.type.unit == "ns":
        # Nanoseconds have no datetime; the microseconds are kept.
        column = column.cast(pa.timestamp("us", tz=column.type.tz), safe=False)
    if pa.types.is_dictionary(column.type):
        column = column.dictionary_decode()
    return list(column.to_pylist())
