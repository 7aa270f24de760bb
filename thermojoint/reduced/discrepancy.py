"""Model discrepancy: difference between machine and model as bounded relaxations.

y_plant - y_model = sum_ij G_ij z_ij with dz_ij/dt = rho_j (Q_i - z_ij), Q_i the heat of source i
relative to its reference. Every z is a mean over the heat's past: in any run none exceeds the
largest heat so far, and so the discrepancy never exceeds the sum of its gains times that heat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Relaxation times from the first to the last, s, evenly in their logarithm.
FASTEST, SLOWEST, COUNT = 8.0, 6000.0, 9
#: ... and of one without a gain, by which the band depends on how long the machine has been warm,
#: s. With a gain it would fit a difference of meshes in a cool-down as a drift.
BEYOND = 24000.0
#: Longest relaxation time with a gain, relative to the longest run: no run shows slower ones.
REACH = 3.0
#: Prior standard deviation of a gain, as a part of the channel's largest value per heat input.
SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Gains on relaxations of the heat."""

    #: Shape (q,): rho, 1/s.
    rates: Array
    #: Shape (p, s q): gains of each sensor, K: all rates of the first source, then of the second
    #: ...
    temperature: Array
    #: Shape (axes, s q): gains of each axis, m.
    displacement: Array


def relaxation_rates() -> Array:
    """Return rho, 1/s, shape (COUNT + 1,)."""
    return 1.0 / np.append(np.geomspace(FASTEST, SLOWEST, COUNT), BEYOND)


def told_by(rates: Array, longest: float) -> Array:
    """Return 1 for rates (q,), 1/s, that have a gain with runs up to `longest` (s), else 0."""
    slowest = min(SLOWEST, REACH * longest)
    return (rates * slowest >= 1.0 - 1e-9).astype(float)


def relaxed(heat: Array, rates: Array, length: float) -> Array:
    """Return z (n, s q) after each of n steps from rest, by implicit Euler.

    Parameters
    ----------
    heat : ndarray, shape (n, s)
        Heat of each source relative to its reference, at the end of each step.
    rates : ndarray, shape (q,)
        1/s.
    length : float
        Of a step, s.
    """
    decay = 1.0 / (1.0 + length * rates)
    states, now = np.empty((len(heat), heat.shape[1], rates.size)), 0.0
    for k, given in enumerate(heat):
        now = decay * now + (1.0 - decay) * given[:, None]
        states[k] = now
    return states.reshape(len(heat), -1)


@dataclass(frozen=True, eq=False)
class Ridge:
    """Least squares for gains with a normal prior.

    min_G |(y - Z G)/sigma|^2 + |G/(tau shape)|^2. The minimum for a y is |whitened(y)|^2, so that
    other parameters may be fitted as if there were no Z.
    """

    #: Shape (n, k).
    left: Array
    #: Shape (k,).
    values: Array
    #: Shape (k, c): Z diag(shape) = left diag(values) right.
    right: Array
    #: Shape (c,): prior standard deviation of each gain, relative to tau.
    shape: Array

    def whitened(self, signal: Array, sigma: float, tau: float) -> Array:
        """Return the part of a signal (n,) that Z does not explain, in units of sigma."""
        kept = np.sqrt(sigma**2 / (sigma**2 + (tau * self.values) ** 2))
        white: Array = (signal - self.left @ ((1.0 - kept) * (self.left.T @ signal))) / sigma
        return white

    def gains(self, signal: Array, sigma: float, tau: float) -> tuple[Array, Array]:
        """Return the gains (c,) that fit a signal (n,), and the residual."""
        part = self.values / (self.values**2 + (sigma / tau) ** 2) * (self.left.T @ signal)
        return self.shape * (self.right.T @ part), signal - self.left @ (self.values * part)

    def uncertainty(self, sigma: float, tau: float) -> Array:
        """Return a root of the covariance of fitted gains, shape (c, k)."""
        left = sigma * tau / np.sqrt(sigma**2 + (tau * self.values) ** 2)
        factor: Array = self.shape[:, None] * self.right.T * left
        return factor


def make_ridge(states: Array, shape: Array) -> Ridge:
    """Return the ridge regression on Z, shape (n, c), with priors like `shape`, (c,)."""
    return Ridge(*np.linalg.svd(states * shape, full_matrices=False), shape)
