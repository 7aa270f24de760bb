"""Banks of exponential states, advanced exactly between unevenly spaced samples.

A bank is a transfer matrix in modal form,

    y(s) = [slope s + constant + Σ_k (gain_k / (s - p_k) + double_k / (s - p_k)²) drive_k] u(s),

every pole in the open left half plane; of a conjugate pair only the pole with Im >= 0 is kept and
y is the real part. Between two samples u is either the straight line through them or a constant.
In both cases the states at the end of the interval are known in closed form
(`thermojoint.models.filters.phi`), so there is no numerical integration, and a gap in the data is
one long interval. The cost of a sample does not depend on the length of the run.

A bank may leak: its inputs then pass a first-order high-pass s/(s + λ) with its own states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import fsum

import numpy as np
from scipy.linalg import block_diag

from thermojoint.artefacts.errors import InputError
from thermojoint.models.filters.phi import divided_differences, phi_functions


@dataclass(frozen=True, eq=False)
class Bank:
    """A stable linear system with ``n_in`` inputs, ``n_out`` outputs and ``m`` modes."""

    #: Shape (m,): p_k in 1/s, Re < 0, Im >= 0 (the conjugate is understood).
    poles: np.ndarray
    #: Shape (m, n_in): weight of each input in each mode.
    drive: np.ndarray
    #: Shape (n_out, m): coefficients of 1/(s - p_k) and 1/(s - p_k)²; the output is the real part
    #: of the sum, so a pair with residues R and conj(R) has gain 2 R.
    gain: np.ndarray
    double: np.ndarray
    #: Shape (n_out, n_in): coefficients of 1 and of s.
    constant: np.ndarray
    slope: np.ndarray
    #: λ of the high-pass s/(s + λ) at the inputs, 1/s; 0 for none.
    leak: float = 0.0
    #: Largest relative error if the bank is a rational approximation; 0 for an exact bank.
    error: float = 0.0

    def __post_init__(self) -> None:
        unstable = ~(self.poles.real < 0.0)
        if unstable.any():
            worst = self.poles[unstable][0]
            raise InputError(
                f"a bank of exponential states has the pole {worst:.4g} 1/s, which is not stable; "
                "every rate must be positive"
            )

    @property
    def n_state(self) -> int:
        """Length of the real state vector."""
        pair = self.poles.imag > 0.0
        twice = self._has_double()
        leaky = self.constant.shape[1] if self.leak else 0
        return int(self.poles.size + pair.sum() + twice.sum() + (pair & twice).sum() + leaky)

    def _has_double(self) -> np.ndarray:
        return np.asarray((self.double != 0.0).any(axis=0))

    @property
    def at_rest(self) -> np.ndarray:
        """Response to constant inputs without leak, (n_out, n_in); no double poles.

        Terms 100 000 times larger than their sum cancel. They are summed exactly, so that the
        result is the same on every processor and in every exported program.
        """
        terms = (self.gain / -self.poles).real[:, :, None] * self.drive
        sums = [[fsum(column) for column in term.T] for term in terms]
        return self.constant + np.array(sums).reshape(self.constant.shape)

    def transfer(self, s: np.ndarray) -> np.ndarray:
        """Return the transfer matrix at `s` (complex, shape (k,)); shape (k, n_out, n_in)."""
        s = np.asarray(s, dtype=complex)[:, None, None]
        below, above = self.poles, self.poles.conj()
        modal = 0.5 * (
            self.gain / (s - below)
            + self.double / (s - below) ** 2
            + self.gain.conj() / (s - above)
            + self.double.conj() / (s - above) ** 2
        )
        passed = s / (s + self.leak) if self.leak else 1.0
        return (modal @ self.drive + self.constant + s * self.slope) * passed


@dataclass(frozen=True, eq=False)
class Interval:
    """A bank over one interval, as real matrices; ``N`` states, u from u0 to u1 in a straight line.

    x1 = advance x0 + old u0 + new u1. The output at the end (left limit, where the slope of u is
    that of this interval) is end x1 + end_old u0 + end_new u1; its mean over the interval is
    mean x0 + mean_old u0 + mean_new u1. Where u is constant, u0 = u1.
    """

    advance: np.ndarray
    old: np.ndarray
    new: np.ndarray
    end: np.ndarray
    end_old: np.ndarray
    end_new: np.ndarray
    mean: np.ndarray
    mean_old: np.ndarray
    mean_new: np.ndarray


@lru_cache(maxsize=256)
def over_interval(bank: Bank, dt: float) -> Interval:
    """Return the matrices of `bank` over an interval of `dt` seconds (dt > 0).

    A double pole's second state obeys y' = p y + x, so it is the derivative of x with respect to p:
    φ_k' = φ_k - k φ_{k+1}.
    """
    if bank.leak:
        return _over_leaking_interval(bank, dt)
    phi0, phi1, phi2, phi3, phi4 = phi_functions(bank.poles * dt)
    twice = np.flatnonzero(bank._has_double())
    slope1, slope2, slope3 = phi1 - phi2, phi2 - 2.0 * phi3, phi3 - 3.0 * phi4

    def chain(head: np.ndarray, tail: np.ndarray) -> np.ndarray:
        return np.concatenate((head, tail[twice]))

    modes = bank.poles.size
    complex_poles = chain(bank.poles, bank.poles)
    pair = np.flatnonzero(complex_poles.imag > 0.0)
    total = complex_poles.size
    basis = np.zeros((total, total + pair.size), dtype=complex)
    basis[:, :total] = np.eye(total)
    basis[pair, total + np.arange(pair.size)] = 1j

    def carried(diagonal: np.ndarray, link: np.ndarray) -> np.ndarray:
        """Return the map from the real state to complex modes: diagonal, plus head to tail."""
        image = chain(diagonal, diagonal)[:, None] * basis
        image[modes:] += (dt * link[twice])[:, None] * basis[twice]
        return image

    def real(image: np.ndarray) -> np.ndarray:
        return np.concatenate((image.real, image.imag[pair]))

    drive = np.concatenate((bank.drive, bank.drive[twice]))
    ramp = chain(dt * phi2, dt * dt * slope2)[:, None] * drive
    flat = chain(dt * phi1, dt * dt * slope1)[:, None] * drive
    mean_ramp = chain(dt * phi3, dt * dt * slope3)[:, None] * drive
    gains = np.concatenate((bank.gain, bank.double[:, twice]), axis=1)
    rate = bank.slope / dt
    return Interval(
        advance=real(carried(phi0, phi0)),
        old=real(flat - ramp),
        new=real(ramp),
        end=(gains @ basis).real,
        end_old=-rate,
        end_new=bank.constant + rate,
        mean=(gains @ carried(phi1, slope1)).real,
        mean_old=(gains @ (ramp - mean_ramp)).real + 0.5 * bank.constant - rate,
        mean_new=(gains @ mean_ramp).real + 0.5 * bank.constant + rate,
    )


def _over_leaking_interval(bank: Bank, dt: float) -> Interval:
    """Return the matrices of a leaking bank; u must be continuous.

    w' = -λ w + u' with u' constant, hence w' = exp(-λ t) c, c = u' - λ w0. With 1/(s - p) =
    -1/p + s / (p (s - p)) the modes are v' = p v + w'/p: their residues, which nearly cancel, only
    act on changes. The states are (v, w).
    """
    at, z = -bank.leak * dt, bank.poles * dt
    phi0, phi1 = phi_functions(z)[:2]
    _, flow, mean_flow = (
        float(phi_function.real[0]) for phi_function in phi_functions(np.array([at + 0j]))[:3]
    )
    direct, mean = divided_differences(at, z)
    pair = np.flatnonzero(bank.poles.imag > 0.0)
    basis = np.concatenate((np.eye(z.size), 1j * np.eye(z.size)[:, pair]), axis=1)
    inputs = bank.constant.shape[1]
    leaks, nothing = np.eye(inputs), np.zeros((basis.shape[1], inputs))
    drive = bank.drive / bank.poles[:, None]
    rest = bank.at_rest

    def real(image: np.ndarray) -> np.ndarray:
        return np.concatenate((image.real, image.imag[pair]))

    # Effect of c on the states, and on the mean of the outputs.
    change = np.concatenate((real(dt * direct[:, None] * drive), dt * flow * leaks))
    mean_change = (bank.gain @ (dt * mean[:, None] * drive)).real
    mean_change += dt * mean_flow * rest + flow * bank.slope
    advance = np.block([[real(phi0[:, None] * basis), nothing], [nothing.T, leaks]])
    advance[:, -inputs:] -= bank.leak * change
    held = rest - bank.leak * mean_change
    # At the end u' - λ w is w'.
    end = ((bank.gain @ basis).real, rest - bank.leak * bank.slope)
    return Interval(
        advance=advance,
        old=-change / dt,
        new=change / dt,
        end=np.concatenate(end, axis=1),
        end_old=-bank.slope / dt,
        end_new=bank.slope / dt,
        mean=np.concatenate(((bank.gain @ (phi1[:, None] * basis)).real, held), axis=1),
        mean_old=-mean_change / dt,
        mean_new=mean_change / dt,
    )


def simple_bank(poles: np.ndarray, gains: np.ndarray) -> Bank:
    """Return Σ gain_k / (s - p_k): one input, one output; both arrays of shape (m,)."""
    poles = np.asarray(poles, dtype=complex)
    gain = np.asarray(gains, dtype=complex)[None, :]
    nothing = np.zeros((1, 1))
    return Bank(poles, np.ones((poles.size, 1)), gain, np.zeros_like(gain), nothing, nothing)


def stacked(banks: list[Bank]) -> Bank:
    """Return the bank with the outputs of `banks`, one below the other, on shared inputs.

    Leaking banks cannot be combined; combine them first, then add the leak.
    """
    _check_no_leak(banks)
    return Bank(
        poles=np.concatenate([b.poles for b in banks]),
        drive=np.concatenate([b.drive for b in banks]),
        gain=block_diag(*(b.gain for b in banks)),
        double=block_diag(*(b.double for b in banks)),
        constant=np.concatenate([b.constant for b in banks]),
        slope=np.concatenate([b.slope for b in banks]),
    )


def summed(banks: list[Bank]) -> Bank:
    """Return the bank with the inputs of `banks` side by side and the sum of their outputs."""
    _check_no_leak(banks)
    return Bank(
        poles=np.concatenate([b.poles for b in banks]),
        drive=block_diag(*(b.drive for b in banks)),
        gain=np.concatenate([b.gain for b in banks], axis=1),
        double=np.concatenate([b.double for b in banks], axis=1),
        constant=np.concatenate([b.constant for b in banks], axis=1),
        slope=np.concatenate([b.slope for b in banks], axis=1),
    )


def leaking(bank: Bank, rate: float) -> Bank:
    """Return `bank` times s/(s + rate): the response to a constant input decays.

    The rate is in 1/s; the bank has no double poles.

    The leak remains a separate stage. By partial fractions it would be one more pole, and residues
    of a nearby pole would nearly cancel.
    """
    if bank._has_double().any():
        raise InputError("a bank with double poles cannot leak")
    return replace(bank, leak=rate)


def respond_to_line(
    bank: Bank, times: np.ndarray, inputs: np.ndarray, lead: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (mean over each interval, value at its end) for the straight line through the samples.

    Parameters
    ----------
    bank : Bank
    times : ndarray, shape (k,)
        Increasing, s.
    inputs : ndarray, shape (k, n_in) or (k, n_in, runs)
        Samples of the inputs, of one run or of several.
    lead : float
        The bank is at rest, its inputs zero, until `lead` seconds before the first sample.

    Returns
    -------
    means, ends : ndarray, shape (k, n_out) or (k, n_out, runs)
    """
    means, ends = _outputs(bank, inputs), _outputs(bank, inputs)
    state = np.zeros((bank.n_state, *inputs.shape[2:]))
    before = np.zeros(inputs.shape[1:])
    for n, dt in enumerate(intervals(times, lead)):
        over, now = over_interval(bank, dt), inputs[n]
        means[n] = over.mean @ state + over.mean_old @ before + over.mean_new @ now
        state = over.advance @ state + over.old @ before + over.new @ now
        ends[n] = over.end @ state + over.end_old @ before + over.end_new @ now
        before = now
    return means, ends


def respond_to_steps(bank: Bank, times: np.ndarray, inputs: np.ndarray, lead: float) -> np.ndarray:
    """Return the outputs at `times` if input n is constant over the interval that ends at time n.

    Parameters and result as in `respond_to_line`; the first input lasts for `lead` seconds. The
    bank must not leak, since its inputs are discontinuous.
    """
    _check_no_leak([bank])
    ends = _outputs(bank, inputs)
    state = np.zeros((bank.n_state, *inputs.shape[2:]))
    for n, dt in enumerate(intervals(times, lead)):
        over = over_interval(bank, dt)
        state = over.advance @ state + (over.old + over.new) @ inputs[n]
        ends[n] = over.end @ state + bank.constant @ inputs[n]
    return ends


def intervals(times: np.ndarray, lead: float) -> list[float]:
    """Return the length of the interval that ends at each of `times`; the first is `lead`."""
    return [float(lead), *np.diff(times).tolist()]


def _outputs(bank: Bank, inputs: np.ndarray) -> np.ndarray:
    return np.empty((len(inputs), bank.constant.shape[0], *inputs.shape[2:]))


def _check_no_leak(banks: list[Bank]) -> None:
    if any(bank.leak for bank in banks):
        raise InputError("leaking banks cannot be combined; add the leak to the combined bank")
