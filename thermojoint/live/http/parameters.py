"""Validation of query parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.live.times import seconds_of

#: Parses one value; raises InputError with the expected form.
Parser = Callable[[str], Any]

#: Times are between 1970 and 9999.
LATEST = 253402300799.0


def read_parameters(
    given: Iterable[tuple[str, str]], parsers: Mapping[str, Parser]
) -> dict[str, Any]:
    """Return the values of the parameters that were given.

    Raises
    ------
    InputError
        A name is unknown or appears twice, or a value is invalid.
    """
    parameters: dict[str, Any] = {}
    for name, value in given:
        if name not in parsers:
            raise unknown_name("parameter", shown(name), parsers, "address")
        if name in parameters:
            raise InputError(f"{name} appears twice in the address; give it once")
        try:
            parameters[name] = parsers[name](value)
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
    return parameters


def moment(text: str) -> float:
    """Parse a time: seconds since 1970, or ISO 8601, in UTC unless a zone is given."""
    try:
        value = float(text)
    except ValueError:
        try:
            value = seconds_of(text)
        except (ValueError, OverflowError):
            value = math.nan
    if not 0.0 <= value <= LATEST:
        raise InputError(
            f"{shown(text)} is not a time; give seconds since 1970 or e.g. 2026-11-21T08:00:00Z"
        )
    return value


def whole_number(low: int, high: int) -> Parser:
    """Return a parser for whole numbers from `low` to `high`."""

    def parse(text: str) -> int:
        value = int(text) if text.isascii() and text.isdigit() and len(text) < 10 else low - 1
        if not low <= value <= high:
            raise InputError(f"{shown(text)} is not a whole number from {low} to {high}")
        return value

    return parse


def number(low: float, high: float) -> Parser:
    """Return a parser for numbers from `low` to `high`."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise InputError(f"{shown(text)} is not a number from {low:g} to {high:g}")
        return value

    return parse


def one_of(*known: str) -> Parser:
    """Return a parser for one of some words."""

    def parse(text: str) -> str:
        if text not in known:
            raise InputError(f"{shown(text)} is not one of {', '.join(known)}")
        return text

    return parse


def shown(text: str) -> str:
    """Return a text from a client, shortened and escaped for one line."""
    return ascii(text if len(text) <= 40 else f"{text[:40]}...")
