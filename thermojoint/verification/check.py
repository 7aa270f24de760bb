"""A verified quantity: the simulator's value against a known result."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Check:
    """A computed quantity beside its reference.

    Raises
    ------
    InputError
        The tolerance is not positive, or the reference is zero and neither an error nor a scale
        is given.
    """

    #: Name of the check, unique in the suite.
    name: str
    #: Quantity compared, e.g. "heat flow".
    quantity: str
    #: Unit of `reference` and `computed`; "1" if they have none.
    unit: str
    #: The known value and the simulator's.
    reference: float
    computed: float
    #: Largest relative error that passes; positive.
    tolerance: float
    #: Source of the reference.
    source: str
    #: Default |computed - reference| / scale. Given for the error of a whole field or history, of
    #: which `reference` and `computed` are representative values.
    relative_error: float = math.nan
    #: Scale of the relative error; default |reference|, required if that is zero.
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
        """Whether the error is within the tolerance; False for NaN."""
        return self.relative_error <= self.tolerance


@dataclass(frozen=True)
class Quantity:
    """A quantity that one or more checks compare."""

    #: As in `Check`.
    name: str
    unit: str
    #: Largest relative error that passes.
    tolerance: float = 1e-7
    #: Source of the references.
    source: str = "closed form"

    def check(
        self,
        case: str,
        reference: float,
        computed: float,
        scale: float = math.nan,
        relative_error: float = math.nan,
    ) -> Check:
        """Return the check of this quantity in a case, called "CASE: QUANTITY".

        If the name of the case contains a colon, the check is called "CASE, QUANTITY". The numbers
        are those of `Check`.
        """
        return Check(
            name=f"{case}{',' if ': ' in case else ':'} {self.name}",
            quantity=self.name,
            unit=self.unit,
            reference=float(reference),
            computed=float(computed),
            tolerance=self.tolerance,
            source=self.source,
            relative_error=relative_error,
            scale=scale,
        )
