"""The observer's state as one flat array, and what its parts are called."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.joint_aware.displacement_readings import ModelError
from estimator.joint_aware.suspicion import Suspicion
from estimator.sensor_faults import Watch
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.physics import JointState

#: The joint's slips are those of a run from rest; or they are not known at all, because the
#: temperatures are not yet; or they are followed since the temperatures are known.
KNOWN, UNKNOWN, FOLLOWED = 0.0, 1.0, 2.0


@dataclass(frozen=True, eq=False)
class ObserverState:
    """All that the next sample depends on.

    Attributes
    ----------
    time : ndarray, shape ()
        Of the last sample, s; NaN before the first.
    begun : ndarray, shape ()
        Of the first sample, s; NaN before it.
    memory : ndarray, shape ()
        What is known of the joint's slips: `KNOWN`, `UNKNOWN` or `FOLLOWED`.
    linear : ndarray, shape (n,)
        Amplitudes, relaxations, heat of the sources (W), ambient (K): `filter_design`.
    gap, slip, pressure, change : ndarray
        Of the joint: `physics.JointState`.
    excess : ndarray, shape (n, k)
        What the covariance has more than the steady one: L of P + L L^T.
    watch : Watch
        What is remembered of every channel.
    model_error : ModelError
        What readings of the displacement have told.
    suspicion : Suspicion
        A jump that is not yet judged.
    """

    time: Array
    begun: Array
    memory: Array
    linear: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    excess: Array
    watch: Watch
    model_error: ModelError
    suspicion: Suspicion

    @property
    def joint(self) -> JointState:
        """The joint alone."""
        return JointState(self.gap, self.slip, self.pressure, self.change)

    def flat(self) -> Array:
        """Return one array that holds it all."""
        return np.concatenate(
            [
                [self.time, self.begun, self.memory],
                self.linear,
                self.gap.ravel(),
                self.slip.ravel(),
                self.pressure,
                self.change.ravel(),
                self.excess.ravel(),
                *self.watch,
                *self.model_error,
                *(part.ravel() for part in self.suspicion),
            ]
        )


@dataclass(frozen=True)
class Layout:
    """Where the parts of a flat state stand.

    Attributes
    ----------
    parts : tuple of (str, slice, tuple of int)
        Name, place and shape of each, in order.
    """

    parts: tuple[tuple[str, slice, tuple[int, ...]], ...]


def layout(states: int, contacts: int, columns: int, channels: int, axes: int) -> Layout:
    """Return where the parts of the state of an observer stand."""
    shapes: dict[str, tuple[int, ...]] = {
        "time": (),
        "begun": (),
        "memory": (),
        "linear": (states,),
        "gap": (3, contacts),
        "slip": (2, contacts),
        "pressure": (contacts,),
        "change": (3, contacts),
        "excess": (states, columns),
        "watch": (len(Watch._fields), channels),
        "model_error": (len(ModelError._fields), axes),
        **{f"suspicion.{name}": () for name in Suspicion._fields[:-1]},
        "suspicion.linear": (states,),
    }
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()]).tolist()
    places = (slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))
    return Layout(tuple(zip(shapes, places, shapes.values(), strict=True)))


def unpacked(state: Array, known: Layout) -> ObserverState:
    """Return views of the parts of a flat state."""
    found = {name: state[at].reshape(shape) for name, at, shape in known.parts}
    suspicion = Suspicion(*(found.pop(f"suspicion.{name}") for name in Suspicion._fields))
    watch, error = Watch(*found.pop("watch")), ModelError(*found.pop("model_error"))
    return ObserverState(watch=watch, model_error=error, suspicion=suspicion, **found)
