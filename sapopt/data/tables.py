"""Tables of other libraries: columns by name, whatever holds them.

A table is a data frame of pandas or polars, a table of pyarrow, a mapping from names to sequences, a structured array
of numpy, or the path of a CSV or Parquet file. None of these libraries is imported here but for Parquet files.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sapopt.data.extras import needed
from sapopt.data.textfile import csv_rows, lines_of, plain_number, read_text
from sapopt.data.times import instant
from sapopt.data.types import FloatArray, IntArray


@runtime_checkable
class _ByColumn(Protocol):
    """A table of pyarrow."""

    @property
    def column_names(self) -> Sequence[str]:
        """Names."""

    def column(self, name: str) -> Any:
        """A column."""


@runtime_checkable
class _Frame(Protocol):
    """A data frame of pandas or polars."""

    @property
    def columns(self) -> Any:
        """Names."""

    def __getitem__(self, name: Any) -> Any: ...


@runtime_checkable
class _Indexed(Protocol):
    """A data frame of pandas, whose rows have names as well."""

    def reset_index(self) -> Any:
        """The same frame with the names of the rows as columns."""

    def copy(self) -> Any:
        """The same frame again."""


@runtime_checkable
class _Dictionary(Protocol):
    """A column of pyarrow in chunks."""

    def combine_chunks(self) -> Any:
        """The same column in one piece."""


@runtime_checkable
class _Factorizes(Protocol):
    """A column of pandas."""

    def factorize(self) -> tuple[Any, Any]:
        """Codes, and the values they stand for."""


@runtime_checkable
class _Listed(Protocol):
    """A column that can tell its values as Python's own."""

    def to_list(self) -> list[Any]:
        """The values."""


class Table:
    """The columns of a table of any library.

    Parameters
    ----------
    table : object
        See the module.

    Raises
    ------
    ValueError
        If it is no table, or a file that cannot be read as one.
    FileNotFoundError
    """

    def __init__(self, table: Any) -> None:
        if isinstance(table, (str, Path)):
            table = _read(Path(table))
        if isinstance(table, np.ndarray) and table.dtype.names:
            table = {name: table[name] for name in table.dtype.names}
        self._columns: Mapping[Any, Any] | _ByColumn | _Frame
        if isinstance(table, Mapping):
            self._columns, self.names = table, list(table)
        elif isinstance(table, _ByColumn):
            self._columns, self.names = table, list(table.column_names)
        elif isinstance(table, _Frame):
            self._columns, self.names = table, list(table.columns)
        else:
            raise ValueError(
                f"table must have columns (a data frame, a mapping of names to lists, or the path of a CSV or Parquet "
                f"file), got {type(table).__name__}"
            )

    def with_index(self) -> Table:
        """The same table; for pandas, with the names of its rows as columns."""
        # of a copy: pandas warns of frames whose columns lie apart, and a copy puts them together
        return Table(self._columns.copy().reset_index()) if isinstance(self._columns, _Indexed) else self

    def column(self, name: Any) -> Any:
        """A column as its library holds it.

        Raises
        ------
        ValueError
            If there is none of that name.
        """
        if name not in self.names:
            near = difflib.get_close_matches(str(name), [str(known) for known in self.names], n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(map(repr, self.names[:12]))}"
            raise ValueError(f"table: there is no column {name!r}; {hint}")
        if isinstance(self._columns, _ByColumn):
            return self._columns.column(name)
        return self._columns[name]

    def coded(self, name: Any) -> tuple[IntArray, list[Any]]:
        """A column as numbers of its distinct values, which stand in order of appearance; -1 is a missing value."""
        column = self.column(name)
        if isinstance(column, _Factorizes):
            codes, values = column.factorize()
            return np.asarray(codes, dtype=np.int64), list(values)
        if isinstance(column, _Dictionary):
            packed = column.combine_chunks().dictionary_encode()
            codes = packed.indices.fill_null(-1).to_numpy(zero_copy_only=False)
            return np.asarray(codes, dtype=np.int64), packed.dictionary.to_pylist()
        known: dict[Any, int] = {}
        distinct: list[Any] = []
        codes = np.empty(len(column), dtype=np.int64)
        for row, value in enumerate(_values(column)):
            try:
                if missing(value):
                    codes[row] = -1
                    continue
                codes[row] = known.setdefault(instant(value), len(known))
                if len(known) > len(distinct):
                    distinct.append(value)
            except TypeError:
                raise ValueError(
                    f"{name}: row {row} (counted from 0) holds {value!r}, no single value"
                ) from None
        return codes, distinct

    def values(self, name: Any) -> list[Any]:
        """A column as Python's values, None where one is missing."""
        codes, known = self.coded(name)
        return [None if code < 0 else known[code] for code in codes.tolist()]

    def numbers(self, name: Any) -> FloatArray:
        """A column of numbers; NaN where one is missing.

        Raises
        ------
        ValueError
            If a value is no number; the message names its row.
        """
        column = self.column(name)
        raw = column if isinstance(column, (list, tuple)) else np.asarray(column)
        try:
            array = np.asarray(raw)
            if array.dtype.kind in "biuf":
                return array.astype(np.float64)
        except (TypeError, ValueError):
            pass
        out = np.empty(len(raw))
        for row, value in enumerate(raw):
            try:
                out[row] = np.nan if missing(value) or value == "" else float(value)
            except (TypeError, ValueError):
                raise ValueError(f"{name}: row {row} (counted from 0) holds {value!r}, no number") from None
        return out


def missing(value: Any) -> bool:
    """Whether a value stands for none: None, NaN, NaT or pandas' NA."""
    try:
        return value is None or bool(value != value)
    except (TypeError, ValueError):  # the truth of NA is not known
        return True


def _values(column: Any) -> Any:
    return column.to_list() if isinstance(column, _Listed) else column


def _read(path: Path) -> Any:
    kind = path.suffix.lower()
    if kind == ".parquet":
        return needed("pyarrow.parquet", "tables", "reading Parquet files").read_table(path)
    if kind != ".csv":
        raise ValueError(f"{path}: only .csv and .parquet files are read as tables; read others with pandas")
    rows = csv_rows(iter(f"{line}\n" for line in lines_of(read_text(path))), str(path))
    _, names = next(rows, (0, []))
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: two columns have one name")
    columns: dict[str, list[Any]] = {name.strip(): [] for name in names}
    for line, row in rows:
        if len(row) != len(names):
            raise ValueError(f"{path}, line {line}: {len(row)} fields, the first line has {len(names)}")
        for name, field in zip(columns, row, strict=True):
            columns[name].append(field.strip() or None)
    return {name: _typed(values) for name, values in columns.items()}


def _typed(values: list[str | None]) -> list[Any]:
    """Numbers, if all that is there are numbers; whole ones as integers."""
    try:
        numbers = [None if value is None else _number(value) for value in values]
    except ValueError:
        return values
    return numbers


def _number(text: str) -> int | float:
    if text.lower() in ("-inf", "-infinity", "inf", "infinity", "nan"):
        return float(text)
    number = plain_number(text)
    digits = text.lstrip("+-")
    if digits.isdigit():
        if len(digits) > 1 and digits.startswith("0"):
            raise ValueError("a label such as 007")
        return int(text)
    return number
