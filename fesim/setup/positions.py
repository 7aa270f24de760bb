"""Functions of position in a case, from formulas and tables."""

from __future__ import annotations

import math

import numpy as np

from fesim.case.formula import formula
from fesim.case.position_table import read_position_table
from fesim.case.thermal_sections import ProfileSection
from thermojoint.artefacts.arrays import Array, OfPosition
from thermojoint.artefacts.errors import InputError, shown_point


def profile_of(section: ProfileSection, where: str, least: float = -math.inf) -> OfPosition:
    """Return a profile as a function of position.

    Raises
    ------
    InputError
        The file is not a table. The function raises it for a value that is not finite or too small.
    """
    if section.file is not None:
        return checked(read_position_table(section.file, "factor"), where, least)
    return checked(formula(section.expression or ""), where, least)


def checked(function: OfPosition, where: str, least: float = -math.inf) -> OfPosition:
    """Return a function of position that refuses values that are not finite or below `least`."""

    def values(points: Array) -> Array:
        result = function(points)
        # Written so that NaN fails, too.
        bad = np.flatnonzero(~(np.isfinite(result) & (result >= least)))
        if bad.size:
            at = bad[0]
            floor = f"; it may not fall below {least:g}" if np.isfinite(least) else ""
            raise InputError(
                f"{where}: is {result[at]:g} at {shown_point(points[:, at])} m{floor}; correct it"
            )
        return result

    return values
