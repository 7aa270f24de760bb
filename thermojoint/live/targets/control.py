"""What a control takes as temperature compensation of an axis: quantities, units, limits, nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Quantity:
    """One quantity of an axis."""

    #: As in the manual of the control.
    name: str
    unit: str
    #: One unit in SI: of a length, m; of a slope, m/m.
    metres: float
    #: The step of a value that is written, and the largest of either sign, in the unit.
    step: float
    largest: float
    #: The control has a 32-bit integer, not a double.
    whole: bool
    #: Node id by OPC UA; ``{axis}`` is the number of the axis.
    node: str
    #: Line of a file for the control; ``{axis}`` and ``{value}``.
    line: str


@dataclass(frozen=True)
class Control:
    """Temperature compensation of a control: value = offset + slope (position - reference)."""

    title: str
    #: What is written.
    offset: Quantity
    #: What is written for an axis with a slope; of the others it must be 0.
    slope: Quantity
    #: The position at which the compensation is the offset: P0 of the slope, or 0.
    reference: Quantity
    #: What activates the compensation: 1 by the offset alone.
    switch: Quantity
    #: And by offset and slope.
    with_slope: float
    #: What begins a comment in a file for the control.
    comment: str
    #: First line of an axis in such a file; ``{axis}``.
    heading: str = ""
    #: Its last lines.
    ending: tuple[str, ...] = ()

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them; those that are only checked come last."""
        return (self.offset, self.slope, self.reference, self.switch)


def in_units(quantity: Quantity, metres: float) -> float:
    """Return a length (m) or a slope (m/m) in the control's unit, rounded to its step.

    Raises
    ------
    InputError
        It is not finite, or beyond the range of the control.
    """
    value = metres / quantity.metres
    if not abs(value) <= quantity.largest:
        raise InputError(
            f"{quantity.name}: {value:.6g} {quantity.unit} is beyond ±{quantity.largest:g}; "
            "make it smaller in the settings of the offsets"
        )
    return _on_grid(quantity, value)


def next_value(quantity: Quantity, now: float, metres: float, most: float) -> float:
    """Return what to write next where a control has a value now.

    Parameters
    ----------
    quantity : Quantity
    now : float
        In the control's unit.
    metres : float
        Where it should go, m or m/m; raises as `in_units`.
    most : float
        Largest change by one write, m or m/m; at least a step of the control.
    """
    goal = in_units(quantity, metres)
    # Whole steps: a rounded change would be larger, or none at all.
    change = quantity.step * steps_in(quantity, most)
    if abs(goal - now) <= most / quantity.metres:
        return goal
    return _on_grid(quantity, now + math.copysign(change, goal - now))


def steps_in(quantity: Quantity, most: float) -> int:
    """Return how many whole steps of the control are within a change, m or m/m."""
    return math.floor(most / quantity.metres / quantity.step + 1e-9)


def _on_grid(quantity: Quantity, value: float) -> float:
    # The quotient of two short decimals has the fewest digits.
    return round(value / quantity.step) / round(1.0 / quantity.step)
