"""Times of orbit messages, and catalogue numbers."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sapopt.domains.constellation.catalogue import catalogue_number
from sapopt.domains.constellation.epochs import utc_days

START = datetime(1949, 12, 31, tzinfo=UTC)


@given(
    time=st.datetimes(datetime(1957, 1, 1), datetime(2150, 1, 1)),
    minutes=st.integers(-14 * 60, 14 * 60),
    of_year=st.booleans(),
    digits=st.integers(0, 12),
    zone=st.sampled_from(["", "Z", "offset", "offset without colon"]),
)
def test_every_form_means_the_same_instant(
    time: datetime, minutes: int, of_year: bool, digits: int, zone: str
) -> None:
    """Calendar or day of the year, with any number of decimals and any offset: the instant of the standard library."""
    moment = time.replace(microsecond=0) if digits < 6 else time
    aware = moment.replace(tzinfo=timezone(timedelta(minutes=minutes)) if "offset" in zone else UTC)
    text = moment.strftime("%Y-%jT%H:%M:%S" if of_year else "%Y-%m-%dT%H:%M:%S")
    if digits:
        text += "." + f"{moment.microsecond:06d}000000"[:digits]
    if zone == "Z":
        text += "Z"
    elif zone:
        sign, ahead = "-" if minutes < 0 else "+", abs(minutes)
        text += f"{sign}{ahead // 60:02d}{':' if zone == 'offset' else ''}{ahead % 60:02d}"
    whole, part = utc_days(text)
    assert 0 <= part < 1
    assert abs(timedelta(days=whole) + timedelta(days=part) - (aware - START)) <= timedelta(microseconds=1)


def test_known_days() -> None:
    """Day 64 of a leap year is 4 March; decimals beyond the microsecond count; leap seconds begin the next day."""
    assert utc_days("2020-064T10:34:41.4264") == utc_days("2020-03-04T10:34:41.4264000000")
    assert utc_days("2020-03-04T10:34:41.") == utc_days("2020-03-04 10:34:41z")
    assert utc_days("2016-12-31T23:59:60.5") == utc_days("2017-01-01T00:00:00.5")
    assert utc_days("2000-001T00:00:00.0000001")[1] == pytest.approx(1e-7 / 86400, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("yesterday", "no time of the form"),
        ("2020-03-04", "no time of the form"),
        ("2020-3-4T00:00:00", "no time of the form"),
        ("٢٠٢٠-03-04T00:00:00", "no time of the form"),
        ("2020-000T00:00:00", "2020 has no day 000"),
        ("2021-366T00:00:00", "2021 has no day 366"),
        ("2021-02-29T00:00:00", "no such day"),
        ("2021-13-01T00:00:00", "no such day"),
        ("0000-01-01T00:00:00", "no year 0000"),
        ("2021-01-01T24:00:00", "no such time of day"),
        ("2021-01-01T12:00:60", "no such time of day"),
        ("2021-01-01T00:00:00+25:00", "no such offset"),
    ],
)
def test_no_such_time(text: str, reason: str) -> None:
    """What is no time, or a day that does not exist, is refused with the reason."""
    with pytest.raises(ValueError, match=reason):
        utc_days(text)


def test_catalogue_numbers() -> None:
    """Nine digits and alpha-5 are read; the two letters that look like digits are named."""
    assert catalogue_number(" 25544") == 25544
    assert catalogue_number("799500123") == 799_500_123
    assert [catalogue_number(x) for x in ("A0000", "H9999", "J0000", "N0001", "P0001", "Z9999")] == [
        100_000, 179_999, 180_000, 220_001, 230_001, 339_999,
    ]  # fmt: skip
    for text, reason in (
        ("I0001", "no letter I"),
        ("o0001", "no letter O"),
        ("a0001", "neither"),
        ("", "neither"),
    ):
        with pytest.raises(ValueError, match=reason):
            catalogue_number(text)


@given(st.integers(100_000, 339_999))
def test_alpha_five_is_that_of_sgp4(number: int) -> None:
    """Our reading of alpha-5 is the inverse of the sgp4 package's writing."""
    from sgp4.alpha5 import to_alpha5

    assert catalogue_number(to_alpha5(number)) == number
