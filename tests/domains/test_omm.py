"""Orbit messages in all their forms: the same elements whatever the writing, and one clear line for what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt.domains.constellation import ElementSets, element_positions_km, read_elements

FIELDS = {
    "OBJECT_NAME": "BEACON 7 [+]",
    "OBJECT_ID": "2020-003C",
    "CENTER_NAME": "EARTH",
    "REF_FRAME": "TEME",
    "TIME_SYSTEM": "UTC",
    "MEAN_ELEMENT_THEORY": "SGP/SGP4",
    "EPOCH": "2020-064T10:34:41.4264",
    "MEAN_MOTION": "15.27990594",
    "ECCENTRICITY": ".0013363",
    "INCLINATION": "97.2970",
    "RA_OF_ASC_NODE": "66.7438",
    "ARG_OF_PERICENTER": "109.4976",
    "MEAN_ANOMALY": "15.7307",
    "NORAD_CAT_ID": "799500123",
    "BSTAR": ".83483E-4",
}
"""One message of the current standard: optional fields left out, day of the year, a number of nine digits."""

META = list(FIELDS)[:6]
HEAD = {"CREATION_DATE": "2020-065T16:00:00", "ORIGINATOR": "SOMEBODY"}


def kvn(*messages: dict[str, str], gap: str = " = ", units: bool = False) -> str:
    """Keyword = value, with comments."""
    lines = []
    for fields in messages:
        lines += [f"CCSDS_OMM_VERS{gap}3.0", "COMMENT made for a test", ""]
        unit = {"MEAN_MOTION": " [rev/day]", "INCLINATION": " [deg]"} if units else {}
        lines += [f"{k}{gap}{v}{unit.get(k, '')}" for k, v in (HEAD | fields).items()]
    return "\n".join(lines) + "\n"


def omm_xml(fields: dict[str, str]) -> str:
    """One <omm> of the schema of the standard."""

    def tags(names: list[str]) -> str:
        return "\n".join(f"<{k}>{fields[k]}</{k}>" for k in names)

    rest = [k for k in fields if k not in META]
    head = "".join(f"<{k}>{v}</{k}>" for k, v in HEAD.items())
    return (
        f'<omm id="CCSDS_OMM_VERS" version="3.0"><header><COMMENT> a test </COMMENT>{head}</header>\n<body><segment>'
        f"<metadata>{tags([k for k in META if k in fields])}</metadata>\n"
        f"<data><meanElements>{tags(rest[:7])}</meanElements>"
        f"<tleParameters>{tags(rest[7:])}</tleParameters></data></segment></body></omm>"
    )


def bare(fields: dict[str, str]) -> str:
    """A bare OMM, the schema that the standard prints."""
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{omm_xml(fields)}'


def combined(*messages: dict[str, str]) -> str:
    """Several OMM in one NDM, in a namespace, beside a message of another kind."""
    inner = "".join(omm_xml(fields) for fields in messages).replace("<", "<n:").replace("<n:/", "</n:")
    other = "<n:opm><n:body><n:segment><n:EPOCH>x</n:EPOCH></n:segment></n:body></n:opm>"
    return f'<?xml version="1.0"?>\n<n:ndm xmlns:n="urn:ccsds:schema:ndmxml">{inner}{other}</n:ndm>'


def nested(*messages: dict[str, str]) -> str:
    """JSON that nests as the XML does."""
    omm = [
        {"header": HEAD, "body": {"segment": {
            "metadata": {k: v for k, v in fields.items() if k in META},
            "data": {"meanElements": {k: v for k, v in fields.items() if k not in META}},
        }}}
        for fields in messages
    ]  # fmt: skip
    return json.dumps({"ndm": {"omm": omm}}, indent=1)


def table(*messages: dict[str, str]) -> str:
    """CSV."""
    return "\n".join([",".join(messages[0]), *(",".join(fields.values()) for fields in messages)]) + "\n"


FORMS = {
    "kvn": kvn, "kvn with units": lambda *f: kvn(*f, units=True), "kvn without blanks": lambda *f: kvn(*f, gap="="),
    "bare xml": bare, "combined xml": combined, "json": lambda *f: json.dumps(f, indent=1), "nested json": nested,
    "csv": table,
}  # fmt: skip


def read(tmp_path: Path, text: str, name: str = "sets.txt") -> ElementSets:
    """Write and read; the suffix says nothing."""
    path = tmp_path / name
    path.write_bytes(text.encode())
    return read_elements(path)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["sets", "sets.tle", "sets.json", "sets.csv"])
def test_every_form_under_every_name(form: str, name: str, tmp_path: Path) -> None:
    """The content is recognised, not the suffix; the elements are those that were written."""
    sets = read(tmp_path, FORMS[form](FIELDS), name)
    assert (sets.names, sets.numbers) == (("BEACON 7 [+]",), (799500123,))
    satellite = sets.satellites[0]
    assert satellite.satnum == 0  # a Satrec has no room for the number
    assert satellite.ecco == 0.0013363
    assert np.degrees(satellite.inclo) == pytest.approx(97.297, abs=1e-12)
    assert satellite.no_kozai * 1440 / (2 * np.pi) == pytest.approx(15.27990594, abs=1e-12)
    assert satellite.bstar == 0.83483e-4
    assert (sets.latest_epoch.isoformat()) == "2020-03-04T10:34:41.426400+00:00"
    positions, _ = element_positions_km(sets, 2, 60.0)
    assert 6800 < np.linalg.norm(positions[0, 0]) < 7000


@pytest.mark.parametrize("form", [form for form in FORMS if form != "bare xml"])
def test_several_messages(form: str, tmp_path: Path) -> None:
    """Several satellites in one file, in their order, however they are marked off."""
    second = FIELDS | {"OBJECT_NAME": "BEACON 8", "NORAD_CAT_ID": "T0001", "EPOCH": "2020-03-04T10:34:41Z"}
    sets = read(tmp_path, FORMS[form](FIELDS, second))
    assert sets.names == ("BEACON 7 [+]", "BEACON 8")
    assert sets.numbers == (799500123, 270001)
    assert sets.take([1]).numbers == (270001,)


def test_messages_without_a_number_are_told_apart_by_name(tmp_path: Path) -> None:
    """The standard lets the catalogue number be left out."""
    without = {k: v for k, v in FIELDS.items() if k != "NORAD_CAT_ID"}
    sets = read(tmp_path, kvn(without, without | {"OBJECT_NAME": "OTHER"}))
    assert (sets.names, sets.numbers) == (("BEACON 7 [+]", "OTHER"), (0, 0))


def test_marks_and_line_ends(tmp_path: Path) -> None:
    """Byte order marks, UTF-16 and the line ends of Windows are read."""
    for text in (kvn(FIELDS), table(FIELDS), bare(FIELDS), json.dumps([FIELDS])):
        for encoded in (
            ("\ufeff" + text).encode(), text.replace("\n", "\r\n").encode(), text.encode("utf-16"),
        ):  # fmt: skip
            path = tmp_path / "marked"
            path.write_bytes(encoded)
            assert read_elements(path).numbers == (799500123,)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("EPOCH", "2021-366T00:00:00", "2021 has no day 366"),
        ("EPOCH", "noon", "no time of the form"),
        ("INCLINATION", "nan", "INCLINATION cannot be read .'nan.*' is no number"),
        ("INCLINATION", "1e999", "too large"),
        ("INCLINATION", "181", "must lie in 0..180"),
        ("RA_OF_ASC_NODE", "1_0", "is no number"),
        ("NORAD_CAT_ID", "I0001", "no letter I"),
        ("NORAD_CAT_ID", "12.5", "neither a whole number"),
        ("MEAN_ELEMENT_THEORY", "DSST", "MEAN_ELEMENT_THEORY is DSST; only elements of SGP4"),
        ("MEAN_ELEMENT_THEORY", "SGP4-XP", "only elements of SGP4"),
        ("TIME_SYSTEM", "TAI", "TIME_SYSTEM must be UTC, got TAI"),
        ("CENTER_NAME", "MARS", "CENTER_NAME must be EARTH"),
        ("MEAN_MOTION", "0", "MEAN_MOTION must be positive"),
        ("ECCENTRICITY", "1.0", "ECCENTRICITY at least 0 and below 1"),
        ("BSTAR", "", "BSTAR is missing"),
    ],
)
def test_one_line_names_path_and_line(form: str, field: str, value: str, reason: str, tmp_path: Path) -> None:
    """Each fault is one ValueError with the file, the line and what is wrong."""
    text = FORMS[form](FIELDS | {field: value})
    with pytest.raises(ValueError, match=rf"sets\.txt, line \d+.*: .*{reason}") as caught:
        read(tmp_path, text)
    if value and "json" not in form:  # JSON tells the line where the record begins
        line = int(str(caught.value).split("line ")[1].split(",")[0].split(":")[0])
        assert value in text.split("\n")[line - 1]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (kvn(FIELDS) + "MEAN_MOTION = 1\n", "line 21: MEAN_MOTION is given twice .* line 13"),
        (kvn(FIELDS) + "and so on\n", "line 21: expected KEYWORD = value, found 'and so on'"),
        ("CCSDS_OEM_VERS = 2.0\nOBJECT_NAME = X\n", "line 1: OEM is another kind of message"),
        (bare(FIELDS)[:-10], "line 16: not well-formed XML"),
        ('<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><omm>&b;</omm>', "line 1: a document type declaration"),
        ("<html></html>", "no element set"),
        ("[" * 100_000, "line 1: not valid JSON .nested too deeply"),
        ('[{"a": ' + '{"a":' * 600 + "1" + "}" * 601 + "]", "ECCENTRICITY is missing|nested too deeply"),
        (json.dumps([FIELDS]) + "x", "something follows"),
        (json.dumps([FIELDS])[:-1], "line 1: not valid JSON"),
        ('{"EPOCH": true}', "EPOCH cannot be true"),
        ("EPOCH,BSTAR\n\"1,2\n", "line 2: a quote is opened here and never closed"),
        ("EPOCH,BSTAR\n" + "9" * 200_000 + ",2\n", "line 2: a field of more than"),
        ("EPOCH,BSTAR\n1,\0\n", "line 2: a NUL byte"),
    ],
)  # fmt: skip
def test_malformed(text: str, reason: str, tmp_path: Path) -> None:
    """What is not well-formed is told by line."""
    with pytest.raises(ValueError, match=rf"sets\.txt.*{reason}"):
        read(tmp_path, text)


@settings(max_examples=300, deadline=None)
@given(data=st.data(), form=st.sampled_from(sorted(FORMS)))
def test_damage_is_never_a_foreign_error(
    data: st.DataObject, form: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A file with a piece cut out, doubled or changed is read, or refused with its name: nothing else."""
    text = FORMS[form](FIELDS).encode()
    first = data.draw(st.integers(0, len(text) - 1))
    last = data.draw(st.integers(first, min(len(text), first + 40)))
    piece = data.draw(st.one_of(st.just(b""), st.binary(max_size=6), st.just(text[first:last] * 2)))
    path = tmp_path_factory.mktemp("omm") / "damaged"
    path.write_bytes(text[:first] + piece + text[last:])
    try:
        read_elements(path)
    except ValueError as error:
        assert "damaged" in str(error)  # noqa: PT017
