"""Fit of Eq. 18 to sources with known, time-dependent strengths instead of steps.

The paper takes the fictitious sources as steps because the contact pressures of its structure reach
most of their final value within a minute. Otherwise, the strengths found by the inverse filters in
the calibration responses are slow functions q_i(t), and a D_i fitted to steps responds to inputs
that never occur. Here the same D_i is fitted to the actual inputs:

    δ_NL(t) = Σ_i ∫ D_i(t - τ) dq_i(τ)

The strengths are given; their estimation is independent of this module.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from calibrate.fit_result import Fit
from calibrate.least_squares import fit
from calibrate.source_deformation import eq18_models, eq18_problem
from thermojoint.artefacts import steps
from thermojoint.artefacts.errors import InputError
from thermojoint.models.parameters import DeformationModel

#: As `source_deformation.RIDGE`. Larger, since strengths vary beyond the calibration and must not
#: disturb terms that nearly cancel.
RIDGE = 1e-2
#: Starts of the search: the strengths determine the rates better than steps do.
STARTS = 4
#: Correlation times of `uncertain_signals` per length of the run: from a sensor's noise to a drift.
UNCERTAIN = (1 / 105, 4 / 105, 16 / 105, 64 / 105)


def uncertain_signals(times: np.ndarray, rms: float, channels: int, seed: int) -> list[np.ndarray]:
    """Return random errors of temperature deviations, one run per correlation time.

    Each is a stationary first-order Gauss-Markov process, independent in every channel. Used as
    additional calibration runs that must cause no displacement, they limit how closely the fit
    follows a deviation to `rms`: sensors have errors, and the map from temperature to displacement
    is linear only in the model.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Evenly spaced, s.
    rms : float
        Their root mean square, K.
    channels : int
        Number of sensors.
    seed : int
        The same seed gives the same signals.

    Returns
    -------
    list of ndarray, shape (n, channels)
        One per time of `UNCERTAIN`, K.
    """
    from scipy.signal import lfilter

    interval = float(times[1] - times[0])
    random = np.random.default_rng(seed)
    signals = []
    for share in UNCERTAIN:
        memory = share * float(times[-1] - times[0])
        keep = np.exp(-interval / memory)
        lead = int(5.0 * memory / interval)
        white = random.standard_normal((len(times) + lead, channels))
        # lfilter starts at rest; the lead lets the process become stationary.
        process = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)
        signals.append(rms * process[lead:])
    return signals


def driver(strengths: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function from step responses to the responses to varying strengths.

    A strength is constant over each interval: ``strengths[:, k]`` holds over the interval that ends
    at sample k. Strengths and step responses are transformed once each.

    Parameters
    ----------
    strengths : ndarray, shape (inputs, n)
        At each input.

    Returns
    -------
    callable
        Step responses at one, two, ... n intervals after the step, shape (n, p), to the responses
        at the samples, shape (inputs, n, p).
    """
    samples = strengths.shape[1]
    size = next_fast_len(2 * samples - 1, real=True)
    spectra = rfft(strengths, size)

    def respond(shape: np.ndarray) -> np.ndarray:
        increments = np.diff(shape.T, prepend=0.0)
        driven = irfft(spectra[:, None] * rfft(increments, size), size)
        return np.asarray(driven[:, :, :samples].transpose(0, 2, 1))

    return respond


def fit_driven_deformation(
    t: np.ndarray,
    deviations: np.ndarray,
    strengths: np.ndarray,
    *,
    ridge: float = RIDGE,
) -> tuple[tuple[DeformationModel, ...], Fit]:
    """Return Eq. 18 of every source along one axis, driven by strengths that vary.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the start, s: one, two ... n intervals.
    deviations : ndarray, shape (inputs, n)
        δ_NL at each calibration input, m; zero for an input that must have no effect.
    strengths : ndarray, shape (sources, inputs, n)
        Strengths during the interval that ends at each sample.
    ridge : float
        As in `least_squares.Separable`.

    Raises
    ------
    InputError
        Shapes disagree or the times are not evenly spaced.
    """
    sources, inputs, samples = strengths.shape
    if deviations.shape != (inputs, t.size) or samples != t.size:
        raise InputError(
            f"fictitious sources: strengths {strengths.shape} and displacement deviations "
            f"{deviations.shape} do not fit {t.size} times; give one value per input and time"
        )
    after = steps.even_interval(t, "fictitious sources") * np.arange(1, t.size + 1)
    drivers = [driver(strength) for strength in strengths]
    problem = eq18_problem(after, deviations, sources, lambda i, shapes: drivers[i](shapes))
    best = fit(replace(problem, ridge=ridge), starts=STARTS)
    return eq18_models(best, sources), best
