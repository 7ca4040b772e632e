"""Plans in files that other programs read: CSV, Excel, Parquet and JSON, and data frames of pandas."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from sapopt.data.extras import needed
from sapopt.data.files import replacing, write_text
from sapopt.data.times import as_text
from sapopt.exchange.forms import Form, columns, owner
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP

_MOST_ROWS, _MOST_COLUMNS = 2**20, 2**14
"""Of a sheet of Excel."""


def to_pandas(result: Result, form: Form = "stays", problem: SAP | None = None) -> Any:
    """A plan as a data frame of pandas; see `Result.to_pandas`."""
    pandas = needed("pandas", "tables", "to_pandas")
    table = pandas.DataFrame(columns(owner(result, problem), result, form))
    return table.set_index("step") if form == "wide" else table


def write_csv(result: Result, path: str | Path, form: Form = "stays", problem: SAP | None = None) -> None:
    """Write a plan as CSV in UTF-8 with a header; times in ISO 8601, nothing held is an empty field."""
    table = columns(owner(result, problem), result, form)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows([_field(value) for value in row] for row in zip(*table.values(), strict=True))
    write_text(path, text.getvalue())


def _field(value: Any) -> Any:
    return repr(value) if isinstance(value, float) else "" if value is None else as_text(value)


def write_parquet(result: Result, path: str | Path, form: Form = "stays", problem: SAP | None = None) -> None:
    """Write a plan as Parquet; times keep their zone."""
    arrow = needed("pyarrow", "tables", "writing Parquet files")
    parquet = needed("pyarrow.parquet", "tables", "writing Parquet files")
    table = columns(owner(result, problem), result, form)
    packed = arrow.table({str(name): _one_zone(values) for name, values in table.items()})
    with replacing(path) as file:
        parquet.write_table(packed, file)


def _one_zone(values: list[Any]) -> list[Any]:
    """Times of several zones in UTC: a column has one."""
    zones = {str(value.tzinfo) for value in values if isinstance(value, datetime)}
    if len(zones) < 2:
        return values
    return [value.astimezone(UTC) if isinstance(value, datetime) else value for value in values]


def write_excel(result: Result, path: str | Path, form: Form = "stays", problem: SAP | None = None) -> None:
    """Write a plan as one sheet of Excel.

    Excel knows no time zones: times stand there by the clock on the wall, and the head of the column names the zone.

    Raises
    ------
    ValueError
        If the plan has more rows or columns than a sheet, or a name holds a character that no cell can hold.
    ImportError
        If openpyxl is not installed.
    """
    openpyxl = needed("openpyxl", "tables", "writing Excel files")
    known = owner(result, problem)
    table = columns(known, result, form)
    rows = list(zip(*table.values(), strict=True))
    if len(rows) >= _MOST_ROWS or len(table) > _MOST_COLUMNS:
        raise ValueError(
            f"{path}: {len(rows):,} rows of {len(table):,} columns are more than a sheet of Excel holds; "
            "write Parquet, or another form"
        )
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = form
    sheet.freeze_panes = "A2"
    heads = [f"{name}{_zone(values)}" for name, values in table.items()]
    for place, head in enumerate(heads, start=1):
        sheet.column_dimensions[openpyxl.utils.get_column_letter(place)].width = max(
            12, min(len(head) + 4, 40)
        )
    try:
        for number, row in enumerate([heads, *rows], start=1):
            for place, value in enumerate(row, start=1):
                cell = sheet.cell(number, place, _wall(value))
                if isinstance(value, str):
                    cell.data_type = "s"  # a name that begins with = is no formula
    except openpyxl.utils.exceptions.IllegalCharacterError:
        raise ValueError(f"{path}: a name holds a character that no cell of Excel can hold") from None
    with replacing(path) as file:
        book.save(file)


def _zone(values: list[Any]) -> str:
    zone = next((value.tzinfo for value in values if isinstance(value, datetime)), None)
    if zone is None:
        return ""
    return f" ({zone.key if isinstance(zone, ZoneInfo) else zone})"


def _wall(value: Any) -> Any:
    return value.replace(tzinfo=None) if isinstance(value, datetime) else value


def write_json(result: Result, path: str | Path, form: Form = "stays", problem: SAP | None = None) -> None:
    """Write a plan and its score as JSON; numbers that JSON does not have become null."""
    known = owner(result, problem)
    table = columns(known, result, form)
    score = result.evaluation
    told = {
        "format": "sapopt-plan-1",
        "solver": result.solver,
        "status": result.status.value,
        "value": result.value,
        "bound": result.bound,
        "gap": result.gap,
        "handovers": result.handovers,
        "paid_handovers": score.paid_handovers,
        "switches": score.switches,
        "limits": [
            {
                "name": use.name,
                "use": use.use,
                "at_most": use.at_most,
                "at_least": use.at_least,
                "cost": use.cost,
            }
            for use in score.limits
        ],
        "steps": known.T,
        "agents": [known.agent_label(i) for i in range(known.n)],
        "tasks": [known.task_label(j) for j in range(known.m)],
        "times": None if known.times is None else [as_text(time) for time in known.times],
        form: [dict(zip(map(str, table), row, strict=True)) for row in zip(*table.values(), strict=True)],
    }
    write_text(path, json.dumps(_strict(told), ensure_ascii=False, indent=1, allow_nan=False) + "\n")


def _strict(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _strict(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_strict(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return as_text(value) if isinstance(value, datetime) else value


WRITERS: dict[str, Callable[..., None]] = {
    ".csv": write_csv,
    ".xlsx": write_excel,
    ".parquet": write_parquet,
    ".json": write_json,
}
"""By suffix."""
