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

#: The joint's slips are those of a run from rest; or they are not known at all, because the
#: temperatures are not yet; or they are followed since the temperatures are known.
KNOWN, UNKNOWN, FOLLOWED = 0.0, 1.0, 2.0


class ObserverState(NamedTuple):
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
    suspicion : PendingJump
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
    suspicion: PendingJump

    @property
    def joint(self) -> JointState:
        """The joint alone."""
        return JointState(self.gap, self.slip, self.pressure, self.change)

    def flat(self) -> Array:
        """Return one array that holds it all."""
        *own, watch, error, suspicion = self
        return np.concatenate([np.ravel(part) for part in (*own, *watch, *error, *suspicion)])


@dataclass(frozen=True)
class Layout:
    """Where the parts of a flat state stand.

    Attributes
    ----------
    parts : tuple of (str, slice, tuple of int)
        Name, place and shape of each, in order.
    """

    parts: tuple[tuple[str, slice, tuple[int, ...]], ...]

    @property
    def size(self) -> int:
        """Values of the state."""
        return self.parts[-1][1].stop

    def views(self, state: Array) -> dict[str, Array]:
        """Return the parts of a flat state by their names, as views."""
        return {
            name: state[at] if len(shape) == 1 else state[at].reshape(shape)
            for name, at, shape in self.parts
        }


def placed(shapes: Mapping[str, tuple[int, ...]]) -> Layout:
    """Return where parts of these shapes stand, one after the other."""
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()]).tolist()
    places = (slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))
    return Layout(tuple(zip(shapes, places, shapes.values(), strict=True)))


def layout(states: int, contacts: int, columns: int, channels: int, axes: int) -> Layout:
    """Return where the parts of the state of an observer stand."""
    return placed(
        {
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
            **{f"suspicion.{name}": () for name in PendingJump._fields[:-1]},
            "suspicion.linear": (states,),
        }
    )


def unpacked(state: Array, known: Layout) -> ObserverState:
    """Return views of the parts of a flat state."""
    found = known.views(state)
    suspicion = PendingJump(*(found.pop(f"suspicion.{name}") for name in PendingJump._fields))
    watch, error = Watch(*found.pop("watch")), ModelError(*found.pop("model_error"))
    return ObserverState(watch=watch, model_error=error, suspicion=suspicion, **found)
