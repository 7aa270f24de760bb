"""Rational approximation of stable transfer functions, with poles that are stable by construction.

The transfer functions of the generalised model have a branch cut on the negative real axis and no
finite set of poles; over the band that a run can excite, some twenty poles reproduce them to 1e-7
and better. The poles are found by vector fitting (Gustavsen & Semlyen, IEEE Trans. Power Delivery
14, 1999; relaxed as in Gustavsen, ibid. 21, 2006; entries condensed one by one as in Deschrijver et
al., IEEE MWCL 18, 2008): linear least squares on the imaginary axis with real coefficients; a pole
that crosses the axis is mirrored back; all entries of a matrix share the poles. The result contains
the error; an error above the tolerance is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.models.filters.bank import Bank, simple_bank
from thermojoint.models.parameters import RingModel
from thermojoint.models.ring_source import transfer_function

Transfer = Callable[[np.ndarray], np.ndarray]

#: Trial numbers of poles, and rounds of relocation for each.
_ORDERS = (12, 16, 20, 24, 28, 32, 36, 40, 48, 56)
_ROUNDS = 6
#: A fit that misses its tolerance is used, with its error stated, up to this error.
_USABLE = 1e-3
#: Samples on the imaginary axis per decade; upper limit relative to the Nyquist rate, beyond which
#: linear interpolation still has a spectrum; lower limit relative to the run length.
_PER_DECADE = 60
_BEYOND = 30.0
_BELOW = 0.1
#: Intervals of a run at most: with ten times as many, rounding loses the slowest poles.
_MOST = 1e9


@dataclass(frozen=True, eq=False)
class PoleResidue:
    """constant + Σ_k residue_k / (s - p_k), conjugates understood."""

    #: Shape (m,): 1/s, Re < 0, Im >= 0.
    poles: np.ndarray
    #: Shape (m, n_out, n_in): of the pole with Im >= 0; a real pole's are real.
    residues: np.ndarray
    #: Shape (n_out, n_in): value at infinite frequency.
    constant: np.ndarray
    #: Largest relative error over the band.
    error: float
    #: Lowest and highest angular frequency of the fit, 1/s.
    band: tuple[float, float]

    @property
    def weights(self) -> np.ndarray:
        """Residues as the gains of a `Bank`: doubled where the conjugate is understood."""
        pair = np.where(self.poles.imag > 0.0, 2.0, 1.0)
        return self.residues * pair[:, None, None]


def excited_band(dt_s: float, run_length_s: float) -> tuple[float, float]:
    """Return the angular frequencies (1/s) that a run of this length and sampling excites.

    Raises
    ------
    InputError
        The sampling interval or the run length is not positive, or the run has only one sample or
        more than `_MOST` of them.
    """
    if not (0.0 < dt_s < run_length_s < np.inf and run_length_s <= _MOST * dt_s):
        raise InputError(
            f"sampling interval {dt_s:g} s and run length {run_length_s:g} s do not make a run; "
            f"give 0 < interval < length, and a length of at most {_MOST:.0e} intervals"
        )
    return _BELOW / run_length_s, _BEYOND * np.pi / dt_s


def fit_strictly_proper(
    transfer: Transfer, band: tuple[float, float], tolerance: float, what: str
) -> PoleResidue:
    """Fit a transfer function that vanishes at infinity; errors relative to its largest value.

    Parameters
    ----------
    transfer : callable
        s, complex, shape (k,), to values of shape (k, n_out, n_in); real on the real axis, analytic
        for Re s >= 0.
    band : tuple of float
        Lowest and highest angular frequency, 1/s.
    tolerance : float
        Largest accepted error.
    what : str
        Name of the function for error messages.

    Raises
    ------
    ConvergenceError
        No number of poles reaches the tolerance.
    """
    return _fit(transfer, False, band, tolerance, what)


def fit_proper(
    transfer: Transfer, band: tuple[float, float], tolerance: float, what: str
) -> PoleResidue:
    """Fit a transfer function that is finite at infinity; errors relative at every frequency.

    Parameters and errors as in `fit_strictly_proper`.
    """
    return _fit(transfer, True, band, tolerance, what)


def direct_bank(
    ring: RingModel, dt_s: float, run_length_s: float, tolerance: float, what: str
) -> Bank:
    """Return heat to temperature (Eqs. 1-3) as a bank of exponential states.

    Parameters
    ----------
    ring : RingModel
    dt_s, run_length_s : float
        Sampling interval and length of the runs, s.
    tolerance : float
        Error over the band, relative to the largest value of the transfer function.
    what : str
        Name of the function for error messages.
    """

    def transfer(s: np.ndarray) -> np.ndarray:
        value = transfer_function(s, ring.K, ring.a, ring.alpha, ring.r, ring.r0)
        return value[:, None, None]

    fit = fit_strictly_proper(transfer, excited_band(dt_s, run_length_s), tolerance, what)
    return simple_bank(fit.poles, fit.weights[:, 0, 0])


def _sample(
    transfer: Transfer, band: tuple[float, float], what: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return log-spaced angular frequencies over `band` and the values there."""
    count = int(np.ceil(_PER_DECADE * np.log10(band[1] / band[0]))) + 1
    frequencies = np.geomspace(*band, count)
    values = np.asarray(transfer(1j * frequencies))
    if not np.isfinite(values).all() or not (np.abs(values).max() > 0.0):
        raise InputError(
            f"{what}: the transfer function is zero or not finite between {band[0]:.3g} and "
            f"{band[1]:.3g} 1/s; check the model's parameters"
        )
    return frequencies, values


def _fit(
    transfer: Transfer, proper: bool, band: tuple[float, float], tolerance: float, what: str
) -> PoleResidue:
    """Increase the number of poles until the weighted error is below `tolerance`; else the best."""
    frequencies, values = _sample(transfer, band, what)
    size = np.linalg.norm(values, axis=(1, 2))
    weight = 1.0 / size if proper else np.full(frequencies.size, 1.0 / size.max())
    s = 1j * frequencies
    flat = values.reshape(frequencies.size, -1)
    _, rows, columns = values.shape
    best: PoleResidue | None = None
    for order in _ORDERS:
        poles = -np.geomspace(band[0] / _BELOW, band[1], order).astype(complex)
        for _ in range(_ROUNDS):
            poles = _relocated(s, flat, poles, weight, proper)
            fitted, coefficients = _residues(s, flat, poles, weight, proper)
            miss = float((np.linalg.norm(fitted - flat, axis=1) * weight).max())
            if best is None or miss < best.error:
                residues, constant = _unpack(coefficients, poles, proper)
                best = PoleResidue(
                    poles,
                    residues.reshape(-1, rows, columns),
                    constant.reshape(rows, columns),
                    miss,
                    band,
                )
            if best.error <= tolerance:
                return best
    if best is not None and best.error <= _USABLE:
        return best
    reached = np.inf if best is None else best.error
    raise ConvergenceError(
        f"{what}: {_ORDERS[-1]} poles reach a relative error of {reached:.2g} between "
        f"{band[0]:.3g} and {band[1]:.3g} 1/s, above {_USABLE:.2g}; sample more slowly"
    )


def _basis(s: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Return partial fractions with real coefficients; a pair has two columns. Shape (k, N)."""
    columns = []
    for pole in poles:
        below = 1.0 / (s - pole)
        if pole.imag == 0.0:
            columns.append(below)
        else:
            above = 1.0 / (s - pole.conjugate())
            columns += [below + above, 1j * (below - above)]
    return np.stack(columns, axis=1)


def _realified(matrix: np.ndarray) -> np.ndarray:
    return np.concatenate((matrix.real, matrix.imag))


def _least_squares(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve by least squares with the columns scaled to length one."""
    length = np.linalg.norm(matrix, axis=0)
    solution = np.linalg.lstsq(matrix / length, right, rcond=1e-15)[0]
    return np.asarray((solution.T / length).T)


def _residues(
    s: np.ndarray, values: np.ndarray, poles: np.ndarray, weight: np.ndarray, proper: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the fitted values and the real coefficients, shape (N or N + 1, entries)."""
    basis = _basis(s, poles)
    if proper:
        basis = np.column_stack((basis, np.ones(s.size)))
    matrix = _realified(basis * weight[:, None])
    coefficients = _least_squares(matrix, _realified(values * weight[:, None]))
    return basis @ coefficients, coefficients


def _relocated(
    s: np.ndarray, values: np.ndarray, poles: np.ndarray, weight: np.ndarray, proper: bool
) -> np.ndarray:
    """Return the zeros of the relaxed scaling function: the next poles, mirrored if unstable."""
    basis = _basis(s, poles)
    scaling = np.column_stack((basis, np.ones(s.size)))
    own = scaling if proper else basis
    rows: list[np.ndarray] = []
    for entry in values.T:
        block = np.column_stack((own, -entry[:, None] * scaling)) * weight[:, None]
        upper = np.asarray(np.linalg.qr(_realified(block), mode="r"))
        rows.append(upper[own.shape[1] :, own.shape[1] :])
    # Relaxation: the mean real part of the scaling function is one, so it cannot vanish.
    size = np.linalg.norm(values * weight[:, None]) / s.size
    rows.append(size * scaling.real.sum(axis=0)[None, :])
    matrix = np.concatenate(rows)
    right = np.zeros(matrix.shape[0])
    right[-1] = size * s.size
    solution = _least_squares(matrix, right)
    companion, drive = _state_matrix(poles)
    zeros = np.linalg.eigvals(companion - np.outer(drive, solution[:-1]) / solution[-1])
    zeros = zeros[zeros.imag >= 0.0].astype(complex)
    # A zero on the axis cannot be mirrored; it is moved inwards in proportion to its magnitude.
    inward = np.maximum(np.abs(zeros.real), 1e-6 * np.abs(zeros))
    return -inward + 1j * zeros.imag


def _state_matrix(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the real state matrix and input vector whose transfer is `_basis`."""
    size = int(poles.size + (poles.imag > 0.0).sum())
    matrix, drive = np.zeros((size, size)), np.zeros(size)
    row = 0
    for pole in poles:
        if pole.imag == 0.0:
            matrix[row, row], drive[row] = pole.real, 1.0
            row += 1
        else:
            matrix[row : row + 2, row : row + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
            drive[row] = 2.0
            row += 2
    return matrix, drive


def _unpack(
    coefficients: np.ndarray, poles: np.ndarray, proper: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return complex residues, shape (m, entries), and the constant, shape (entries,)."""
    residues = np.empty((poles.size, coefficients.shape[1]), dtype=complex)
    row = 0
    for k, pole in enumerate(poles):
        residues[k] = coefficients[row]
        row += 1
        if pole.imag > 0.0:
            residues[k] += 1j * coefficients[row]
            row += 1
    constant = coefficients[-1] if proper else np.zeros(coefficients.shape[1])
    return residues, constant
