"""Schema of a design question: values to choose, a figure to minimise, limits to hold."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from pydantic import Field, model_validator

from fesim.batch.study import RangeSection
from fesim.batch.summary import columns
from thermojoint.artefacts.settings.section import Finite, Section
from thermojoint.sensitivity.results import check_figures
from thermojoint.sensitivity.settings import RangesFile


def is_magnitude(name: str) -> bool:
    """Whether a figure counts by its magnitude: displacements and slopes, which have a sign."""
    return name.startswith("displacement_")


class LimitSection(Section):
    """``[[limits]]``: a figure that must stay within bounds."""

    figure: str
    at_least: Finite | None = None
    at_most: Finite | None = None

    @model_validator(mode="after")
    def _bounded(self) -> LimitSection:
        if self.at_least is None and self.at_most is None:
            raise ValueError(f"{self.figure!r} has no bound; give at_most or at_least")
        if self.at_least is not None and self.at_most is not None and self.at_least >= self.at_most:
            raise ValueError(f"{self.figure!r}: at_least must be below at_most")
        for name, end in (("at_least", self.at_least), ("at_most", self.at_most)):
            if end is not None and end < 0.0 and is_magnitude(self.figure):
                raise ValueError(
                    f"{self.figure!r} counts by its magnitude, which no {name} of {end:g} limits; "
                    "give the largest or the smallest magnitude"
                )
        return self


class DesignFile(RangesFile):
    """A whole design question."""

    ranges: Annotated[list[RangeSection], Field(min_length=1)]
    minimise: str | None = None
    maximise: str | None = None
    limits: list[LimitSection] = Field(default_factory=list)

    @model_validator(mode="after")
    def _one_aim(self) -> DesignFile:
        if (self.minimise is None) == (self.maximise is None):
            raise ValueError("give either minimise or maximise")
        return self

    @property
    def aim(self) -> str:
        """Figure, or path of a value, to be minimised or maximised."""
        return self.minimise or self.maximise or ""

    @property
    def names(self) -> list[str]:
        """Evaluated columns: the aim, then those of the limits."""
        return [self.aim, *(limit.figure for limit in self.limits)]


def check_names(given: DesignFile, moving_axes: Iterable[str], where: str) -> None:
    """Refuse names that are neither figures nor varied values.

    Parameters
    ----------
    given : DesignFile
        The question.
    moving_axes : iterable of str
        Names of the moving axes of its case.
    where : str
        For error messages.

    Raises
    ------
    InputError
        There is no such figure.
    """
    known = [*(span.path for span in given.ranges), *columns(moving_axes)]
    check_figures(given.names, known, where)
