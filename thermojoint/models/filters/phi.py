"""φ functions: propagation of an exponential state under an input polynomial in time.

    φ_0(z) = exp(z),   φ_{k+1}(z) = (φ_k(z) - 1/k!) / z,   z = p Δt,

and their divided differences, for an input that is itself exponential.
"""

from __future__ import annotations

import numpy as np

#: Below this |z| the φ functions come from their series, above it from the recursion.
NEAR = 2.0
TERMS = 28
_INVERSE_FACTORIALS = (1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0)


def phi_functions(z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return φ_0 ... φ_4 of complex `z` (Re z <= 0), each of z's shape, to rounding error."""
    near = np.abs(z) < NEAR
    small = np.where(near, z, 0.0)
    # φ_4 = Σ z^k / (k+4)!, by Horner; the lower ones follow without cancellation.
    series = np.zeros_like(small)
    for k in range(TERMS, 0, -1):
        series = (series + 1.0) * small / (k + 4.0)
    low = [(series + 1.0) / 24.0]
    for k in (3, 2, 1, 0):
        low.insert(0, small * low[0] + _INVERSE_FACTORIALS[k])
    large = np.where(near, 1.0, z)
    # exp underflows to zero far down the left half plane; that zero is the right value.
    with np.errstate(under="ignore"):
        high = [np.exp(large)]
    for k in range(4):
        high.append((high[k] - _INVERSE_FACTORIALS[k]) / large)
    return tuple(np.where(near, a, b) for a, b in zip(low, high, strict=True))


def divided_differences(at: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return φ_0[at, z] and φ_1[at, z] to rounding error, however near the two are.

    φ_0[μ, z] = exp(μ) φ_1(z - μ), the exponent being the larger of the two; from z φ_1 = φ_0 - 1
    follows φ_1[μ, z] = (φ_0[μ, z] - φ_1(μ))/z, and near zero both come from the series of φ_1.

    Parameters
    ----------
    at : float
        Not positive.
    z : ndarray of complex, shape (m,)
        Re z <= 0.
    """
    direct, mean = np.empty_like(z), np.empty_like(z)
    for k, point in enumerate(z):
        larger, smaller = (at + 0j, point) if at >= point.real else (point, at + 0j)
        direct[k] = np.exp(larger) * phi_functions(np.array([smaller - larger]))[1][0]
        far, near = (point, at + 0j) if abs(point) >= abs(at) else (at + 0j, point)
        if abs(far) >= NEAR:
            mean[k] = (direct[k] - phi_functions(np.array([near]))[1][0]) / far
            continue
        # Σ (Σ_j μ^j z^(k-j)) / (k+2)!
        power = total = part = 0.5 + 0j
        for n in range(1, TERMS):
            power = power * near / (n + 2)
            part = part * far / (n + 2) + power
            total = total + part
        mean[k] = total
    return direct, mean
