"""Catalogue numbers of satellites: plain ones of up to nine digits, and the alpha-5 form of two-line elements."""

from __future__ import annotations

import re

_LETTERS = "ABCDEFGHJKLMNPQRSTUVWXYZ"
"""Stand for 10 to 33; I and O are left out because they look like 1 and 0."""


def catalogue_number(text: str) -> int:
    """The number that a text means.

    Parameters
    ----------
    text : str
        Digits (``25544``, ``799500123``) or alpha-5: a letter for the ten thousands (``T0001`` is 270001).

    Raises
    ------
    ValueError
        If it is neither; the letters I and O are named, since they are taken for digits.
    """
    text = text.strip()
    if re.fullmatch(r"\d{1,18}", text, flags=re.ASCII):
        return int(text)
    if re.fullmatch(r"[IO]\d{4}", text, flags=re.ASCII | re.IGNORECASE):
        raise ValueError(f"{text!r}: alpha-5 has no letter {text[0].upper()}, which looks like a digit")
    if re.fullmatch(r"[A-Z]\d{4}", text, flags=re.ASCII):
        return 10_000 * (10 + _LETTERS.index(text[0])) + int(text[1:])
    raise ValueError(f"{text!r} is neither a whole number nor a letter and four digits (alpha-5)")
