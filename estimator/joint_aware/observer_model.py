"""Complete model of a joint-aware estimator, without mesh and calibration data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware.filter_design import SteadyFilter
from estimator.lines import Stroke
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.display import Described
from thermojoint.reduced.discrepancy import Discrepancy
from thermojoint.reduced.machine import Joint, Modes, MovingAxis

#: Version of the model file.
SCHEMA = "thermojoint-joint-aware-model"
#: With the joint, or with the joint linearised at its preload (`linear_joint`).
Kind = Literal["joint-aware", "kalman-linear"]


@dataclass(frozen=True, eq=False)
class Band:
    """Variances of the unknown part of the displacement; axes in rows."""

    #: Shape (axes, n): displacement per state, the joint sticking at its preload, m.
    tangent: Array
    #: Shape (axes,): of the state after a reading, m2.
    steady: Array
    #: Shape (axes,): residual of the calibration, m2.
    constant: Array
    #: Shape (axes,): unknown slips after a warm start, m2.
    history: Array
    #: Shape (axes,): of drives that are assumed cold when a warm machine starts, m2.
    drive: Array
    #: Shape (axes, draws, 2 s q + m): error of machines that the calibration cannot distinguish,
    #: per relaxation of the heat and per square of it, m, and per mean innovation, m/K.
    open: Array
    #: Shape (axes, q): remaining error, per square of the heat relaxed at each rate, m2.
    square: Array
    #: Shape (axes, p + 1): error per square of the innovation of each reading that lasts
    #: (`Watch.lasting`), m2/K2.
    surprise: Array
    #: Shape (m,): largest mean innovations (`Watch.means`) in recorded days, K; m is zero without.
    seen: Array
    #: Shape (axes, m): displacement per mean innovation in these days, m/K.
    told: Array
    #: Shape (): share of the innovations in the range of these days that counts in `surprise`.
    allowed: Array

    def within(self, means: Array) -> Array:
        """Return mean innovations (..., 3 (p + 1)), K, clipped to those of the days, (..., m)."""
        return np.clip(means[..., : self.seen.size], -self.seen, self.seen)

    def surprising_of(self, means: Array) -> Array:
        """Return the lasting innovations, (..., p + 1), K, less the part that days explain."""
        lasting = means[..., : self.surprise.shape[1]]
        if not self.seen.size:
            return lasting
        return lasting - (1.0 - self.allowed) * self.within(means)[..., : lasting.shape[-1]]

    @cached_property
    def surprising(self) -> tuple[NDArray[np.int64], Array]:
        """Effects of lasting innovations: a reading (c,), the error per innovation (axes, c), m/K.

        One for every axis and reading that is in the band.
        """
        axis, reading = np.nonzero(self.surprise)
        meaning = np.zeros((len(self.surprise), axis.size))
        meaning[axis, range(axis.size)] = np.sqrt(self.surprise[axis, reading])
        return reading, meaning

    @property
    def shared(self) -> tuple[int, int]:
        """Numbers of parts of the model error that axes share (`displacement_readings`).

        Of the drawn machines, and of the lasting innovations.
        """
        return self.open.shape[1], self.surprising[0].size


@dataclass(frozen=True)
class Calibrated:
    """Range of the calibration.

    Attributes
    ----------
    duration_s : float
        Of its longest run, s.
    heat : float
        Largest heat of a source relative to its reference; the smallest is 0.
    temperatures : dict of str to (float, float)
        Sensor to its lowest and highest value, K.
    speeds : tuple of float
        Speed of every moving axis in its fastest minute, m/s; empty where that is not known, as in
        models of earlier versions.
    loads : tuple of (float, float)
        Lowest and highest factor of every load that is read; empty where that is not known.
    """

    duration_s: float
    heat: float
    temperatures: dict[str, tuple[float, float]]
    speeds: tuple[float, ...] = ()
    loads: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class ObserverModel(Described):
    """The observer of one machine.

    Attributes
    ----------
    modes : Modes
        With the joint held at its preload.
    held : ndarray, shape (m,)
        Conductance times area at the preload, W/K.
    joints : tuple of Joint
        As calibrated.
    discrepancy : Discrepancy
        Model discrepancy.
    filter : SteadyFilter
        Filter of the linear part.
    band : Band
        Band of the displacement.
    warm : ndarray, shape (n, k)
        Covariance factor of an unknown start.
    power : ndarray, shape (s,)
        Heat of each source at heat input 1 according to the case, W.
    step : float
        Step of the filter, s; a longer interval of samples is divided (`sample_processing`).
    offset : ndarray, shape (p,)
        Offset of every sensor, K.
    first : ndarray, shape (h,)
        Temperatures of the held surfaces at the start of a cold machine, K.
    sensors, axes, sources, loads, surfaces : tuple of str
        Names; of the loads, those whose factors are read; of the held surfaces.
    calibrated : Calibrated
        Range of the calibration.
    factors : dict of str to (float, float)
        Calibrated parameter to the factor on the case's value and the standard deviation of its
        logarithm.
    kind : str
        Name of the kind of estimator.
    moving_axes : tuple of MovingAxis
        Its moving axes, if any.
    power_shares : mapping of str to float
        Source whose power is read to the share of that power which becomes its heat.
    places : mapping of str to (float, float, float)
        Sensor to its position, m; without held surfaces, and empty in models of earlier versions.
    displacement_of : str
        The displaced and the reference point; empty in models of earlier versions.
    """

    modes: Modes
    held: Array
    joints: tuple[Joint, ...]
    discrepancy: Discrepancy
    filter: SteadyFilter
    band: Band
    warm: Array
    power: Array
    step: float
    offset: Array
    first: Array
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    sources: tuple[str, ...]
    loads: tuple[str, ...]
    surfaces: tuple[str, ...]
    calibrated: Calibrated
    factors: dict[str, tuple[float, float]] = field(default_factory=dict)
    kind: Kind = "joint-aware"
    moving_axes: tuple[MovingAxis, ...] = ()
    power_shares: Mapping[str, float] = field(default_factory=dict)
    places: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    displacement_of: str = ""

    def _facts(self) -> dict[str, str]:
        return {
            "kind": self.kind,
            "axes": ", ".join(self.axes),
            "sensors": ", ".join(self.sensors),
            "sources": ", ".join(self.sources),
            "calibrated": f"{self.calibrated.duration_s / 60.0:g} min",
        }

    def cold_drives(self, since: float) -> Array:
        """Return the variance (axes,) due to drives assumed cold at a warm start, m2.

        Parameters
        ----------
        since : float
            Time since the start, s.
        """
        drives = self.modes.drives
        if drives is None or not (lasts := drives.lasts):
            return np.zeros_like(self.band.drive)
        return np.asarray(self.band.drive * math.exp(-2.0 * since / lasts))

    @property
    def powers(self) -> tuple[str, ...]:
        """Names of the powers that are read, after the ways: ``spindle_power``."""
        return tuple(f"{source}_power" for source in self.power_shares)

    @property
    def positions(self) -> tuple[str, ...]:
        """Names of the positions that are read, after the loads: ``y_pos``."""
        return tuple(f"{axis.name}_pos" for axis in self.moving_axes)

    @property
    def counted(self) -> tuple[int, ...]:
        """Indices of the moving axes that have an odometer."""
        return tuple(k for k, axis in enumerate(self.moving_axes) if axis.odometer)

    @property
    def ways(self) -> tuple[str, ...]:
        """Names of the odometers that are read, after the positions: ``y_way``."""
        return tuple(f"{self.moving_axes[k].name}_way" for k in self.counted)

    @property
    def sloped(self) -> dict[str, int]:
        """Axes of the displacement whose line a control is given, to the index of a moving axis.

        With one moving axis that one; with several, the one that moves along the same axis, if any.
        """
        if len(self.moving_axes) == 1:
            return dict.fromkeys(self.axes, 0)
        moving = {axis.along: k for k, axis in enumerate(self.moving_axes)}
        return {axis: moving[axis] for axis in self.axes if axis in moving}

    @property
    def strokes(self) -> dict[str, Stroke]:
        """Strokes of these lines by the axis of the displacement."""
        strokes = [
            Stroke(axis.reference, float(axis.asked.min()), float(axis.asked.max()))
            for axis in self.moving_axes
        ]
        return {axis: strokes[k] for axis, k in self.sloped.items()}
