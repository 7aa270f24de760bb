"""Temperature compensation of an axis in a control: quantities, units, limits, nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Quantity:
    """One quantity of an axis."""

    #: Name as in the manual of the control.
    name: str
    unit: str
    #: The unit in SI: m for a length, m/m for a slope.
    metres: float
    #: Step size of a written value, and its largest magnitude, in the unit.
    step: float
    largest: float
    #: Whether the control stores a 32-bit integer, not a double.
    whole: bool
    #: OPC UA node id; ``{axis}`` is the number of the axis.
    node: str
    #: Line of a file for the control; ``{axis}`` and ``{value}``.
    line: str


@dataclass(frozen=True)
class Control:
    """Temperature compensation of a control: value = offset + slope (position - reference)."""

    title: str
    #: Written for every axis.
    offset: Quantity
    #: Written for an axis with a slope; it must be 0 for others.
    slope: Quantity
    #: Position at which the compensation equals the offset: P0 of the slope, or 0.
    reference: Quantity
    #: Switch of the compensation: 1 for the offset alone.
    switch: Quantity
    #: Value of the switch for offset and slope.
    with_slope: float
    #: Prefix of a comment in a file for the control.
    comment: str
    #: First line of an axis in such a file; ``{axis}``.
    heading: str = ""
    #: Last lines of such a file.
    ending: tuple[str, ...] = ()

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All quantities; those that are only checked come last."""
        return (self.offset, self.slope, self.reference, self.switch)


def in_units(quantity: Quantity, metres: float) -> float:
    """Return a length (m) or a slope (m/m) in the control's unit, rounded to its step.

    Raises
    ------
    InputError
        The value is not finite, or beyond the range of the control.
    """
    value = metres / quantity.metres
    if not abs(value) <= quantity.largest:
        raise InputError(
            f"{quantity.name}: {value:.6g} {quantity.unit} is beyond ±{quantity.largest:g}; "
            "make it smaller in the settings of the offsets"
        )
    return _on_grid(quantity, value)


def next_value(quantity: Quantity, now: float, metres: float, most: float) -> float:
    """Return the next value to write into a control, which has the value `now`, in its unit.

    The target, `metres`, is in m or m/m, and so is `most`, the largest change by one write: at
    least a step of the control. Raises as `in_units`.
    """
    goal = in_units(quantity, metres)
    # Whole steps: a rounded change could exceed the limit, or be zero.
    change = quantity.step * steps_in(quantity, most)
    if abs(goal - now) <= most / quantity.metres:
        return goal
    return _on_grid(quantity, now + math.copysign(change, goal - now))


def steps_in(quantity: Quantity, most: float) -> int:
    """Return the number of whole steps of the control within a change, m or m/m."""
    return math.floor(most / quantity.metres / quantity.step + 1e-9)


def _on_grid(quantity: Quantity, value: float) -> float:
    # A quotient of two short decimals gives the value with the fewest digits.
    return round(value / quantity.step) / round(1.0 / quantity.step)
