"""A verified quantity: the simulator's value against a known result."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Check:
    """A computed quantity beside its reference.

    Attributes
    ----------
    name : str
        Name of the check, unique in the suite.
    quantity : str
        Quantity compared, e.g. "heat flow".
    unit : str
        Unit of `reference` and `computed`; "1" if they have none.
    reference, computed : float
        The known value and the simulator's.
    tolerance : float
        Largest relative error that passes; positive.
    source : str
        Source of the reference.
    relative_error : float
        Without one: |computed - reference| / scale. Give it where the error is that of a whole
        field or history and `reference` and `computed` are only its most telling values.
    scale : float
        Scale of the relative error; default |reference|. A reference of zero needs one.

    Raises
    ------
    InputError
        The tolerance is not positive, or the reference is zero and neither an error nor a scale
        is given.
    """

    name: str
    quantity: str
    unit: str
    reference: float
    computed: float
    tolerance: float
    source: str
    relative_error: float = math.nan
    scale: float = math.nan

    def __post_init__(self) -> None:
        """Fill in the scale and the error."""
        if not self.tolerance > 0.0:
            raise InputError(f"check {self.name!r}: tolerance {self.tolerance:g}; give one above 0")
        if math.isnan(self.scale):
            object.__setattr__(self, "scale", abs(self.reference))
        if math.isnan(self.relative_error):
            if not self.scale > 0.0:
                raise InputError(f"check {self.name!r}: its reference is zero; give a scale")
            error = abs(self.computed - self.reference) / self.scale
            object.__setattr__(self, "relative_error", error)

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; never for one that is not a number."""
        return self.relative_error <= self.tolerance


def closed_form(
    name: str,
    quantity: str,
    unit: str,
    reference: float,
    computed: float,
    tolerance: float = 1e-7,
) -> Check:
    """Return a check against a closed form; the quantity ends its name."""
    return Check(
        name=f"{name}, {quantity}",
        quantity=quantity,
        unit=unit,
        reference=reference,
        computed=computed,
        tolerance=tolerance,
        source="closed form",
    )
