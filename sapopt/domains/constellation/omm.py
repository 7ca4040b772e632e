"""Satellites of orbit mean-elements messages (OMM, CCSDS 502.0-B-3), in whatever form they are written."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypeVar

from sapopt.data.textfile import plain_number
from sapopt.domains.constellation.catalogue import catalogue_number
from sapopt.domains.constellation.epochs import utc_days
from sapopt.domains.constellation.omm_forms import Record, records_of

if TYPE_CHECKING:
    from sgp4.api import Satrec

T = TypeVar("T")

_ZERO_IF_MISSING = ("MEAN_MOTION_DOT", "MEAN_MOTION_DDOT")
"""SGP4 does not use them, and the standard lets them be left out."""

_LARGEST_SATREC_NUMBER = 339_999
"""The largest number that `sgp4` takes; it plays no part in the propagation."""


def omm_records(text: str, kind: str, source: str) -> Iterator[tuple[str, int, Satrec]]:
    """Names, catalogue numbers and satellites of an OMM file.

    Parameters
    ----------
    text : str
    kind : {"csv", "json", "xml", "kvn"}
    source : str
        What messages call the file.

    Yields
    ------
    name : str
        Empty if there is none.
    number : int
        Catalogue number; 0 if the message has none.
    satellite : sgp4.api.Satrec
        Its own number is 0 where the catalogue's is above 339 999.

    Raises
    ------
    ValueError
        If the file is not well-formed, or at the first record with a missing or impossible field; the message names
        the line and the record (from 1).
    """
    for record in records_of(text, kind, source):
        yield _satellite(record)


def _satellite(record: Record) -> tuple[str, int, Satrec]:
    from sgp4.api import WGS72, Satrec

    _check_kind(record)
    eccentricity, motion = _number(record, "ECCENTRICITY"), _number(record, "MEAN_MOTION")
    if not motion > 0 or not 0 <= eccentricity < 1:
        name = "ECCENTRICITY" if motion > 0 else "MEAN_MOTION"
        raise ValueError(
            f"{record.where(name)}: MEAN_MOTION must be positive and ECCENTRICITY at least 0 and below 1, got "
            f"{motion:g} and {eccentricity:g}"
        )
    days, part = _parsed(record, "EPOCH", utc_days)
    number = _parsed(record, "NORAD_CAT_ID", catalogue_number) if "NORAD_CAT_ID" in record.fields else 0
    inclination = _number(record, "INCLINATION")
    if not 0 <= inclination <= 180:
        raise ValueError(
            f"{record.where('INCLINATION')}: INCLINATION must lie in 0..180 degrees, got {inclination:g}"
        )
    per_minute = motion * math.tau / 1440.0
    satellite = Satrec()
    satellite.classification = record.fields.get("CLASSIFICATION_TYPE", "U")[:1]
    satellite.intldesg = record.fields.get("OBJECT_ID", "")[2:].replace("-", "")[:8]
    for name, attribute in (("ELEMENT_SET_NO", "elnum"), ("REV_AT_EPOCH", "revnum")):
        # They tell versions of a set apart and do nothing else: what does not fit stays 0.
        if re.fullmatch(r"\d{1,9}", record.fields.get(name, ""), flags=re.ASCII):
            setattr(satellite, attribute, int(record.fields[name]))
    satellite.sgp4init(
        WGS72, "i", number if number <= _LARGEST_SATREC_NUMBER else 0, days + part, _number(record, "BSTAR"),
        _number(record, "MEAN_MOTION_DOT") * math.tau / 1440.0**2,
        _number(record, "MEAN_MOTION_DDOT") * math.tau / 1440.0**3, eccentricity,
        math.radians(_number(record, "ARG_OF_PERICENTER")), math.radians(inclination),
        math.radians(_number(record, "MEAN_ANOMALY")), per_minute, math.radians(_number(record, "RA_OF_ASC_NODE")),
    )  # fmt: skip
    # sgp4init takes one float, in which a day's part has 11 digits; the exact parts are known here.
    satellite.jdsatepoch, satellite.jdsatepochF = 2433281.5 + days, part
    return record.fields.get("OBJECT_NAME", record.fields.get("OBJECT_ID", "")), number, satellite


def _check_kind(record: Record) -> None:
    """Refuse elements that SGP4 would take for something else without a word."""
    theory = record.fields.get("MEAN_ELEMENT_THEORY", "SGP4").upper()
    if "SGP" not in theory or "XP" in theory or record.fields.get("EPHEMERIS_TYPE") == "4":
        name = "EPHEMERIS_TYPE" if "SGP" in theory and "XP" not in theory else "MEAN_ELEMENT_THEORY"
        raise ValueError(
            f"{record.where(name)}: {name} is {record.fields[name]}; only elements of SGP4 can be propagated here"
        )
    for name, wanted in (("TIME_SYSTEM", "UTC"), ("CENTER_NAME", "EARTH")):
        if record.fields.get(name, wanted).upper() != wanted:
            raise ValueError(f"{record.where(name)}: {name} must be {wanted}, got {record.fields[name]}")


def _parsed(record: Record, name: str, read: Callable[[str], T]) -> T:
    if name not in record.fields:
        raise ValueError(f"{record.where()}: {name} is missing")
    try:
        return read(record.fields[name])
    except ValueError as error:
        raise ValueError(f"{record.where(name)}: {name} cannot be read ({error})") from None


def _number(record: Record, name: str) -> float:
    if name in _ZERO_IF_MISSING and name not in record.fields:
        return 0.0
    return _parsed(record, name, _read_number)


def _read_number(text: str) -> float:
    # KVN may have units in brackets, and Fortran writes D for the exponent.
    return plain_number(re.sub(r"\s*\[[^\]]*\]$", "", text).replace("D", "E").replace("d", "e"))
