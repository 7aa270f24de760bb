"""State of the observer as one flat array with named parts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.displacement_readings import ModelError
from estimator.joint_aware.fault_isolation import PendingJump
from estimator.sensor_faults import Watch
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.physics import JointState

#: Knowledge of the joint's slips: those of a run from rest; unknown, because the temperatures are;
#: or tracked since the temperatures became known.
KNOWN, UNKNOWN, TRACKED = 0.0, 1.0, 2.0
#: Number of parts of the model error in the states of all versions; the others come at the end.
_FIRST = 2
#: Parts that later versions added, at the end of a flat state.
_LATER = ("steps", "odometer_age", "away", "back", "position_away", "position_back")


class Absences(NamedTuple):
    """How long readings of axes were missing, s, while that has an effect, and are back.

    Both of shape (2 c + x,): of the c odometers that report the missed travel, of odometers that
    were reset, and of the x positions.
    """

    away: Array
    #: While no reading is missing.
    back: Array


class ObserverState(NamedTuple):
    """State of the observer between samples."""

    #: Shape (): of the last sample, s; NaN before the first.
    time: Array
    #: Shape (): of the first sample, s; NaN before it.
    begun: Array
    #: Shape (): knowledge of the joint's slips: `KNOWN`, `UNKNOWN` or `TRACKED`.
    slip_knowledge: Array
    #: Shape (n,): amplitudes, relaxations, heat of the sources (W), held surfaces and ambient (K):
    #: `filter_design`.
    linear: Array
    #: Shape (l,): factors of the loads: the last that were read, and those that are constant.
    loads: Array
    #: Of the joint: `physics.JointState`.
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    #: Shape (n + p + 1, k): covariance factor L of P + L L^T, of `linear` and then of `errors`.
    covariance_factor: Array
    #: Shape (p + 1,): errors of the readings that stem from an unknown start, K.
    errors: Array
    #: Shape (d,): temperatures of the axes' drives, K.
    drive: Array
    #: Shape (c,): last readings of the odometers, m; NaN before.
    odometer: Array
    #: Shape (t,): heat according to the last readings of the powers, W.
    power_heat: Array
    #: Memory of every channel.
    watch: Watch
    #: Model error estimated from displacement readings.
    model_error: ModelError
    #: A jump whose cause is still unknown.
    pending: PendingJump
    #: Shape (): steps between the last two samples; 0 before.
    steps: Array
    #: Shape (c,): time since the last reading of each odometer, s.
    odometer_age: Array
    #: Shape (2 c,): how long odometers were missing, s, while that has an effect, and for how long
    #: they and all readings are back; of those that report the missed travel, then of reset ones.
    away: Array
    back: Array
    #: Shape (x,): the same of the positions.
    position_away: Array
    position_back: Array

    @property
    def joint(self) -> JointState:
        """State of the joint."""
        return JointState(self.gap, self.slip, self.pressure, self.change)

    @property
    def absences(self) -> Absences:
        """Absences of the readings of axes."""
        away = np.concatenate([self.away, self.position_away])
        return Absences(away, np.concatenate([self.back, self.position_back]))

    def flat(self) -> Array:
        """Return the whole state as one array; `Layout.views` are its parts."""
        return np.concatenate([np.ravel(part) for part in self._parts().values()])

    @property
    def layout(self) -> Layout:
        """Positions of its parts in a flat state."""
        return placed({name: np.shape(part) for name, part in self._parts().items()})

    def _parts(self) -> dict[str, Array]:
        """Its parts by name, in the order of a flat state."""
        parts = self._asdict()
        error, pending = parts.pop("model_error")._asdict(), parts.pop("pending")._asdict()
        errors = [(f"model_error.{name}", one) for name, one in error.items()]
        last = [(name, parts.pop(name)) for name in _LATER]
        parts["watch"] = np.array(parts["watch"])
        parts |= dict(errors[:_FIRST])
        parts |= {f"pending.{name}": one for name, one in pending.items()}
        return parts | dict(errors[_FIRST:] + last)


@dataclass(frozen=True)
class Layout:
    """Positions of the parts of a flat state."""

    #: Name, place and shape of each, in order.
    parts: tuple[tuple[str, slice, tuple[int, ...]], ...]

    def views(self, state: Array) -> dict[str, Array]:
        """Return the parts of a flat state by their names, as views."""
        return {
            name: state[at] if len(shape) == 1 else state[at].reshape(shape)
            for name, at, shape in self.parts
        }


def placed(shapes: Mapping[str, tuple[int, ...]]) -> Layout:
    """Return the positions of consecutive parts of these shapes."""
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()]).tolist()
    places = (slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))
    return Layout(tuple(zip(shapes, places, shapes.values(), strict=True)))


def unpacked(state: Array, known: Layout) -> ObserverState:
    """Return views of the parts of a flat state."""
    views = known.views(state)
    pending = PendingJump(*(views.pop(f"pending.{name}") for name in PendingJump._fields))
    error = ModelError(*(views.pop(f"model_error.{name}") for name in ModelError._fields))
    watch = Watch(*views.pop("watch"))
    return ObserverState(watch=watch, model_error=error, pending=pending, **views)
