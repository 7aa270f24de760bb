"""The generalised deformation models, Eq. 8 (three rates) and Eq. 18 (four rates).

Step response C (1 - exp(-c t)) + D (1 - exp(-d t)) + E t exp(-e t) [+ F t exp(-f t)]: zero at
t = 0 for any parameters. Given the rates it is linear in C, D, E, F, which multiply the columns of
`basis`. Rates are fitted in logarithms, so derivatives are with respect to ln(rate).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.models.parameters import DeformationModel

#: Number of exponential terms (C, D); the others are t exp(-rate t).
_EXPONENTIALS = 2


def check_rates(rates: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the rates (1/s) as an array; InputError unless three or four, finite and positive."""
    values = np.asarray(rates, dtype=float)
    if values.shape not in ((3,), (4,)):
        raise InputError(
            f"deformation model: {values.size} rates; Eq. 8 has three (c, d, e), Eq. 18 four"
        )
    if not bool((np.isfinite(values) & (values > 0.0)).all()):
        raise InputError(f"deformation model: rates {values.tolist()} must be positive and finite")
    return values


def basis(t: np.ndarray, rates: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns that C, D, E [, F] multiply and their derivatives by ln(rate).

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s, >= 0.
    rates : sequence of 3 or 4 floats
        c, d, e [, f], 1/s.

    Returns
    -------
    columns : ndarray, shape (n, p)
        p = len(rates). The first two are dimensionless, the others in s.
    slopes : ndarray, shape (n, p)
        Of each column by the logarithm of its own rate; the others do not change it.
    """
    rate = check_rates(rates)
    phase = np.multiply.outer(np.asarray(t, dtype=float), rate)
    decay = np.exp(-phase)
    columns = np.empty_like(phase)
    slopes = np.empty_like(phase)
    first, second = slice(0, _EXPONENTIALS), slice(_EXPONENTIALS, None)
    columns[:, first] = -np.expm1(-phase[:, first])
    slopes[:, first] = phase[:, first] * decay[:, first]
    columns[:, second] = phase[:, second] / rate[second] * decay[:, second]
    slopes[:, second] = -phase[:, second] * columns[:, second]
    return columns, slopes


def model_from(
    coefficients: Sequence[float] | np.ndarray, rates: Sequence[float] | np.ndarray
) -> DeformationModel:
    """Return the model with coefficients (C, D, E [, F]) in m, m/s and rates (c, d, e [, f])."""
    C, D, E, *more = (float(value) for value in coefficients)
    c, d, e, *last = (float(value) for value in check_rates(rates))
    if len(more) != len(last):
        raise InputError("deformation model: as many coefficients as rates are needed")
    return DeformationModel(C, D, E, c, d, e, *more, *last)


def step_response(t: np.ndarray | float, model: DeformationModel) -> np.ndarray:
    """Return the displacement after a unit step of heat (Eqs. 8 and 18), m per unit, like `t`."""
    at = np.asarray(t, dtype=float)
    m = model
    return (
        -m.C * np.expm1(-m.c * at)
        - m.D * np.expm1(-m.d * at)
        + at * (m.E * np.exp(-m.e * at) + m.F * np.exp(-m.f * at))
    )
