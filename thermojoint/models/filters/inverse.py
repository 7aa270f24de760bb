"""Inverse filters: temperatures to heat (Eqs. 3-6), for one source or several that interact.

The regularised transfer matrix from the sources to as many sensors is

    H_reg,ji(s) = K_i · I0(κ_i r<) · K0(κ_i r>) + δ_ij · s F_R,i(s),

with f_R = (A t + B t²) exp(-γ t) added to the step response of source i at its own sensor (Eq. 7).
Away from the source the Bessel part vanishes faster than any power of s, so H_reg -> diag(A)/s and

    G(s) = H_reg(s)^{-1} = slope s + constant + G_r(s),   slope -> diag(1/A),   G_r strictly proper.

G/(s + σ) is finite at both ends of the band; it is fitted by stable poles (relative error at every
frequency) and then multiplied by s + σ. A determines the noise gain: a change of one sample by e
changes the mean heat of that interval by e / (A Δt).

If H_reg has a zero in the right half plane its inverse is unstable; zeros are counted by the
argument principle beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.models.argument_principle import count_right_zeros
from thermojoint.models.filters.bank import Bank
from thermojoint.models.filters.pole_residue import Transfer, excited_band, fit_proper
from thermojoint.models.parameters import Regularisation, RingModel
from thermojoint.models.regularisation import transfer_contribution
from thermojoint.models.ring_source import transfer_function

#: The contour of the argument principle reaches this far beyond the fitted band.
_CONTOUR = 100.0


def regularised_transfer(
    rings: Sequence[Sequence[RingModel]], regularisations: Sequence[Regularisation]
) -> Transfer:
    """Return H_reg as a function of s.

    Parameters
    ----------
    rings : sequence of sequence of RingModel
        ``rings[i][j]``: source i to sensor j (Eq. 16); n × n.
    regularisations : sequence of Regularisation
        f_R of each source.

    Returns
    -------
    callable
        s, complex, shape (k,), to H_reg, K per unit, shape (k, n sensors, n sources).
    """

    def transfer(s: np.ndarray) -> np.ndarray:
        columns = [
            [transfer_function(s, m.K, m.a, m.alpha, m.r, m.r0) for m in row] for row in rings
        ]
        matrix = np.array(columns).transpose(2, 1, 0)
        for i, f in enumerate(regularisations):
            matrix[:, i, i] += transfer_contribution(s, f)
        return matrix

    return transfer


def inverse_bank(
    rings: Sequence[Sequence[RingModel]],
    regularisations: Sequence[Regularisation],
    dt_s: float,
    run_length_s: float,
    tolerance: float,
    what: str,
) -> Bank:
    """Return G = H_reg^{-1} (K to 1) as a bank of exponential states (Eqs. 3-6).

    Parameters
    ----------
    rings, regularisations
        As in `regularised_transfer`.
    dt_s, run_length_s : float
        Sampling interval and length of the runs, s.
    tolerance : float
        Relative error of G over the band of `excited_band`.
    what : str
        Name of the source or sources for error messages.

    Raises
    ------
    InputError
        A, γ or the number of sensors is unusable, or H_reg has zeros in the right half plane.
    ConvergenceError
        The poles do not reach the tolerance.
    """
    zeros = unstable_zeros(rings, regularisations, dt_s, run_length_s, what)
    if zeros:
        constants = "; ".join(f"A = {f.A:g}, gamma = {f.gamma:g}" for f in regularisations)
        raise InputError(
            f"{what}: the regularised model has {zeros} zeros in the right half plane, so its "
            f"inverse is unstable ({constants}); use a larger A of the sign of K, a smaller gamma, "
            "or a sensor nearer its source"
        )
    count = len(rings)
    transfer = regularised_transfer(rings, regularisations)
    sigma = _crossover(transfer, regularisations, what)

    def damped(s: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.inv(transfer(s)) / (s + sigma)[:, None, None])

    fit = fit_proper(damped, excited_band(dt_s, run_length_s), tolerance, what)
    # (s + σ)(w + Σ R/(s-p)) = w s + (σ w + Σ R) + Σ R (p + σ)/(s - p)
    weights = fit.weights
    gain = (weights * (fit.poles + sigma)[:, None, None]).transpose(1, 0, 2)
    modes = fit.poles.size
    return Bank(
        poles=np.repeat(fit.poles, count),
        drive=np.tile(np.eye(count), (modes, 1)),
        gain=gain.reshape(count, modes * count),
        double=np.zeros((count, modes * count), dtype=complex),
        constant=sigma * fit.constant + weights.sum(axis=0).real,
        slope=fit.constant,
        error=fit.error,
    )


def unstable_zeros(
    rings: Sequence[Sequence[RingModel]],
    regularisations: Sequence[Regularisation],
    dt_s: float,
    run_length_s: float,
    what: str,
) -> int:
    """Return the number of zeros of det H_reg in the right half plane; see `inverse_bank`.

    Raises
    ------
    InputError
        A, γ or the number of sensors is unusable, or the steady temperatures are dependent.
    ConvergenceError
        A zero lies on the imaginary axis.
    """
    count = len(rings)
    if any(len(row) != count for row in rings) or len(regularisations) != count:
        raise InputError(f"{what}: {count} sources need {count} sensors and regularisations each")
    for f in regularisations:
        if not (f.A != 0.0 and f.gamma > 0.0):
            raise InputError(
                f"{what}: regularisation A = {f.A:g}, gamma = {f.gamma:g}; A must not be zero and "
                "gamma must be positive, otherwise the inverse is not a function"
            )
    transfer = regularised_transfer(rings, regularisations)
    sigma = _crossover(transfer, regularisations, what)
    lowest, highest = excited_band(dt_s, run_length_s)

    # Multiplied by s + σ it is finite and non-zero at infinity, without a new zero on the right.
    def determinant(s: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.det((s + sigma)[:, None, None] * transfer(s)))

    return count_right_zeros(determinant, lowest, _CONTOUR * highest, what)


def _crossover(transfer: Transfer, regularisations: Sequence[Regularisation], what: str) -> float:
    """Return the frequency (1/s) where the inverse turns from its steady gain to s/A."""
    at_rest = transfer(np.zeros(1, dtype=complex))[0].real
    scale = np.prod(np.linalg.norm(at_rest, axis=0))
    if not abs(np.linalg.det(at_rest)) > 1e-12 * scale:
        raise InputError(
            f"{what}: the steady temperatures of the sources are not independent; "
            "move a sensor or change the distances"
        )
    steep = np.linalg.norm([1.0 / f.A for f in regularisations])
    return float(np.linalg.norm(np.linalg.inv(at_rest)) / steep)
