"""Cells as numbers; what is not a number, and what a logger writes in its place."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array

#: A number with a decimal point. ``1_0``, which Python would read as 10, is none.
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
#: What no column of plain numbers has.
_ODD = re.compile(r"[^0-9eE+\-.\s]")
_GROUPED = {
    ".": re.compile(r"[+-]?\d{1,3}(?:[,' ]\d{3})+(?:\.\d*)?"),
    ",": re.compile(r"[+-]?\d{1,3}(?:[.' ]\d{3})+(?:,\d*)?"),
}
#: A decimal sign or one of thousands.
_MAY_BE_GROUPED = re.compile(r"[+-]?\d{1,3}[.,]\d{3}")
#: What stands for a reading that is missing, in lower case; runs of ``-``, ``*`` and ``?`` as well.
_MISSING_WORDS = """
    nan na n/a #n/a #na null none nil inf infinity overflow over ovl ovfl ol underflow under open
    opn err error fehler fault invalid bad ungültig bruch #div/0! #value! #wert! #ref! #bezug! #num!
    #zahl! #name? 1.#qnan -1.#qnan 1.#ind -1.#ind 1.#inf -1.#inf
"""
MISSING = frozenset(_MISSING_WORDS.split())
_SIGNS = re.compile(r"[-–—*?_.]+|[+-]?(?:inf|infinity|ol|ovl|over)", re.IGNORECASE)
#: Beyond, an instrument has left its range (an open thermocouple reads 9.9e37).
_OVERFLOW = 1e30
#: No smaller number is an error.
_LEAST_ERROR = 3000.0
#: No temperature is further from zero, in K, °C or °F.
LARGEST_TEMPERATURE = 5000.0
#: Ends of 16-bit counts, as they are and in tenths.
_COUNTS = (32767.0, -32768.0, 3276.7, -3276.8, 65535.0, 6553.5)
#: Runs of nines, the error value of many loggers.
_NINES = tuple(
    sign * float(text)
    for text in ("9999", "9999.9", "9999.99", "99999", "99999.9", "999999", "9999999", "99999999")
    for sign in (1.0, -1.0)
)
#: Where a spindle may turn at 9999 rpm, only these are errors.
_NEVER = tuple(value for value in (*_NINES, -32768.0) if value < 0.0 or value > 99998.0)


class Numbers(NamedTuple):
    """Cells of one column as numbers.

    Attributes
    ----------
    values : ndarray, shape (k,)
        NaN where a reading is missing.
    missing : Counter
        What stood in place of a number, to how often; an empty cell is ``empty``.
    unreadable : int or None
        The first cell that is neither.
    """

    values: Array
    missing: Counter[str]
    unreadable: int | None


def is_missing(cell: str) -> bool:
    """Whether a cell stands for a missing reading by its text."""
    text = cell.strip()
    return not text or text.lower() in MISSING or _SIGNS.fullmatch(text) is not None


def number_in(cell: str, decimal: str) -> float | None:
    """Return the number in a cell, or None.

    Parameters
    ----------
    cell : str
        With thousands, perhaps: ``1.234,5``, ``1,234.5``, ``1 234,5``.
    decimal : str
        Its decimal sign, ``.`` or ``,``; empty where the table has not shown it yet.
    """
    text = cell.strip()
    # An exponent stands behind a point in any language: a logger's overflow, 9.9E37.
    if _NUMBER.fullmatch(text) and (decimal != "," or "e" in text.lower()):
        return float(text)
    text = text.replace("\N{MINUS SIGN}", "-").replace("\N{NO-BREAK SPACE}", " ")
    text = text.replace("\N{NARROW NO-BREAK SPACE}", " ").replace(
        "\N{RIGHT SINGLE QUOTATION MARK}", "'"
    )
    sign = decimal or _decimal_of(text)
    if _GROUPED[sign].fullmatch(text):
        for group in (".", ",", "'", " "):
            text = text if group == sign else text.replace(group, "")
    elif sign == "," and "." in text:
        return None
    text = text.replace(",", ".") if sign == "," else text
    return float(text) if _NUMBER.fullmatch(text) else None


def _decimal_of(text: str) -> str:
    """Return the decimal sign of one number: the last of its signs."""
    return "," if text.rfind(",") > text.rfind(".") else "."


def decimal_shown(cells: Sequence[str]) -> str:
    """Return the decimal sign that some cells show, empty if they leave it open.

    ``20,5`` shows a comma, as ``1.234,5`` does; ``1,234`` may be either.
    """
    votes = Counter[str]()
    for cell in cells:
        text = cell.strip()
        if not re.fullmatch(r"[+-]?[\d.,' \N{NO-BREAK SPACE}]+(?:[eE][+-]?\d+)?", text):
            continue
        last = _decimal_of(text)
        both = "," in text and "." in text
        if both or (text.count(last) == 1 and not _MAY_BE_GROUPED.fullmatch(text)):
            votes[last] += 1
    return votes.most_common(1)[0][0] if votes else ""


def numbers(cells: Sequence[str], decimal: str) -> Numbers:
    """Return the numbers in some cells of one column.

    Parameters
    ----------
    cells : sequence of str
        As they stand in the table.
    decimal : str
        See `number_in`.
    """
    if decimal != "," and not _ODD.search("".join(cells)):
        try:
            values = np.array(list(map(float, cells)))
        except ValueError:
            pass
        else:
            return Numbers(values, Counter(), None)
    values = np.full(len(cells), np.nan)
    missing = Counter[str]()
    for k, cell in enumerate(cells):
        value = number_in(cell, decimal)
        if value is not None:
            values[k] = value
        elif is_missing(cell):
            missing[cell.strip() or "empty"] += 1
        else:
            return Numbers(values, missing, k)
    return Numbers(values, missing, None)


def is_error_value(value: float, quantity: str) -> bool:
    """Whether a number is one by which a logger says that it has none; see `without_error_values`.

    Parameters
    ----------
    value : float
        In the unit of the reading.
    quantity : str
        What it is (`Column.quantity`).
    """
    if not abs(value) > _LEAST_ERROR:
        return False
    return bool(np.isnan(without_error_values(np.array([value]), quantity)[0][0]))


def without_error_values(values: Array, quantity: str) -> tuple[Array, Counter[str]]:
    """Return values with NaN for the numbers by which a logger says that it has none.

    Parameters
    ----------
    values : ndarray, shape (k,)
        In the unit of the table.
    quantity : str
        What they are (`Column.quantity`): a speed or a power may be 9999, a temperature and a
        thermal displacement are not.
    """
    size = np.abs(values)
    if not (size > _LEAST_ERROR).any():  # NaN is not
        return values, Counter()
    wrong = size > _OVERFLOW
    if quantity in ("temperature", "length"):
        wrong |= np.isin(values, (*_NINES, *_COUNTS))
        if quantity == "temperature":
            wrong |= size > LARGEST_TEMPERATURE
    else:
        wrong |= np.isin(values, _NEVER)
    counts = Counter(f"{value:.6g}" for value in values[wrong].tolist())
    return np.where(wrong, np.nan, values), counts
