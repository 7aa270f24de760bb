"""The generalised thermal model (Eqs. 1-3) in closed form: a ring source on a convecting plate.

Eq. 2 integrates a product of Bessel functions over the wave number. By Weber's second exponential
integral, with x = alpha t, the response to an impulse of heat is K alpha / (2 x) · f(x), where

    f(x) = exp(-a x - (r - r0)² / 4 x) · I0e(r r0 / 2 x),      I0e(z) = exp(-z) I0(z),

so the step response is (K/2) ∫ f(x) dx/x from 0 to alpha t. The integrand is smooth and positive in
ln x and does not oscillate; it is integrated on Gauss-Legendre panels in ln x whose interpolants
are integrated exactly, so that one set of nodes serves all times.
In the Laplace domain the response is the product of two modified Bessel functions (Eq. 3).

Time runs from the start of the step; K is in kelvin per unit heat input, a in 1/m2, alpha in m2/s,
r and r0 in m.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre
from scipy.special import i0e, i1e, ive, kve

from thermojoint.artefacts.errors import InputError

#: Nodes of a panel and its width in ln x.
_NODES = 20
_WIDTH = 0.5
#: exp(-x) of a larger x is zero in double precision.
_UNDERFLOW = 745.0
#: Below min(x, r r0)/exp(this) even a source at the sensor, f = sqrt(x / π r r0), adds < 1e-12.
_HEAD = 56.0
#: Above this |argument| the Bessel functions are replaced by their asymptotic series.
_FAR = 1e5


def _antiderivative() -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss nodes and the matrix: values there to coefficients of the integral."""
    nodes, weights = legendre.leggauss(_NODES)
    degrees = np.arange(_NODES)
    to_series = (legendre.legvander(nodes, _NODES - 1) * weights[:, None]).T
    to_series *= (degrees + 0.5)[:, None]
    integral = legendre.legint(to_series, lbnd=-1.0, axis=0)
    return nodes, integral


_GAUSS, _TO_INTEGRAL = _antiderivative()


def check_parameters(K: float, a: float, alpha: float, r: float, r0: float) -> None:
    """Raise InputError unless the parameters are finite, a, alpha, r0 > 0 and r >= 0."""
    values = {"K": K, "a": a, "alpha": alpha, "r": r, "r0": r0}
    for name, value in values.items():
        if not np.isfinite(value):
            raise InputError(f"ring source: {name} = {value} is not finite; give a number")
    for name in ("a", "alpha", "r0"):
        if values[name] <= 0.0:
            raise InputError(f"ring source: {name} = {values[name]} must be positive")
    if r < 0.0:
        raise InputError(f"ring source: r = {r} is a distance; it must not be negative")


def _times(t: np.ndarray | float) -> np.ndarray:
    times = np.asarray(t, dtype=float)
    if not bool(np.isfinite(times).all()) or bool((times < 0.0).any()):
        raise InputError("ring source: times must be finite and not negative; the step starts at 0")
    return times


def _kernel(x: np.ndarray, a: float, r: float, r0: float) -> np.ndarray:
    """Return f(x) (module docstring), dimensionless, for x > 0 in m2."""
    return np.exp(-a * x - (r - r0) ** 2 / (4.0 * x)) * i0e(r * r0 / (2.0 * x))


def _kernel_slopes(x: np.ndarray, a: float, r: float, r0: float) -> tuple[np.ndarray, ...]:
    """Return f, df/da in m2 and df/dr in 1/m.

    I0e - I1e cancels for large arguments; its asymptotic series takes over there.
    """
    z = r * r0 / (2.0 * x)
    first = i0e(z)
    far = z > 1e3
    y = 1.0 / np.where(far, z, 1e3)
    series = first * y * (0.5 + y * (0.125 + y * (0.125 + y * (25 / 128 + y * 13 / 32))))
    difference = np.where(far, series, first - i1e(z))
    exponential = np.exp(-a * x - (r - r0) ** 2 / (4.0 * x))
    kernel = exponential * first
    return kernel, -x * kernel, exponential * ((r0 - r) * first - r0 * difference) / (2.0 * x)


def _cumulative(
    x: np.ndarray, r: float, r0: float, integrands: Callable[[np.ndarray], tuple[np.ndarray, ...]]
) -> list[np.ndarray]:
    """Return ∫ g(x') dx'/x' from 0 to each x for each g of `integrands`.

    Parameters
    ----------
    x : ndarray
        Upper limits, m2, any shape; 0 gives 0.
    r, r0 : float
        m; below x = (r - r0)²/(4·745) every integrand is zero.
    """
    flat = x.ravel()
    dead = (r - r0) ** 2 / (4.0 * _UNDERFLOW)
    alive = flat > dead
    if not bool(alive.any()):
        return [np.zeros(x.shape) for _ in integrands(np.ones(0))]
    upper = np.log(flat[alive])
    product = r * r0
    head = min(float(upper.min()), math.log(product)) - _HEAD if product > 0.0 else -math.inf
    start = max(head, math.log(dead) if dead > 0.0 else -math.inf)
    span = float(upper.max()) - start
    panels = max(1, int(np.ceil(span / _WIDTH)))
    width = span / panels
    nodes = np.exp(start + width * (np.arange(panels)[:, None] + (_GAUSS + 1.0) / 2.0))
    position = (upper - start) / width if width > 0.0 else np.zeros_like(upper)
    panel = np.minimum(position.astype(int), panels - 1)
    vander = legendre.legvander(2.0 * (position - panel) - 1.0, _NODES)
    out = []
    for values in integrands(nodes):
        series = (width / 2.0) * (values @ _TO_INTEGRAL.T)
        whole = series.sum(axis=1)
        before = np.concatenate(([0.0], np.cumsum(whole)[:-1]))
        part = np.zeros(flat.size)
        part[alive] = before[panel] + np.einsum("ij,ij->i", series[panel], vander)
        out.append(part.reshape(x.shape))
    return out


def step_response(
    t: np.ndarray | float, K: float, a: float, alpha: float, r: float, r0: float
) -> np.ndarray:
    """Return the temperature after a unit step of heat at t = 0 (Eq. 2), K per unit heat input.

    Parameters
    ----------
    t : array_like
        Times, s, >= 0, any shape and order.
    K, a, alpha, r, r0 : float
        As in `thermojoint.models.parameters.RingModel`.

    Returns
    -------
    ndarray
        Shaped as `t`.

    Raises
    ------
    InputError
        A parameter or a time is outside its range.
    """
    check_parameters(K, a, alpha, r, r0)
    x = alpha * _times(t)
    (integral,) = _cumulative(x, r, r0, lambda at: (_kernel(at, a, r, r0),))
    return 0.5 * K * integral


def step_response_gradient(
    t: np.ndarray | float, K: float, a: float, alpha: float, r: float, r0: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the `step_response` and its derivatives by K, a, alpha and r.

    The derivative by r jumps at r = r0, where the heat enters; there the mean of both sides is
    returned.

    Returns
    -------
    response : ndarray, shape t.shape
    gradient : ndarray, shape t.shape + (4,)
        By K, a, alpha, r, in this order.
    """
    check_parameters(K, a, alpha, r, r0)
    x = alpha * _times(t)
    unit, by_a, by_r = _cumulative(x, r, r0, lambda at: _kernel_slopes(at, a, r, r0))
    by_alpha = np.zeros_like(x)
    by_alpha[x > 0.0] = _kernel(x[x > 0.0], a, r, r0) / alpha
    gradient = 0.5 * np.stack([unit, K * by_a, K * by_alpha, K * by_r], axis=-1)
    return 0.5 * K * unit, gradient


def impulse_response(
    t: np.ndarray | float, K: float, a: float, alpha: float, r: float, r0: float
) -> np.ndarray:
    """Return the slope of the step response, K/s per unit heat input (Eq. 1 with a unit impulse).

    At t = 0 it is zero, unless r = r0, where it is infinite.
    """
    check_parameters(K, a, alpha, r, r0)
    times = _times(t)
    slope = np.full(times.shape, np.sign(K) * np.inf if r == r0 else 0.0)
    after = times > 0.0
    slope[after] = K * _kernel(alpha * times[after], a, r, r0) / (2.0 * times[after])
    return slope


def transfer_function(
    s: np.ndarray | complex, K: float, a: float, alpha: float, r: float, r0: float
) -> np.ndarray:
    """Return temperature over heat input in the Laplace domain, 1/G of Eq. 3, K per unit.

    K · I0(κ r<) · K0(κ r>) with κ = sqrt(a + s/alpha), r< = min(r, r0), r> = max(r, r0). The plane
    is cut along s <= -a alpha. At very large |s| it tends to zero without overflow.

    Parameters
    ----------
    s : array_like of complex
        Laplace variable, 1/s, any shape.
    K, a, alpha, r, r0 : float
        As in `thermojoint.models.parameters.RingModel`.

    Returns
    -------
    ndarray of complex, shape s.shape
    """
    check_parameters(K, a, alpha, r, r0)
    kappa = np.sqrt(a + np.asarray(s, dtype=complex) / alpha)
    inner, outer = min(r, r0), max(r, r0)
    near, far = kappa * inner, kappa * outer
    # ive scales by exp(-|Re|), kve by exp(+argument).
    scale = np.exp(near.real - far)
    tame_near, tame_far = np.abs(near) < _FAR, np.abs(far) < _FAR
    growing = np.where(
        tame_near,
        ive(0, np.where(tame_near, near, 1.0)),
        _growing_series(np.where(tame_near, _FAR, near)),
    )
    falling = np.where(
        tame_far,
        kve(0, np.where(tame_far, far, 1.0)),
        _falling_series(np.where(tame_far, _FAR, far)),
    )
    return K * growing * falling * scale


def _growing_series(z: np.ndarray) -> np.ndarray:
    """Return I0(z) exp(-Re z) for |z| >= 1e5 right of the cut; next term below 1e-15."""
    return (
        np.exp(1j * z.imag)
        / np.sqrt(2.0 * np.pi * z)
        * (1.0 + 1.0 / (8.0 * z) * (1 + 9 / (16 * z)))
    )


def _falling_series(z: np.ndarray) -> np.ndarray:
    """Return K0(z) exp(z) for |z| >= 1e5; next term below 1e-15."""
    return np.sqrt(np.pi / (2.0 * z)) * (1.0 - 1.0 / (8.0 * z) * (1 - 9 / (16 * z)))
