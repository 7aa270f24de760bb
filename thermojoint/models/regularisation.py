"""The regularisation function of the inverse problem (Eq. 7) and the rule for its parameters.

f_R(t) = (A t + B t2) exp(-gamma t) is added to the step response before it is inverted. At a
distance from the source that response starts flatter than any power of t (a delay), so its inverse
grows faster than any power of s; with f_R the response starts as A t and the inverse grows as s/A.

The rule (`choose_regularisation`)
1. A is the largest slope of the step response, so that the regularised response starts with the
   largest slope of the true one. 1/A is the noise gain.
2. B = -A gamma / 2, so that the integral of f_R over all time is zero. f_R then adds
   A s2 / (s + gamma)3 to the transfer function, which biases neither a constant nor a ramp of heat.
   f_R is positive until 2/gamma and negative after.
3. gamma starts at 2/t_A, with t_A the time of the largest slope, so that f_R bridges the delay.
   gamma is reduced in steps, to about 1/(2 t_A), until the two parts of the transfer function
   nowhere cancel by more than half and it has no zero in the right half plane, which would make the
   inverse unstable (`thermojoint.models.argument_principle`).
4. With a long delay and strong convection no such gamma may exist. Then A is raised by half and
   step 3 repeated: a larger A responds later, with less noise.
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from scipy.optimize import minimize_scalar

from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.models import ring_source
from thermojoint.models.argument_principle import count_right_zeros
from thermojoint.models.parameters import Regularisation, RingModel

#: Trial values of gamma · t_A, largest first, and of the factor on A.
_GAMMAS = tuple(2.0 * 0.85**k for k in range(9))
_RAISES = tuple(1.5**k for k in range(10))
#: The smallest |H + s F_R| allowed, relative to the larger of the two parts.
_MARGIN = 0.5
#: Points of the frequency grid.
_POINTS = 4000


def transfer_contribution(s: np.ndarray | complex, regularisation: Regularisation) -> np.ndarray:
    """Return s F_R(s) = s (A/(s+gamma)2 + 2B/(s+gamma)3), K per unit heat input, shaped as `s`.

    Contribution of f_R to temperature over heat input; A/s at large s.
    """
    z = np.asarray(s, dtype=complex)
    m = regularisation
    pole = z + m.gamma
    return z / pole * (m.A + 2.0 * m.B / pole) / pole


def steepest_rise(ring: RingModel) -> tuple[float, float]:
    """Return time (s) and value (K/s per unit, signed) of the step response's largest slope.

    Raises
    ------
    InputError
        r = r0: the slope is infinite at t = 0.
    """
    delay = (ring.r - ring.r0) ** 2 / 4.0
    if delay == 0.0:
        raise InputError("ring source: r = r0 has no steepest rise; it starts with infinite slope")

    def falling(log_x: float) -> float:
        time = np.exp(log_x) / ring.alpha
        return -abs(float(ring_source.impulse_response(time, **asdict(ring)))) / scale

    # A distant ring is steepest at `delay`, a line at 2·delay, both earlier with convection.
    scale = abs(float(ring_source.impulse_response(delay / ring.alpha, **asdict(ring))))
    if scale == 0.0:
        raise InputError("ring source: the response is zero; K must not be 0, nor a or r so large")
    optimum = minimize_scalar(
        falling,
        bounds=(np.log(delay) - 12.0, np.log(delay) + 1.0),
        method="bounded",
        options={"xatol": 1e-9},
    )
    time = float(np.exp(optimum.x)) / ring.alpha
    return time, float(ring_source.impulse_response(time, **asdict(ring)))


def _frequencies(ring: RingModel, regularisation: Regularisation) -> np.ndarray:
    """Return angular frequencies, rad/s: 0, then from below all poles to where A/s dominates."""
    slow = 1e-4 * min(ring.a * ring.alpha, regularisation.gamma)
    fast = 1e4 * regularisation.gamma
    if ring.r != ring.r0:
        fast = max(fast, 2.0 * ring.alpha * (40.0 / (ring.r - ring.r0)) ** 2)
    return np.concatenate(([0.0], np.geomspace(slow, fast, _POINTS)))


def right_half_plane_zeros(ring: RingModel, regularisation: Regularisation) -> int | None:
    """Return the number of zeros of H(s) + s F_R(s) with Re s > 0; None if one is near the axis.

    Multiplied by s + gamma it has no poles there and tends to A on the large arc (to sqrt(s) if
    r = r0).
    """
    _, lowest, *_, highest = _frequencies(ring, regularisation)

    def function(s: np.ndarray) -> np.ndarray:
        total = ring_source.transfer_function(s, **asdict(ring))
        return (total + transfer_contribution(s, regularisation)) * (s + regularisation.gamma)

    try:
        return count_right_zeros(function, lowest, highest, "regularised model")
    except ConvergenceError:
        return None


def cancellation(ring: RingModel, regularisation: Regularisation) -> float:
    """Return the smallest |H + s F_R| / max(|H|, |s F_R|) on the imaginary axis: 1 is none."""
    s = 1j * _frequencies(ring, regularisation)
    own = ring_source.transfer_function(s, **asdict(ring))
    added = transfer_contribution(s, regularisation)
    return float((np.abs(own + added) / np.maximum(np.abs(own), np.abs(added))).min())


def choose_regularisation(ring: RingModel, interval: float) -> Regularisation:
    """Return A, B and gamma by the rule in the module docstring.

    Parameters
    ----------
    ring : RingModel
        The calibrated thermal model; a negative gain gives negative A.
    interval : float
        Sampling interval, s. Used only at r = r0, where the slope is infinite at t = 0: there A is
        the slope at `interval`, and gamma starts at 2/interval.

    Raises
    ------
    InputError
        A parameter is outside its range.
    ConvergenceError
        No trial value gives a stable inverse.
    """
    if not interval > 0.0 or not np.isfinite(interval):
        raise InputError(f"regularisation: interval = {interval} s must be positive")
    if ring.r == ring.r0:
        time = interval
        slope = float(ring_source.impulse_response(time, **asdict(ring)))
    else:
        time, slope = steepest_rise(ring)
    for raised in _RAISES:
        for scaled in _GAMMAS:
            A, gamma = raised * slope, scaled / time
            chosen = Regularisation(A=A, B=-0.5 * A * gamma, gamma=gamma)
            if cancellation(ring, chosen) >= _MARGIN and right_half_plane_zeros(ring, chosen) == 0:
                return chosen
    raise ConvergenceError(
        f"regularisation: no trial value gives a stable inverse of {ring}; "
        "choose a sensor nearer to the source"
    )
