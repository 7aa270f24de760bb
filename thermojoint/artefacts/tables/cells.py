"""Conversion of cells to numbers; missing readings and error values of loggers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array

#: A number with a decimal point; not ``1_0``, which Python reads as 10.
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
#: Characters that do not occur in a column of plain numbers.
_ODD = re.compile(r"[^0-9eE+\-.\s]")
_GROUPED = {
    ".": re.compile(r"[+-]?\d{1,3}(?:[,' ]\d{3})+(?:\.\d*)?"),
    ",": re.compile(r"[+-]?\d{1,3}(?:[.' ]\d{3})+(?:,\d*)?"),
}
#: The sign may separate decimals or thousands.
_MAY_BE_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
#: Texts for a missing reading, in lower case; also runs of ``-``, ``*`` and ``?`` (`_SIGNS`).
_MISSING_WORDS = """
    nan na n/a #n/a #na null none nil inf infinity overflow over ovl ovfl ol underflow under open
    opn err error fehler fault invalid bad ungültig bruch #div/0! #value! #wert! #ref! #bezug! #num!
    #zahl! #name? 1.#qnan -1.#qnan 1.#ind -1.#ind 1.#inf -1.#inf
"""
MISSING = frozenset(_MISSING_WORDS.split())
_SIGNS = re.compile(r"[-–—*?_.]+|[+-]?(?:inf|infinity|ol|ovl|over)", re.IGNORECASE)
#: Larger values mean that an instrument is out of range (an open thermocouple reads 9.9e37).
_OVERFLOW = 1e30
#: Absolute zero in °F: in no unit is a temperature, or a rise, lower.
_ABSOLUTE_ZERO = -459.67
#: Error values of other quantities are at least this large.
_LEAST_ERROR = 3000.0
#: Limit on the magnitude of temperatures, in K, °C or °F.
LARGEST_TEMPERATURE = 5000.0
#: Limits of 16-bit counts, in units and in tenths.
_COUNTS = (32767.0, -32768.0, 3276.7, -3276.8, 65535.0, 6553.5)
#: Runs of nines, the error value of many loggers.
_NINES = tuple(
    sign * float(text)
    for text in ("9999", "9999.9", "9999.99", "99999", "99999.9", "999999", "9999999", "99999999")
    for sign in (1.0, -1.0)
)
#: Error values of quantities that may be 9999, e.g. a speed in rpm.
_NEVER = tuple(value for value in (*_NINES, -32768.0) if value < 0.0 or value > 99998.0)


class Numbers(NamedTuple):
    """Cells of one column as numbers."""

    #: Shape (k,): NaN where a reading is missing.
    values: Array
    #: Text in place of a number to its count; an empty cell is ``empty``.
    missing: Counter[str]
    #: Index of the first cell that is neither a number nor missing.
    unreadable: int | None


def is_missing(cell: str) -> bool:
    """Whether the text of a cell means a missing reading."""
    text = cell.strip()
    return not text or text.lower() in MISSING or _SIGNS.fullmatch(text) is not None


def number_in(cell: str, decimal: str) -> float | None:
    """Return the number in a cell, or None.

    It may contain separators of thousands: ``1.234,5``, ``1,234.5``, ``1 234,5``. The decimal sign
    is ``.`` or ``,``; empty if it is not known yet.
    """
    text = cell.strip()
    # Numbers with an exponent have a point in any language: a logger's overflow, 9.9E37.
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


def may_be_grouped(cell: str) -> bool:
    """Whether the only sign in a cell may separate thousands, as in ``20,125`` and ``20.125``."""
    return _MAY_BE_GROUPED.fullmatch(cell) is not None


def _decimal_of(text: str) -> str:
    """Return the decimal sign of one number: its last separator."""
    return "," if text.rfind(",") > text.rfind(".") else "."


def decimal_shown(cells: Sequence[str], temperatures: Sequence[str] = ()) -> str:
    """Return the decimal sign that follows from some cells; empty if it is undetermined.

    ``20,5`` and ``1.234,5`` have a comma; ``1,234`` may be either, but no temperature is in the
    thousands.

    Parameters
    ----------
    cells : sequence of str
    temperatures : sequence of str, optional
        Those of them that are temperatures.
    """
    votes = Counter[str]()
    shown = ((cell, True) for cell in cells), ((cell, False) for cell in temperatures)
    for cell, in_thousands in chain(*shown):
        text = cell.strip()
        if "," not in text and "." not in text:
            continue
        if not re.fullmatch(r"[+-]?[\d.,' \N{NO-BREAK SPACE}]+(?:[eE][+-]?\d+)?", text):
            continue
        last = _decimal_of(text)
        both = "," in text and "." in text
        grouped = in_thousands and may_be_grouped(text)
        if both or (text.count(last) == 1 and not grouped):
            votes[last] += 1
    return votes.most_common(1)[0][0] if votes else ""


def numbers(cells: Sequence[str], decimal: str) -> Numbers:
    """Convert cells of one column to numbers."""
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
    """Whether a number, in the unit of the reading, is an error value of a logger."""
    if not abs(value) > _least_error(quantity):
        return False
    return bool(np.isnan(without_error_values(np.array([value]), quantity)[0][0]))


def _least_error(quantity: str) -> float:
    """Return the magnitude that no error value of a quantity is below."""
    return -_ABSOLUTE_ZERO if quantity == "temperature" else _LEAST_ERROR


def without_error_values(values: Array, quantity: str) -> tuple[Array, Counter[str]]:
    """Return values with NaN in place of error values of loggers, and the count of each.

    Parameters
    ----------
    values : ndarray, shape (k,)
        In the unit of the table.
    quantity : str
        Their quantity (`Column.quantity`): a speed or a power may be 9999, a temperature or a
        thermal displacement may not.
    """
    size = np.abs(values)
    if not (size > _least_error(quantity)).any():  # NaN is not
        return values, Counter()
    wrong = size > _OVERFLOW
    if quantity in ("temperature", "length"):
        wrong |= np.isin(values, (*_NINES, *_COUNTS))
        if quantity == "temperature":
            wrong |= (size > LARGEST_TEMPERATURE) | (values < _ABSOLUTE_ZERO)
    else:
        wrong |= np.isin(values, _NEVER)
    counts = Counter(f"{value:.6g}" for value in values[wrong].tolist())
    return np.where(wrong, np.nan, values), counts
