"""Slowly varying parameters as random processes, and a Kalman filter that estimates them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.joint_aware.observer_model import ObserverModel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name


@dataclass(frozen=True)
class Slow:
    """Random process of the logarithm of a parameter's factor: dx = -x dt / lasts + noise."""

    #: Long-term standard deviation.
    spread: float
    #: Correlation time, s.
    lasts: float


DAY = 86400.0
#: Parameters that can age. A preload is lost within days and restored when bolts are tightened;
#: lubricant and wear change the friction, coolant and draught the convection.
SLOW = {
    "preload": Slow(0.3, 10.0 * DAY),
    "friction": Slow(0.2, 10.0 * DAY),
    "film": Slow(0.3, 2.0 * DAY),
}


@dataclass(frozen=True)
class Learning:
    """Settings of online learning (``python -m benchmarks.ageing``, docs/ageing.md).

    All were determined together on the first plant of that study, with another history of heat.
    """

    #: Offset of the copies' parameters, in the logarithm.
    step: float = 0.03
    #: Innovations are averaged over this time, s, ...
    window: float = 600.0
    #: ... and then have errors of this size, K and m.
    lasting_K: float = 0.1
    lasting_m: float = 0.5e-6
    #: Bias of a sensor's innovations, K. Without it the factor drifted to 0.90 on a machine that
    #: had not aged; at 0.5 K it went the wrong way.
    bias: Slow = Slow(0.15, 6.0 * 3600.0)
    #: Largest change of a logarithm from the calibration, and largest bias, K.
    farthest: float = 1.5


USUAL = Learning()


def check_ageing(model: ObserverModel, names: Sequence[str]) -> None:
    """Refuse parameters that a machine does not have, or that do not age.

    Raises
    ------
    InputError
        A name is unknown or repeated, or the machine has no such parameter.
    """
    for name in names:
        if name not in SLOW:
            raise unknown_name("ageing parameter", name, SLOW, "ageing")
    if not names or len(set(names)) < len(names):
        raise InputError("ageing: no parameter, or one twice; name each once")
    if model.surfaces and "film" in names:
        raise InputError("ageing: no film beside held temperatures; leave it out")
    frictions = [joint.section.friction_coefficient for joint in model.joints]
    absent = {
        "preload": not any(joint.section.preload_MPa for joint in model.joints),
        "friction": not any(frictions),
        "film": not model.modes.film.any(),
    }
    for name in names:
        if absent[name]:
            raise InputError(f"ageing: the machine has no {name}; leave it out")


def wandered(
    slow: Sequence[Slow], learned: Array, covariance: Array, length: float
) -> tuple[Array, Array]:
    """Return estimate and covariance after some time without readings."""
    kept = np.exp([-length / process.lasts for process in slow])
    added = np.diag([process.spread**2 for process in slow]) * (1.0 - kept**2)
    return kept * learned, kept[:, None] * covariance * kept + added


def learnt(
    learned: Array,
    covariance: Array,
    innovation: Array,
    rows: Array,
    variance: Array,
    farthest: float,
) -> tuple[Array, Array]:
    """Return estimate and covariance after some innovations, by the Kalman filter.

    Parameters
    ----------
    learned : ndarray, shape (n,)
        Before.
    covariance : ndarray, shape (n, n)
        Before.
    innovation : ndarray, shape (k,)
        Reading minus prediction.
    rows : ndarray, shape (k, n)
        Derivative of the prediction by the estimate.
    variance : ndarray, shape (k,)
        Of the reading, including model error.
    farthest : float
        Bound on the magnitude of the estimate.
    """
    across = rows @ covariance
    gain = np.linalg.solve(across @ rows.T + np.diag(variance), across).T
    after = np.clip(learned + gain @ innovation, -farthest, farthest)
    # Joseph's form stays symmetric and positive despite rounding.
    left = np.eye(learned.size) - gain @ rows
    return after, left @ covariance @ left.T + gain * variance @ gain.T
