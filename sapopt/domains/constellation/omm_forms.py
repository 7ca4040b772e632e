"""The four ways to write orbit mean-elements messages (CCSDS 502.0-B-3, 505.0-B-2): KVN, XML, JSON and CSV.

Each reader turns text into `Record`s, one per satellite, and knows nothing of what the fields mean.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

from sapopt.data.textfile import csv_rows, lines_of

_OTHER_MESSAGES = {"opm", "oem", "ocm", "aem", "apm", "acm", "cdm", "tdm", "rdm"}
"""Messages of other kinds that a combined file (NDM) may hold beside OMM."""

_MAY_REPEAT = ("COMMENT", "USER_DEFINED")


@dataclass
class Record:
    """The fields of one message.

    Attributes
    ----------
    source : str
        What messages call the file.
    line : int
        Where the record begins, from 1.
    number : int
        Which record of the file it is, from 1; 0 where the line alone tells.
    fields : dict of str to str
        Values as they are written; empty ones are left out.
    lines : dict of str to int
        Line of each field, where the format tells.
    """

    source: str
    line: int
    number: int
    fields: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)

    def where(self, name: str = "") -> str:
        """The place of a field, or of the record, for messages."""
        line = f"{self.source}, line {self.lines.get(name, self.line)}"
        return f"{line}, record {self.number}" if self.number else line

    def add(self, name: str, value: str, line: int) -> None:
        """Set a field; raises ValueError if the record has it already with another value."""
        name, value = name.strip().upper(), value.strip()
        if not value or name.startswith(_MAY_REPEAT):
            return
        if self.fields.get(name, value) != value:
            raise ValueError(
                f"{self.source}, line {line}: {name} is given twice in one message (before in line {self.lines[name]})"
            )
        self.fields[name], self.lines[name] = value, line


def kind_of(text: str, suffix: str) -> str:
    """Which form a text has, by its content; by the suffix only where the content does not tell.

    Returns
    -------
    {"kvn", "xml", "json", "csv", "tle"}
    """
    start = text.lstrip("\ufeff \t\r\n")
    if start[:1] == "<":
        return "xml"
    if start[:1] in ("[", "{"):
        return "json"
    lines = [line.strip() for line in lines_of(start[:20_000]) if line.strip()]
    lines = [line for line in lines if not line.upper().startswith(("COMMENT", "#"))]
    if not lines:
        return "tle"
    if re.match(r"[A-Za-z_]+\s*=", lines[0]):
        return "kvn"
    columns = {name.strip(' "').upper() for name in lines[0].split(",")}
    if len(columns) > 1 and columns & {"EPOCH", "MEAN_MOTION", "NORAD_CAT_ID"}:
        return "csv"
    if any(re.match(r"[12] .{30,}", line) for line in lines):
        return "tle"
    return suffix if suffix in ("csv", "json", "xml", "kvn") else "tle"


def records_of(text: str, kind: str, source: str) -> Iterator[Record]:
    """The records of a text of a kind that is no TLE, see `kind_of`.

    Raises
    ------
    ValueError
        If the text is not well-formed; the message names the line.
    """
    return {"csv": _csv, "json": _json, "xml": _xml, "kvn": _kvn}[kind](text, source)


def _kvn(text: str, source: str) -> Iterator[Record]:
    """Keyword = value; a message begins with its version, or with a new object once elements were given."""
    record = Record(source, 1, 0)
    for line, content in enumerate(lines_of(text), start=1):
        content = content.strip()
        if not content or content.startswith("#") or re.match(r"COMMENT\b", content, flags=re.IGNORECASE):
            continue
        name, equals, value = content.partition("=")
        if not equals or not re.fullmatch(r"\w+", name.strip(), flags=re.ASCII):
            shown = content if len(content) <= 40 else content[:37] + "..."
            raise ValueError(f"{source}, line {line}: expected KEYWORD = value, found {shown!r}")
        key = name.strip().upper()
        begins = key == "CCSDS_OMM_VERS" or (key == "OBJECT_NAME" and "EPOCH" in record.fields)
        if begins and record.fields:
            yield record
            record = Record(source, line, 0)
        if re.fullmatch(r"CCSDS_[A-Z]+_VERS", key) and key != "CCSDS_OMM_VERS":
            raise ValueError(f"{source}, line {line}: {key[6:9]} is another kind of message; expected OMM")
        record.add(key, value, line)
    if record.fields.keys() - {"CCSDS_OMM_VERS"}:
        yield record


def _csv(text: str, source: str) -> Iterator[Record]:
    rows = csv_rows(io.StringIO(text, newline=""), source)
    _, header = next(rows, (1, []))
    for line, row in rows:
        if len(row) != len(header):
            raise ValueError(
                f"{source}, line {line}: the number of fields ({len(row)}) differs from the header's {len(header)}"
            )
        record = Record(source, line, 0)
        for name, value in zip(header, row, strict=True):
            record.add(name, value, line)
        yield record


def _json(text: str, source: str) -> Iterator[Record]:
    number = 0
    for at, value in list(_json_values(text, source)):  # a file cut at its end is not read halfway
        line = text.count("\n", 0, at) + 1
        try:
            messages = list(_json_messages(value, f"{source}, line {line}"))
        except RecursionError:
            raise ValueError(f"{source}, line {line}: not valid JSON (nested too deeply)") from None
        for message in messages:
            number += 1
            record = Record(source, line, number)
            for name, entry in message:
                record.add(name, entry, line)
            yield record


def _json_values(text: str, source: str) -> Iterator[tuple[int, Any]]:
    """Position and value of every element of a list, or of a single object."""
    # Numbers stay text: a catalogue number or an epoch is judged by what is written, not by what a float keeps.
    decoder = json.JSONDecoder(parse_float=str, parse_int=str, parse_constant=str)
    blank = re.compile(r"[\s\ufeff]*")

    def skip(at: int) -> int:
        found = blank.match(text, at)
        return at if found is None else found.end()

    def fault(at: int, why: str) -> ValueError:
        return ValueError(f"{source}, line {text.count(chr(10), 0, at) + 1}: not valid JSON ({why})")

    def decode(at: int) -> tuple[Any, int]:
        try:
            return decoder.raw_decode(text, at)
        except json.JSONDecodeError as error:
            raise fault(error.pos, error.msg) from None
        except RecursionError:
            raise fault(at, "nested too deeply") from None

    at = skip(0)
    listed = text[at : at + 1] == "["
    at = skip(at + 1) if listed else at
    while not (listed and text[at : at + 1] == "]"):
        value, end = decode(at)
        yield at, value
        at = skip(end)
        if not listed:
            break
        if text[at : at + 1] == ",":
            at = skip(at + 1)
        elif text[at : at + 1] != "]":
            raise fault(min(at, len(text)), "expected ',' or ']' after a record")
    at = skip(at + 1) if listed else at
    if at < len(text):
        raise fault(at, "something follows after the end")


def _json_messages(value: Any, where: str) -> Iterator[list[tuple[str, str]]]:
    """Flat messages of an object: CelesTrak and Space-Track write flat ones, others nest them as XML does."""
    if isinstance(value, list):
        for part in value:
            yield from _json_messages(part, where)
        return
    if not isinstance(value, dict):
        raise ValueError(f"{where}: expected a JSON list of objects, one per satellite")
    nested = [part for part in value.values() if _holds_objects(part)]
    if any(isinstance(part, list) for part in nested) or _wraps(value):
        for part in nested:
            yield from _json_messages(part, where)
        return
    yield list(_leaves(value, where))


def _wraps(value: dict[str, Any]) -> bool:
    """Whether an object only wraps a message (ndm, omm, ...), and has no field of one."""
    return len(value) == 1 and isinstance(next(iter(value.values())), dict)


def _holds_objects(part: Any) -> bool:
    return isinstance(part, dict) or (isinstance(part, list) and any(isinstance(x, dict) for x in part))


def _leaves(value: dict[str, Any], where: str) -> Iterator[tuple[str, str]]:
    for name, entry in value.items():
        if isinstance(entry, dict):
            yield from _leaves(entry, where)
        elif isinstance(entry, str):
            yield name, entry
        elif isinstance(entry, bool):
            raise ValueError(f"{where}: {name} cannot be {str(entry).lower()}")


def _xml(text: str, source: str) -> Iterator[Record]:
    """Leaf elements below each ``segment``, whatever the namespace; entities are not expanded."""
    parser = expat.ParserCreate(namespace_separator="}")
    parser.buffer_text = True
    stack: list[str] = []
    found: list[Record] = []
    current: list[Record] = []
    words: list[str] = []
    leaf = False
    body = text.lstrip("\ufeff \t\r\n")
    skipped = text[: len(text) - len(body)].count("\n")

    def line() -> int:
        return skipped + parser.CurrentLineNumber

    def start(tag: str, _: dict[str, str]) -> None:
        nonlocal leaf
        stack.append(tag.rpartition("}")[2])
        words.clear()
        leaf = True
        if stack[-1] == "segment" and not _OTHER_MESSAGES & {name.lower() for name in stack}:
            current[:] = [Record(source, line(), len(found) + 1)]

    def end(_: str) -> None:
        nonlocal leaf
        name = stack.pop()
        if name == "segment":
            found.extend(current)
            current.clear()
        elif leaf and current:
            current[0].add(name, "".join(words), line())
        leaf = False

    def refuse(*_: object) -> None:
        raise ValueError(
            f"{source}, line {line()}: a document type declaration; OMM needs none, and it is not read"
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = words.append
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(body.encode("utf-8", "replace"), True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise ValueError(f"{source}, line {skipped + error.lineno}: not well-formed XML ({reason})") from None
    return iter(found)
