"""Effects of small changes, one number of a case at a time, by central differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fesim.batch.study import Values
from thermojoint.artefacts.arrays import Array
from thermojoint.sensitivity.parameters import Parameter

#: Changes of a parameter, in its unit change, for the difference and for its check.
WIDE, NARROW = 2.0, 1.0


@dataclass(frozen=True)
class Effect:
    """Effect of one parameter on every figure."""

    parameter: Parameter
    #: Shape (figures,): change of each figure by the parameter's unit change, in its own unit.
    change: Array
    #: Shape (figures,): dependence of the effect on the size of the change.
    error: Array


def rows_of(parameters: Sequence[Parameter]) -> list[Values]:
    """Return the values of the cases: four for each parameter, with all others unchanged."""
    given = {parameter.path: parameter.value for parameter in parameters}
    return [
        given | {parameter.path: parameter.value + times * parameter.unit_change}
        for parameter in parameters
        for times in (-WIDE, WIDE, -NARROW, NARROW)
    ]


def varied_in(values: Values, parameters: Sequence[Parameter]) -> str:
    """Return the path of the parameter that is changed in the values of a case."""
    return next(each.path for each in parameters if values[each.path] != each.value)


def effects_of(parameters: Sequence[Parameter], figures: Array) -> list[Effect]:
    """Return the effect of each parameter.

    Both differences have an error of second order; extrapolating them removes it. A parameter
    without all four cases has no effect in the list.

    Parameters
    ----------
    parameters : sequence of Parameter
        The parameters.
    figures : ndarray, shape (4 parameters, figures)
        Results of the cases of `rows_of`; NaN for a case without a result.
    """
    effects = []
    by_parameter = figures.reshape(len(parameters), 4, -1)
    for parameter, values in zip(parameters, by_parameter, strict=True):
        wide = (values[1] - values[0]) / (2.0 * WIDE)
        narrow = (values[3] - values[2]) / (2.0 * NARROW)
        ratio = (WIDE / NARROW) ** 2
        better = (ratio * narrow - wide) / (ratio - 1.0)
        if np.isfinite(better).all():
            effects.append(Effect(parameter, better, np.abs(narrow - wide)))
    return effects
