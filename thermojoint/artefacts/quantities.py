"""Quantity of a table's column, from the unit in its name: ``spindle_rpm``, ``T1 [°C]``.

SI inside: kelvin, metre, radian per second, watt. A temperature in °C becomes an absolute one.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array


class Unit(NamedTuple):
    """SI value = scale · (value + offset)."""

    quantity: str
    scale: float
    offset: float = 0.0


_MINUTE = 60.0
#: Suffix of a column's name to its unit.
UNITS = {
    "s": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "min": Unit("time", _MINUTE),
    "h": Unit("time", 3600.0),
    "K": Unit("temperature", 1.0),
    "degC": Unit("temperature", 1.0, 273.15),
    "degF": Unit("temperature", 1.0 / 1.8, 459.67),
    "m": Unit("length", 1.0),
    "mm": Unit("length", 1e-3),
    "um": Unit("length", 1e-6),
    "nm": Unit("length", 1e-9),
    "rpm": Unit("speed", 2.0 * math.pi / _MINUTE),
    "rad_s": Unit("speed", 1.0),
    "deg_s": Unit("speed", math.pi / 180.0),
    "mm_s": Unit("feed", 1e-3),
    "mm_min": Unit("feed", 1e-3 / _MINUTE),
    "m_min": Unit("feed", 1.0 / _MINUTE),
    "W": Unit("power", 1.0),
    "kW": Unit("power", 1e3),
    "A": Unit("current", 1.0),
    "Nm": Unit("torque", 1.0),
    "percent": Unit("load", 1e-2),
}
#: Spellings of loggers, after `_plain`, by the unit that they mean.
_SPELLINGS = {
    "degC": ("°C", "Â°C", "deg C", "Grad C", "C"),
    "degF": ("°F", "Â°F", "deg F"),
    "K": ("Kelvin",),
    "um": ("μm", "Âμm"),
    "rpm": ("1/min", "/min", "U/min", "min-1", "min^-1", "RPM"),
    "rad_s": ("rad/s",),
    "deg_s": ("°/s", "deg/s"),
    "mm_s": ("mm/s",),
    "mm_min": ("mm/min",),
    "m_min": ("m/min",),
    "Nm": ("N m",),
    "percent": ("%",),
    "s": ("sec", "Sek"),
    "min": ("Min",),
    "h": ("Std",),
}
_ALIASES = {spelling: unit for unit, found in _SPELLINGS.items() for spelling in found}
_LONGEST_FIRST = sorted([*UNITS, *_ALIASES], key=len, reverse=True)
_ENDING = re.compile(
    r"^(?P<base>.*?)(?:_|\s+in\s+|,?\s+|\s*/\s*|\s*[\[(]\s*)"
    rf"(?P<unit>{'|'.join(map(re.escape, _LONGEST_FIRST))})\s*[\])]?$"
)
#: The position of an axis; ``x_at_mm`` is the position of displacements given at positions.
_POSITION = re.compile(r"(?:pos|position|_at)$", re.IGNORECASE)
#: The way of an axis, there and back; ``slideway_um`` is a displacement.
_WAY = re.compile(r"_way$", re.IGNORECASE)
#: A displacement at a stated position.
_FIXED = re.compile(r"^(?P<base>.+)@(?P<at>-?\d+(?:\.\d+)?)(?P<unit>mm|m|um)$")
#: Words to the unit that is assumed where none is given, as on a machine's display.
_USUAL = re.compile(
    r"^(?:(?P<rpm>drehzahl|spindeldrehzahl)|(?P<degC>temperatur|temperature))\W*\d*$"
)


@dataclass(frozen=True)
class Column:
    """One column of a log."""

    #: Name with its unit, as in the log or given by the user.
    name: str
    #: The name without its unit.
    base: str
    #: A key of `UNITS`.
    unit: str

    @property
    def quantity(self) -> str:
        """``temperature``, ``length``, ``speed``, ``feed``, ``power`` ..., from `UNITS`."""
        return UNITS[self.unit].quantity

    @property
    def is_position(self) -> bool:
        """Whether this is the position of an axis, by its name, and not a displacement."""
        return self.quantity == "length" and bool(_POSITION.search(self.base))

    @property
    def is_displacement(self) -> bool:
        """Whether this is a length, but neither a position nor the travel of an axis."""
        of_axis = self.is_position or _WAY.search(self.base)
        return self.quantity == "length" and not of_axis

    def to_si(self, values: Array) -> Array:
        """Return values in the column's unit as SI values, of the same shape."""
        _, scale, offset = UNITS[self.unit]
        return np.asarray(scale * (values + offset))

    def from_si(self, values: Array) -> Array:
        """Return SI values in the column's unit, of the same shape."""
        _, scale, offset = UNITS[self.unit]
        return np.asarray(values / scale - offset)


def _plain(text: str) -> str:
    """Return a text with one spelling each of µ, ℃, ⁻¹, narrow blanks and minus signs."""
    return unicodedata.normalize("NFKC", text).replace("\N{MINUS SIGN}", "-")


def unit_named(text: str) -> str | None:
    """Return the key of `UNITS` for a logger's unit, with or without brackets; or None."""
    bare = _plain(text).strip().strip("[]()").strip()
    return bare if bare in UNITS else _ALIASES.get(bare)


def column_named(name: str) -> Column | None:
    """Return the column of a name, or None if the name does not end in a known unit."""
    match = _ENDING.match(_plain(name))
    if match is None:
        return None
    unit = match["unit"]
    return Column(name, match["base"].strip(), _ALIASES.get(unit, unit))


def fixed_positions(columns: Iterable[Column], name: str) -> list[tuple[Column, float]]:
    """Return the columns of a displacement at stated positions, and these in m.

    Parameters
    ----------
    columns : iterable of Column
    name : str
        With or without its unit: ``x`` and ``x_um`` are read at 400 mm in ``x@400mm_um``.
    """
    base = column.base if (column := column_named(name)) else name
    return [
        (column, UNITS[match["unit"]].scale * float(match["at"]))
        for column in columns
        if (match := _FIXED.match(column.base)) and match["base"] == base
    ]


def column_assumed(name: str) -> Column | None:
    """Return a column in the usual unit of its name: ``Drehzahl`` rpm, ``Temperatur 2`` °C."""
    match = _USUAL.match(_plain(name).strip().lower())
    if match is None or match.lastgroup is None:
        return None
    return Column(name, name.strip(), match.lastgroup)


class Place(NamedTuple):
    """Position of a requested column, and the units to convert between."""

    at: int
    found: Column | None
    wanted: Column | None

    def values(self, cells: Array) -> Array:
        """Return the values in the requested unit; unchanged if it is their own."""
        if self.found is None or self.wanted is None or self.found.unit == self.wanted.unit:
            return cells
        return self.wanted.from_si(self.found.to_si(cells))


def place_of(wanted: str, names: Sequence[str]) -> Place | None:
    """Find a column of a table by its name, with the same or another unit; None without one."""
    if wanted in names:
        return Place(names.index(wanted), None, None)
    asked = column_named(wanted)
    if asked is None:
        return None
    for k, name in enumerate(names):
        column = column_named(name)
        if (
            column
            and (column.base, column.quantity) == (asked.base, asked.quantity)
            # A rise in K is not a temperature in °C.
            and (column.unit == "K") == (asked.unit == "K")
        ):
            return Place(k, column, asked)
    return None
