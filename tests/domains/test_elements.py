"""Element sets: reading, damage, propagation."""

import csv
import io
import json
import logging
from datetime import UTC, datetime, timedelta
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sgp4.api import Satrec
from sgp4.exporter import export_omm

from sapopt.domains.constellation import (
    ElementSets,
    element_positions_km,
    read_elements,
    starlink_elements,
)
from sapopt.domains.constellation.earth import greenwich_sidereal_rad, turn_about_pole

LINES = (files("sapopt.domains") / "data" / "starlink_2023-06.tle").read_text().splitlines()[:12]
"""Four satellites with name lines."""


def checked(line):
    """The line with its checksum made right."""
    return line[:68] + str(sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10)


def with_epoch(line, epoch):
    """A first line with another epoch."""
    return checked(line[:18] + epoch + line[32:])


def written(tmp_path, lines, name="sets.tle"):
    """A file with these lines."""
    path = tmp_path / name
    path.write_text(lines if isinstance(lines, str) else "\n".join(lines) + "\n")
    return path


@pytest.fixture
def four(tmp_path):
    """The four satellites, read from a file."""
    return read_elements(written(tmp_path, LINES))


def test_names_and_numbers(four, tmp_path):
    """Name lines are optional, and may be marked with a zero."""
    assert four.names == tuple(line.strip() for line in LINES[::3])
    bare = read_elements(written(tmp_path, [line for line in LINES if line[:2] in ("1 ", "2 ")]))
    assert bare.names == tuple(str(s.satnum) for s in four.satellites)
    zero = read_elements(written(tmp_path, ["0 " + x if i % 3 == 0 else x for i, x in enumerate(LINES)]))
    assert zero.names == four.names


def test_comments_and_times_of_the_verification_file(four, tmp_path):
    """Lines of # are comments, and the times behind second lines are passed over, as in SGP4-VER.TLE."""
    lines = ["#  first, a comment"]
    for line in LINES:
        lines.append(line + "      0.00      4320.0        360.00" if line.startswith("2 ") else line)
        lines.append("#                       ## fast moving, high drag")
    sets = read_elements(written(tmp_path, lines))
    assert sets.names == four.names
    assert [s.mo for s in sets.satellites] == [s.mo for s in four.satellites]
    with pytest.raises(ValueError, match="line 3: 79 characters"):
        read_elements(written(tmp_path, [*LINES[:2], LINES[2] + "  and more", *LINES[3:]]))


def test_alpha_five_and_names_that_begin_with_a_digit(tmp_path):
    """A letter stands for the ten thousands; a name may look like the start of a line."""
    sets = read_elements(
        written(tmp_path, ["1 HOPPER", *(checked(line[:2] + "T0007" + line[7:]) for line in LINES[1:3])])
    )
    assert (sets.names, sets.numbers) == (("1 HOPPER",), (270007,))
    assert sets.satellites[0].satnum == 270007


def test_packaged_starlink():
    """The packaged file has 4213 Starlink satellites among its 4228 objects."""
    elements = starlink_elements()
    assert elements.n == 4213
    assert len(set(elements.names)) == 4213
    assert abs(elements.latest_epoch - datetime(2023, 6, 14, 14, 42, 37, tzinfo=UTC)) < timedelta(seconds=1)


DAMAGE = {
    "digit": (
        lambda x: [*x[:4], x[4][:30] + str((int(x[4][30]) + 1) % 10) + x[4][31:], *x[5:]],
        "line 5: wrong checksum",
    ),
    "short": (lambda x: [*x[:5], x[5][:-7], *x[6:]], "line 6: 62 characters instead of 69"),
    "long": (lambda x: [*x[:5], x[5] + "5", *x[6:]], "line 6: 70 characters"),
    "mismatch": (lambda x: [*x[:5], x[8], *x[6:]], "line 6: catalogue number .* does not match .* of line 5"),
    "no second": (lambda x: [*x[:5], *x[6:]], "line 6: expected line 2 .* found 'STARLINK"),
    "no first": (lambda x: [*x[:4], *x[5:]], "line 5: expected line 1 .* found '2 "),
    "truncated": (lambda x: x[:11], "line 11: the file ends here; line 2"),
    "truncated after name": (lambda x: x[:10], "line 10: the file ends after"),
    "second alone": (lambda x: x[2:], "line 1: second line of an element set without"),
    "letter for a zero": (
        lambda x: [*x[:5], x[5][:26] + "O" + x[5][27:], *x[6:]],
        "line 6: eccentricity .columns 27 to 33. cannot be 'O",
    ),
    "no blank": (lambda x: [*x[:4], x[4][:8] + "." + x[4][9:], *x[5:]], "line 5: column 9 must be blank"),
    "letter": (lambda x: [*x[:7], x[7][:-1] + "x", *x[8:]], "line 8: wrong checksum, the line says 'x'"),
    "day 000": (
        lambda x: [x[0], with_epoch(x[1], "23000.50000000"), *x[2:]],
        "line 2: epoch .* 2023 has no day 000",
    ),
    "day 366": (
        lambda x: [x[0], with_epoch(x[1], "23366.50000000"), *x[2:]],
        "2023 has no day 366.* only 1 to 365",
    ),
    "day 999": (
        lambda x: [x[0], with_epoch(x[1], "23999.50000000"), *x[2:]],
        "line 2: epoch .* 2023 has no day 999",
    ),
    "letter I": (
        lambda x: [x[0], *(checked(line[:2] + "I0007" + line[7:]) for line in x[1:3]), *x[3:]],
        "line 2: catalogue number .*: 'I0007': alpha-5 has no letter I",
    ),
    "SGP4-XP": (
        lambda x: [x[0], checked(x[1][:62] + "4" + x[1][63:]), *x[2:]],
        "line 2: ephemeris type 4 .SGP4-XP",
    ),
    "empty": (lambda x: [], "empty"),
    "prose": (lambda x: ["hello", "world"], "line 2: expected line 1"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_is_named_with_its_line(kind, tmp_path):
    """Each kind of damage is a ValueError with the number of the line and what is wrong with it."""
    damage, message = DAMAGE[kind]
    with pytest.raises(ValueError, match=message):
        read_elements(written(tmp_path, damage(list(LINES))))


@settings(max_examples=150)
@given(
    line=st.integers(0, 11),
    column=st.integers(0, 68),
    character=st.characters(min_codepoint=33, max_codepoint=126),
)
def test_no_damaged_line_is_read_silently(line, column, character, tmp_path_factory):
    """One changed character either raises with the file's name, or leaves the numbers of the orbit alone."""
    old = LINES[line]
    new = old[:column] + character + old[column + 1 :]
    path = written(tmp_path_factory.mktemp("tle"), [*LINES[:line], new, *LINES[line + 1 :]])
    try:
        elements = read_elements(path)
    except ValueError as error:
        assert path.name in str(error)  # noqa: PT017
        return
    # What passes is in the names, the designator and the classification.
    reference = read_elements(written(path.parent, LINES, "good.tle"))
    for got, want in zip(elements.satellites, reference.satellites, strict=True):
        for name in (
            "satnum",
            "inclo",
            "nodeo",
            "ecco",
            "argpo",
            "mo",
            "no_kozai",
            "bstar",
            "jdsatepoch",
            "jdsatepochF",
        ):
            assert getattr(got, name) == getattr(want, name)


def omm_fields(elements):
    """OMM dictionaries of satellites."""
    return [export_omm(s, name) for s, name in zip(elements.satellites, elements.names, strict=True)]


def as_csv(fields):
    """OMM as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fields[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(fields)
    return text.getvalue()


def as_xml(fields):
    """OMM as XML, as far as the reader cares."""
    groups = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "MEAN_ELEMENT_THEORY")

    def tags(one, inside):
        return "".join(f"<{k}>{v}</{k}>" for k, v in one.items() if (k in groups) == inside)

    segments = (
        f"<segment><metadata>{tags(one, True)}</metadata>"
        f"<data><meanElements>{tags(one, False)}</meanElements></data></segment>"
        for one in fields
    )
    return f"<ndm><omm><body>{''.join(segments)}</body></omm></ndm>"


@pytest.mark.parametrize(("suffix", "write"), [("csv", as_csv), ("json", json.dumps), ("xml", as_xml)])
def test_omm_gives_the_orbits_of_the_tle(four, tmp_path, suffix, write):
    """The same satellites as OMM move along the same orbits."""
    fields = omm_fields(four)
    path = written(tmp_path, write(fields), f"sets.{suffix}")
    read = read_elements(path)
    assert read.names == four.names
    ours, kept = element_positions_km(read, 5, 600.0, start=four.latest_epoch)
    theirs, _ = element_positions_km(four, 5, 600.0, start=four.latest_epoch)
    assert len(kept) == 4
    np.testing.assert_allclose(ours, theirs, atol=0.01)


@pytest.mark.parametrize(("suffix", "write"), [("csv", as_csv), ("json", json.dumps), ("xml", as_xml)])
@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("INCLINATION", "steep", "cannot be read"),
        ("MEAN_MOTION", "", "MEAN_MOTION is missing"),
        ("EPOCH", "", "EPOCH is missing"),
        ("EPOCH", "yesterday", "cannot be read"),
        ("ECCENTRICITY", "1.5", "ECCENTRICITY"),
    ],
)
def test_damaged_omm_names_the_record(four, tmp_path, suffix, write, field, value, message):
    """A bad field is named with the line (CSV) or record that holds it."""
    fields = omm_fields(four)
    fields[2][field] = value
    where = "line 4" if suffix == "csv" else "record 3"
    with pytest.raises(ValueError, match=f"{where}: .*{message}"):
        read_elements(written(tmp_path, write(fields), f"sets.{suffix}"))


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        ("json", '[{"a": 1},', "line 1: not valid JSON"),
        ("json", "[1, 2]", "list of objects"),
        ("json", "[]", "no element set"),
        ("xml", "<ndm><omm>", "line 1: not well-formed"),
        ("csv", "OBJECT_NAME,EPOCH\nX,1,2\n", "line 2: the number of fields"),
        ("csv", "OBJECT_NAME,EPOCH\nX\n", "line 2: the number of fields"),
    ],
)
def test_malformed_omm(tmp_path, suffix, text, message):
    """A file that is not what its suffix says is refused by the place of the damage."""
    with pytest.raises(ValueError, match=message):
        read_elements(written(tmp_path, text, f"sets.{suffix}"))


def test_newest_of_several_sets_is_kept(four, tmp_path, caplog):
    """A satellite that is listed twice counts once, with its newest elements."""
    twice = [*omm_fields(four), omm_fields(four)[1] | {"EPOCH": "2024-01-01T00:00:00.000000"}]
    with caplog.at_level(logging.WARNING):
        read = read_elements(written(tmp_path, json.dumps(twice), "sets.json"))
    assert read.names == four.names
    assert "newest" in caplog.text
    assert read.latest_epoch == datetime(2024, 1, 1, tzinfo=UTC)


def test_frame_of_a_textbook_example():
    """TEME to Earth-fixed (before polar motion): Vallado et al. 2006, Revisiting Spacetrack Report 3, appendix C."""
    teme = np.array([[[5094.18016210, 6127.64465950, 6380.34453270]]])
    date = 2453101.5 + (7 * 3600 + 51 * 60 + 28.386009 - 0.439962) / 86400
    fixed = turn_about_pole(teme, greenwich_sidereal_rad(date))
    np.testing.assert_allclose(fixed[0, 0], [-1033.47503130, 7901.30558560, 6380.34453270], atol=1e-3)


def test_positions_are_those_of_sgp4(four):
    """One satellite at one time, step by step, against the package's scalar call."""
    start = datetime(2023, 6, 15, 1, 2, 3, tzinfo=UTC)
    positions, kept = element_positions_km(four, 3, 90.0, start=start, earth="still")
    assert positions.shape == (3, 4, 3)
    np.testing.assert_array_equal(kept, range(4))
    day = 2460110.5  # 0 h on 15 June
    for k in range(3):
        fraction = (3600 + 123 + 90.0 * k) / 86400
        _, teme, _ = four.satellites[2].sgp4(day, fraction)
        fixed = turn_about_pole(np.array([[teme]]), greenwich_sidereal_rad(day + 3723 / 86400))
        np.testing.assert_allclose(positions[k, 2], fixed[0, 0], atol=1e-3)
    naive, _ = element_positions_km(four, 3, 90.0, start=start.replace(tzinfo=None), earth="still")
    np.testing.assert_array_equal(naive, positions)


def test_lost_satellites_are_left_out_and_named(four, caplog):
    """A satellite that SGP4 cannot propagate is dropped with a warning; if none is left, that is an error."""
    falling = Satrec()
    falling.sgp4init(
        1, "i", 99999, four.satellites[0].jdsatepoch - 2433281.5, 0.1, 0, 0, 0.0, 0, 1.0, 0, 0.0745, 0
    )
    mixed = ElementSets((*four.names, "FALLING"), (*four.satellites, falling))
    with caplog.at_level(logging.WARNING):
        positions, kept = element_positions_km(mixed, 4, 600.0, start=four.latest_epoch + timedelta(days=2))
    assert positions.shape == (4, 4, 3)
    np.testing.assert_array_equal(kept, range(4))
    assert "left out satellite FALLING" in caplog.text
    with pytest.raises(ValueError, match="none of the 1 satellites"):
        element_positions_km(mixed.named("FALL"), 4, 600.0, start=four.latest_epoch + timedelta(days=2))


def test_stale_elements_are_reported(four, caplog):
    """A start months away from the epochs is allowed, and said to be inaccurate."""
    with caplog.at_level(logging.WARNING):
        element_positions_km(four, 1, 60.0, start=four.latest_epoch + timedelta(days=60))
    assert "days away from the start" in caplog.text


def test_bad_arguments(four, tmp_path):
    """Names of arguments in the messages."""
    with pytest.raises(ValueError, match="earth"):
        element_positions_km(four, 1, 60.0, earth="flat")
    with pytest.raises(ValueError, match="steps"):
        element_positions_km(four, 0, 60.0)
    with pytest.raises(ValueError, match="prefix"):
        four.named("ONEWEB")
    with pytest.raises(FileNotFoundError):
        read_elements(tmp_path / "missing.tle")
