"""Count of right-half-plane zeros by the argument principle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermojoint.artefacts.errors import ConvergenceError

_POINTS = 2000
_REFINEMENTS = 4
#: Largest change of phase between two points, rad; otherwise the grid is refined.
_TURN = np.pi / 4.0


def count_right_zeros(
    function: Callable[[np.ndarray], np.ndarray], lowest: float, radius: float, what: str
) -> int:
    """Count the zeros of an analytic function with Re s > 0, |s| < radius (argument principle).

    The function is real on the real axis, so the upper half of the contour is enough: up the
    imaginary axis and back along the arc to the positive real axis, the phase turns by -π per zero.

    Parameters
    ----------
    function : callable
        s, complex, shape (k,), to values, shape (k,).
    lowest : float
        Lowest sampled frequency above zero, 1/s.
    radius : float
        Radius of the contour, 1/s.
    what : str
        Name of the function for the error message.

    Raises
    ------
    ConvergenceError
        The phase cannot be tracked, since there is a zero on the contour.
    """
    points = _POINTS
    for _ in range(_REFINEMENTS):
        axis = np.concatenate(([0.0], np.geomspace(lowest, radius, points)))
        arc = radius * np.exp(1j * np.linspace(np.pi / 2.0, 0.0, points // 4))
        value = function(np.concatenate((1j * axis, arc[1:])))
        turns = np.angle(value[1:] / value[:-1]) if (value != 0.0).all() else np.array([np.inf])
        if np.abs(turns).max() < _TURN:
            return round(-float(turns.sum()) / np.pi)
        points *= 4
    raise ConvergenceError(
        f"{what}: the regularised model has a zero on the imaginary axis, so its inverse is not "
        "stable; change A or gamma"
    )
