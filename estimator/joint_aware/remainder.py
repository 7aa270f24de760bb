"""The linear remainder: what a machine's response lacks of its model's, as bounded relaxations.

y_plant - y_model = sum_ij G_ij z_ij with dz_ij/dt = rho_j (Q_i - z_ij), Q_i the heat of source i
relative to its reference. Every z is a mean over the heat's past: whatever the run, none exceeds
the largest heat that there was, and so the remainder never exceeds the sum of its gains times that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from artefacts.arrays import Array

#: Relaxation times from the first to the last, s, evenly in their logarithm.
FASTEST, SLOWEST, COUNT = 8.0, 6000.0, 9
#: Prior standard deviation of a gain, as a part of the channel's largest value per heat input.
SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Remainder:
    """Gains on relaxations of the heat.

    Attributes
    ----------
    rates : ndarray, shape (q,)
        rho, 1/s.
    temperature : ndarray, shape (p, s q)
        Gains of each sensor, K: all rates of the first source, then of the second ...
    displacement : ndarray, shape (axes, s q)
        Gains of each axis, m.
    """

    rates: Array
    temperature: Array
    displacement: Array


def relaxation_rates() -> Array:
    """Return rho, 1/s, shape (COUNT,)."""
    return 1.0 / np.geomspace(FASTEST, SLOWEST, COUNT)


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
    """Least squares for gains with a normal prior, of channels that share their relaxations.

    min_G |(y - Z G)/sigma|^2 + |G/tau|^2. What is left of a y at its minimum is |whitened(y)|^2, so
    that a fit of other parameters may be made as if there were no remainder.

    Attributes
    ----------
    left : ndarray, shape (n, k)
    values : ndarray, shape (k,)
    right : ndarray, shape (k, s q)
        Z = left diag(values) right.
    """

    left: Array
    values: Array
    right: Array

    def whitened(self, signal: Array, sigma: float, tau: float) -> Array:
        """Return what the relaxations do not explain of a signal (n,), in units of sigma."""
        kept = np.sqrt(sigma**2 / (sigma**2 + (tau * self.values) ** 2))
        found: Array = (signal - self.left @ ((1.0 - kept) * (self.left.T @ signal))) / sigma
        return found

    def gains(self, signal: Array, sigma: float, tau: float) -> Array:
        """Return the gains (s q,) that fit a signal (n,)."""
        part = self.values / (self.values**2 + (sigma / tau) ** 2)
        found: Array = self.right.T @ (part * (self.left.T @ signal))
        return found

    def uncertainty(self, sigma: float, tau: float) -> Array:
        """Return a root of the covariance of fitted gains, shape (s q, k)."""
        left = sigma * tau / np.sqrt(sigma**2 + (tau * self.values) ** 2)
        found: Array = self.right.T * left
        return found


def make_ridge(states: Array) -> Ridge:
    """Return the ridge regression on relaxations Z, shape (n, s q)."""
    return Ridge(*np.linalg.svd(states, full_matrices=False))
