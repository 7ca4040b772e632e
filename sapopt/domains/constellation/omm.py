"""Orbit mean-elements messages (OMM) as CSV, JSON or XML."""

from __future__ import annotations

import csv
import io
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sgp4.api import Satrec

_DEFAULTS = {"CLASSIFICATION_TYPE": "U", "EPHEMERIS_TYPE": "0", "ELEMENT_SET_NO": "0", "REV_AT_EPOCH": "0"}
"""Fields that some publishers leave out and that do not matter to the propagation."""


def omm_records(text: str, kind: str, source: str) -> Iterator[tuple[str, Satrec]]:
    """Names and satellites of an OMM file.

    Parameters
    ----------
    text : str
    kind : {"csv", "json", "xml"}
    source : str
        What messages call the file.

    Raises
    ------
    ValueError
        If the file is not well-formed, or at the first record with a missing or impossible field; the message names
        the line (CSV) or the record (from 1).
    """
    from sgp4 import omm
    from sgp4.api import Satrec

    reader = {"csv": _csv_records, "json": _json_records, "xml": _xml_records}[kind]
    for where, fields in reader(text, source):
        fields = {**_DEFAULTS, **{key: value for key, value in fields.items() if value not in (None, "")}}
        # Publishers write the epoch with and without fractions of a second and time zone.
        epoch = str(fields.get("EPOCH", "")).removesuffix("Z")
        fields["EPOCH"] = epoch if "." in epoch or not epoch else epoch + ".0"
        if not fields["EPOCH"]:
            raise ValueError(f"{where}: EPOCH is missing")
        satellite = Satrec()
        try:
            omm.initialize(satellite, fields)
        except KeyError as error:
            raise ValueError(f"{where}: {error.args[0]} is missing") from None
        except (ValueError, TypeError, AttributeError) as error:
            raise ValueError(f"{where}: a field cannot be read ({error})") from None
        if not (math.isfinite(satellite.no_kozai) and satellite.no_kozai > 0 and 0 <= satellite.ecco < 1):
            raise ValueError(f"{where}: MEAN_MOTION must be positive and ECCENTRICITY at least 0 and below 1")
        yield str(fields.get("OBJECT_NAME", "")), satellite


def _csv_records(text: str, source: str) -> Iterator[tuple[str, dict[str, Any]]]:
    reader = csv.DictReader(io.StringIO(text))
    for fields in reader:
        where = f"{source}, line {reader.line_num}"
        if None in fields or None in fields.values():
            raise ValueError(
                f"{where}: the number of fields differs from the header's {len(reader.fieldnames or ())}"
            )
        yield where, fields


def _json_records(text: str, source: str) -> Iterator[tuple[str, dict[str, Any]]]:
    try:
        records = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{source}, line {error.lineno}: not valid JSON ({error.msg})") from None
    if isinstance(records, dict):
        records = [records]
    if not isinstance(records, list) or not all(isinstance(record, dict) for record in records):
        raise ValueError(f"{source}: expected a JSON list of objects, one per satellite")
    for number, fields in enumerate(records, start=1):
        yield f"{source}, record {number}", fields


def _xml_records(text: str, source: str) -> Iterator[tuple[str, dict[str, Any]]]:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"{source}, line {error.position[0]}: not well-formed XML ({error})") from None
    for number, segment in enumerate(root.iter("segment"), start=1):
        fields = {element.tag: element.text for element in segment.iter() if len(element) == 0}
        yield f"{source}, record {number}", fields
