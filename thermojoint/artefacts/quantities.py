"""What a column of a log holds, told by the unit that ends its name: ``spindle_rpm``, ``T1 [°C]``.

SI inside: kelvin, metre, radian per second, watt. A temperature in °C becomes an absolute one.
"""

from __future__ import annotations

import math
import re
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
#: By the name of the unit as a column's name carries it.
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
    "W": Unit("power", 1.0),
    "kW": Unit("power", 1e3),
    "A": Unit("current", 1.0),
    "Nm": Unit("torque", 1.0),
    "percent": Unit("load", 1e-2),
}
_ALIASES = {
    "°C": "degC",
    "℃": "degC",
    "C": "degC",
    "°F": "degF",
    "µm": "um",
    "μm": "um",
    "1/min": "rpm",
    "U/min": "rpm",
    "rad/s": "rad_s",
    "%": "percent",
}
_LONGEST_FIRST = sorted([*UNITS, *_ALIASES], key=len, reverse=True)
_ENDING = re.compile(
    rf"^(?P<base>.*?)(?:_|\s+|\s*[\[(])(?P<unit>{'|'.join(map(re.escape, _LONGEST_FIRST))})[\])]?$"
)


@dataclass(frozen=True)
class Column:
    """One column of a log.

    Attributes
    ----------
    name : str
        As the log, or the user in its place, calls it, with the unit.
    base : str
        The name without its unit.
    unit : str
        A key of `UNITS`.
    """

    name: str
    base: str
    unit: str

    @property
    def quantity(self) -> str:
        """``temperature``, ``length``, ``speed``, ``power``, ``current``, ``torque``, ``load``."""
        return UNITS[self.unit].quantity

    def to_si(self, values: Array) -> Array:
        """Return values as the log has them in SI, of the same shape."""
        _, scale, offset = UNITS[self.unit]
        return np.asarray(scale * (values + offset))

    def from_si(self, values: Array) -> Array:
        """Return values in SI as the log would have them, of the same shape."""
        _, scale, offset = UNITS[self.unit]
        return np.asarray(values / scale - offset)


def column_named(name: str) -> Column | None:
    """Return what the name of a column says, or None if it ends in no unit known here."""
    found = _ENDING.match(name)
    if found is None:
        return None
    unit = found["unit"]
    return Column(name, found["base"].strip(), _ALIASES.get(unit, unit))
