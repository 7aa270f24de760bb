"""Eq. 2 in closed form against the integral of Bessel functions as the paper prints it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.integrate import quad
from scipy.special import i0, j0, k0

from benchmarks.performance.timing import Row, paired
from thermojoint.models.ring_source import step_response

#: Table 1 of the paper: K = 1, a, alpha, r, r0.
PARAMETERS = (1.0, 3.20, 2.12e-4, 0.19, 0.12)
TIMES = 2.0 * np.arange(1, 1051)
#: Truncation error of the printed integral, relative to its value.
ACCURACY = 1e-10


def printed_integral(time: float, accuracy: float = ACCURACY) -> float:
    """Eq. 2 as printed, by Gauss-Legendre panels of half an oscillation each.

    The integrand falls only as 1/b^2 while it oscillates, with the slow frequency r - r0 beside the
    fast one. The range ends where integration by parts bounds the rest by `accuracy` of the value.
    """
    K, a, alpha, r, r0 = PARAMETERS
    rest = 1.0 / (np.pi * np.sqrt(r * r0) * abs(r - r0))
    end = np.sqrt(rest / (accuracy * steady_value()))
    nodes, weights = leggauss(10)
    half = np.pi / (r + r0)
    # The exponential is steep where b is small: finer panels there.
    near = np.arange(0.0, 10.0 * half, half / 16.0)
    total = 0.0
    # In blocks of panels: all nodes at once would not fit into a cache.
    for starts, width in [
        (near, half / 16.0),
        *((block, half) for block in np.array_split(np.arange(10.0 * half, end, half), 50)),
    ]:
        b = starts[:, None] + 0.5 * width * (1.0 + nodes)
        smooth = b / (b * b + a) * -np.expm1(-(a + b * b) * alpha * time)
        total += 0.5 * width * float(np.sum(smooth * j0(b * r) * j0(b * r0) * weights))
    return K * total


def subtracted_integral(time: float, tolerance: float = 1e-13) -> float:
    """Eq. 2 with its steady value taken out: what is left falls as a Gaussian."""
    K, a, alpha, r, r0 = PARAMETERS

    def lacking(b: float) -> float:
        decay = np.exp(-(a + b * b) * alpha * time)
        return b * j0(b * r) * j0(b * r0) * decay / (a + b * b)

    end = np.sqrt(36.0 / (alpha * time))
    value, _ = quad(lacking, 0.0, end, epsabs=tolerance, epsrel=tolerance, limit=2000)
    return steady_value() - K * value


def steady_value() -> float:
    """Return the steady value of Eq. 2, a product of modified Bessel functions."""
    K, a, _, r, r0 = PARAMETERS
    root = np.sqrt(a)
    return float(K * i0(root * min(r, r0)) * k0(root * max(r, r0)))


def rows(repeats: int = 5, accuracy: float = ACCURACY) -> Iterator[Row]:
    """Yield the rows of Eq. 2: 1050 samples of a step response."""
    found = step_response(TIMES, *PARAMETERS)
    size = float(np.abs(found).max())
    integrals: dict[str, tuple[Callable[[float], float], int, str]] = {
        "eq2-vs-quadrature": (
            partial(printed_integral, accuracy=accuracy),
            210,
            "the Bessel product as printed",
        ),
        "eq2-vs-subtracted": (
            subtracted_integral,
            10,
            "the same with the steady value taken out by hand, adaptive",
        ),
    }
    for name, (integral, every, what) in integrals.items():
        few = TIMES[::every]
        exact = np.array([integral(t) for t in few])
        error = float(np.abs(found[::every] - exact).max()) / size
        ours, other, ratio = paired(
            lambda: step_response(TIMES, *PARAMETERS), partial(_each, integral, few), repeats
        )
        scale = TIMES.size / few.size
        yield Row(
            name,
            ours,
            other * scale,
            ratio * scale,
            "s",
            f"a step response at {TIMES.size} times; {what}, timed at {few.size} of them and "
            f"scaled; largest difference {error:.1e} of the largest value; median of {repeats}",
        )


def _each(integral: Callable[[float], float], times: np.ndarray) -> list[float]:
    return [integral(time) for time in times]
