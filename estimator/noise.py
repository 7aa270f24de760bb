"""Thermistor-like noise for the temperatures of an estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.response import held_of, probes_of
from thermojoint.models.sensors import JOINT_SENSORS

if TYPE_CHECKING:
    import xarray as xr

#: Cut-off period of the high-pass, s: the noise has no offset and no drift.
NOISE_PERIOD_S = 60.0
#: The paper's noise on T1 and T2.
NOISE_PEAK_TO_PEAK_K = 0.12
NOISE_SEED = 0


def sensor_noise(
    times: np.ndarray, peak_to_peak: float = 0.12, seed: int = 0, channels: int = 1
) -> np.ndarray:
    """Return noise like a thermistor's after a high-pass filter, each channel independent.

    White Gaussian noise, second-order Butterworth high-pass with a period of `NOISE_PERIOD_S`
    applied forwards and backwards, scaled to `peak_to_peak` (K) over the run.

    Parameters
    ----------
    times : ndarray, shape (k,)
        s; the filter takes their mean interval.
    peak_to_peak : float
        Largest minus smallest value of each channel, K.
    seed : int
        The same seed gives the same noise.
    channels : int
        Number of channels.

    Returns
    -------
    ndarray, shape (k, channels)
        K.

    Raises
    ------
    InputError
        There are too few samples for the filter, or they are too far apart.
    """
    # It loads scipy.stats, which takes longer than all other imports of an estimator.
    from scipy.signal import butter, sosfiltfilt

    interval = float(times[-1] - times[0]) / max(1, len(times) - 1)
    white = np.random.default_rng(seed).standard_normal((len(times), channels))
    edge = 2.0 * interval / NOISE_PERIOD_S
    if not 0.0 < edge < 1.0 or len(times) < 16:
        raise InputError(
            f"sensor noise: {len(times)} samples {interval:g} s apart; the filter needs 16 or more "
            f"that are closer than {NOISE_PERIOD_S / 2.0:g} s"
        )
    noise = sosfiltfilt(butter(2, edge, "highpass", output="sos"), white, axis=0)
    return np.asarray(noise * (peak_to_peak / np.ptp(noise, axis=0)))


def joint_noise(response: xr.Dataset) -> dict[str, np.ndarray]:
    """Noise on T1 and T2, as in the paper: about 0.12 K peak to peak, high-pass, seeded."""
    channels = sensor_noise(
        response["time"].to_numpy(), NOISE_PEAK_TO_PEAK_K, NOISE_SEED, len(JOINT_SENSORS)
    )
    return {role: channels[:, k] for k, role in enumerate(JOINT_SENSORS)}


def with_noise(
    response: xr.Dataset, probes: Sequence[str], peak_to_peak: float, seed: int
) -> xr.Dataset:
    """Return a response with noise on the temperatures of some sensors, K peak to peak.

    As in `with_added`.

    Raises
    ------
    InputError
        `peak_to_peak` is not positive, a sensor has no probe, or the samples do not suit the noise.
    """
    if not 0.0 < peak_to_peak < math.inf:
        raise InputError(f"noise of {peak_to_peak:g} K peak to peak; give a positive number")
    noise = sensor_noise(response["time"].to_numpy(), peak_to_peak, seed, len(probes))
    return with_added(response, dict(zip(probes, noise.T, strict=True)))


def with_added(response: xr.Dataset, added: Mapping[str, np.ndarray]) -> xr.Dataset:
    """Return the response with values (K, for every sample) added to some sensors.

    A sensor is a probe, or else a held surface whose temperature is recorded.

    Raises
    ------
    InputError
        A sensor is not in the response.
    """
    names = {"temperature": probes_of(response), "held_temperature": held_of(response)}
    noisy = {name: response[name].copy(deep=True) for name, known in names.items() if known}
    for sensor, values in added.items():
        where = next((variable for variable, known in names.items() if sensor in known), None)
        if where is None:
            raise unknown_name("probe", sensor, names["temperature"], "response")
        noisy[where][:, names[where].index(sensor)] += values
    return response.assign(noisy)
