"""The observer's state as one flat array, and what its parts are called."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from artefacts.arrays import Array
from estimator.joint_aware.displacement_readings import ModelError
from estimator.joint_aware.physics import JointState
from estimator.joint_aware.suspicion import Suspicion
from estimator.sensor_faults import Watch

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


def shapes(
    states: int, contacts: int, columns: int, channels: int, axes: int
) -> dict[str, tuple[int, ...]]:
    """Return the shape of every part, in order."""
    return {
        "time": (),
        "begun": (),
        "memory": (),
        "linear": (states,),
        "gap": (3, contacts),
        "slip": (2, contacts),
        "pressure": (contacts,),
        "change": (3, contacts),
        "excess": (states, columns),
        **{f"watch.{name}": (channels,) for name in Watch._fields},
        **{f"model_error.{name}": (axes,) for name in ModelError._fields},
        **{f"suspicion.{name}": () for name in Suspicion._fields[:-1]},
        "suspicion.linear": (states,),
    }


def unpacked(state: Array, parts: dict[str, tuple[int, ...]]) -> ObserverState:
    """Return views of the parts of a flat state."""
    at, found = 0, {}
    for name, shape in parts.items():
        size = math.prod(shape)
        found[name] = state[at : at + size].reshape(shape)
        at += size
    groups = {
        group: kind(*(found.pop(f"{group}.{name}") for name in kind._fields))
        for group, kind in (
            ("watch", Watch),
            ("model_error", ModelError),
            ("suspicion", Suspicion),
        )
    }
    return ObserverState(**found, **groups)  # type: ignore[arg-type]
