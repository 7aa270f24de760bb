"""Slowly varying parameters as random processes, and the Kalman filter that estimates them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.joint_aware.observer_model import ObserverModel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name


@dataclass(frozen=True)
class Slow:
    """Random process of the logarithm of a parameter's factor: dx = -x dt / lasts + noise.

    Attributes
    ----------
    spread : float
        Standard deviation in the long run.
    lasts : float
        Time after which it has forgotten where it was, s.
    """

    spread: float
    lasts: float


DAY = 86400.0
#: What can age. A preload is lost in days and comes back when somebody tightens the bolts;
#: lubricant and wear change the friction, coolant and draught the film.
SLOW = {
    "preload": Slow(0.3, 10.0 * DAY),
    "friction": Slow(0.2, 10.0 * DAY),
    "film": Slow(0.3, 2.0 * DAY),
}


@dataclass(frozen=True)
class Learning:
    """How parameters are learnt (``python -m benchmarks.ageing``, docs/ageing.md).

    All were found together on the first plant of that study, with another history of heat.

    Attributes
    ----------
    step : float
        The copies' parameters are off by this, in the logarithm.
    window : float
        Innovations are averaged over this time, s, ...
    lasting_K, lasting_m : float
        ... and are then wrong by this, K and m.
    bias : Slow
        That of a sensor's innovations, K. Without it the factor strayed to 0.90 on a machine that
        had not aged; at 0.5 K it went the wrong way.
    farthest : float
        Farther than this from the calibration no logarithm goes, nor a bias, K.
    """

    step: float = 0.03
    window: float = 600.0
    lasting_K: float = 0.1
    lasting_m: float = 0.5e-6
    bias: Slow = Slow(0.15, 6.0 * 3600.0)
    farthest: float = 1.5


USUAL = Learning()


def check_ageing(model: ObserverModel, names: Sequence[str]) -> None:
    """Refuse parameters that a machine does not have, or that do not age.

    Raises
    ------
    InputError
        A name is unknown, stands twice, or the machine has no such thing.
    """
    for name in names:
        if name not in SLOW:
            raise unknown_name("ageing parameter", name, SLOW, "ageing")
    if not names or len(set(names)) < len(names):
        raise InputError("ageing: no parameter, or one twice; name each once")
    frictions = [joint.section.friction_coefficient for joint in model.joints]
    absent = {
        "preload": not model.joints,
        "friction": not any(frictions),
        "film": not model.modes.film.any(),
    }
    for name in names:
        if absent[name]:
            raise InputError(f"ageing: the machine has no {name}; leave it out")


def wandered(
    slow: Sequence[Slow], found: Array, covariance: Array, length: float
) -> tuple[Array, Array]:
    """Return what is learnt, and its covariance, after a while without any reading."""
    kept = np.exp([-length / one.lasts for one in slow])
    added = np.diag([one.spread**2 for one in slow]) * (1.0 - kept**2)
    return kept * found, kept[:, None] * covariance * kept + added


def learnt(
    found: Array,
    covariance: Array,
    innovation: Array,
    rows: Array,
    variance: Array,
    farthest: float,
) -> tuple[Array, Array]:
    """Return what is learnt and its covariance after some innovations, by the Kalman filter.

    Parameters
    ----------
    found : ndarray, shape (n,)
        Before.
    covariance : ndarray, shape (n, n)
        Before.
    innovation : ndarray, shape (k,)
        Reading less what was expected of it.
    rows : ndarray, shape (k, n)
        What is expected more for what is learnt more.
    variance : ndarray, shape (k,)
        Of the reading, model error included.
    farthest : float
        Farther than this from zero it does not go.
    """
    across = rows @ covariance
    gain = np.linalg.solve(across @ rows.T + np.diag(variance), across).T
    after = np.clip(found + gain @ innovation, -farthest, farthest)
    # Joseph's form stays symmetric and positive whatever the rounding.
    left = np.eye(found.size) - gain @ rows
    return after, left @ covariance @ left.T + gain * variance @ gain.T
