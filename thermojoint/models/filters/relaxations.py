"""First-order relaxations of signals: y' = (u - y)/τ, exactly for straight lines between samples.

The exponentials of Eq. 8 as filters of measured signals, each bounded by its signal for any run
length. τ = 0 is the signal itself.
"""

from __future__ import annotations

import numpy as np

from thermojoint.artefacts.arrays import Array


def relaxed(states: Array, old: Array, new: Array, dt: float, taus: Array) -> Array:
    """Return relaxations one interval later.

    Parameters
    ----------
    states : ndarray, shape (n,)
        Relaxations at the start of the interval.
    old, new : ndarray, shape (n,)
        Signals at its start and end.
    dt : float
        Length of the interval, s, positive.
    taus : ndarray, shape (n,)
        Time constants, s; 0 for the signal itself.
    """
    slow = taus > 0.0
    decay = np.where(slow, np.exp(-dt / np.where(slow, taus, 1.0)), 0.0)
    lag = taus * (new - old) / dt
    return np.asarray(new - lag + decay * (states - old + lag))


def relax_all(times: Array, signals: Array, taus: Array, start: Array) -> Array:
    """Return relaxations at every sample of a run, shape (k, n).

    Parameters
    ----------
    times : ndarray, shape (k,)
        Increasing, s.
    signals : ndarray, shape (k, n)
        Signal of each relaxation.
    taus : ndarray, shape (n,)
        Time constants, s.
    start : ndarray, shape (n,)
        Relaxations at the first sample.
    """
    states = np.empty_like(signals)
    state = states[0] = np.where(taus > 0.0, start, signals[0])
    for k in range(1, len(times)):
        dt = float(times[k] - times[k - 1])
        state = states[k] = relaxed(state, signals[k - 1], signals[k], dt, taus)
    return states
