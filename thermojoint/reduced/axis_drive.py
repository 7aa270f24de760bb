"""The positioning error of the drives of axes, apart from the machine.

Their seats stand and no surface feels them. A ball screw warms up by its own motion, and a scale
follows the ambient; both depend on the way of the axis alone, as in `fesim.axes.positioning`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from fesim.axes.ball_screw import BallScrew, Beside, warmed
from fesim.axes.positioning import (
    Drive,
    Surfaces,
    cold,
    followed,
    positioning_error,
    scale_of,
    screw_of,
    screw_temperature,
)
from fesim.case.axis_section import AxisSection, seats_of
from fesim.case.drive_sections import BallScrewSection, ScaleSection
from fesim.case.thermal_sections import MaterialSection
from fesim.setup.structure import material_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI
from thermojoint.reduced.axis_way import Way, way_between

#: Least distance over which the heat of a longer way is spread along a screw, m.
SHORTEST = MILLI


@dataclass(frozen=True, eq=False)
class AxisDrive:
    """A ball screw or a scale, or both."""

    #: As the case has it.
    screw: BallScrewSection | None
    #: Of the screw.
    material: MaterialSection | None
    #: As the case has it; the control then reads it.
    scale: ScaleSection | None
    #: Position at which the error is zero at all times, m.
    zero: float | None
    #: Shape (axes,): displacement per m that the bodies on the axis move along it.
    carried: Array

    @cached_property
    def drive(self) -> Drive:
        """What the simulator has of it."""
        screw = None
        if self.screw is not None and self.material is not None:
            screw = screw_of(self.screw, material_of(self.material))
        scale = None if self.scale is None else scale_of(self.scale)
        nowhere = np.full(3, -1)
        none = Surfaces(nowhere, np.zeros((3, 0)))
        return Drive(screw, scale, None, 0, self.zero, none, nowhere)

    @property
    def cold(self) -> Array:
        """Its temperatures (d,) at the initial ambient, K: of the screw, then of the scale."""
        return cold(self.drive)

    def later(
        self, state: Array, air: float, way: tuple[float, float, float], length: float
    ) -> Array:
        """Return its temperatures (d,), K, after a step.

        Parameters
        ----------
        state : ndarray, shape (d,)
            Before, K.
        air : float
            The ambient, K.
        way : (float, float, float)
            Positions between which the axis moves evenly, and how far it has gone, m.
        length : float
            Of the step, s.
        """
        drive, after = self.drive, state.copy()
        if (screw := drive.screw) is not None:
            temperature, beside = screw_temperature(screw, state), Beside(air, np.full(2, air))
            made, ends = moved_so_far(screw.made, way)
            times, places = np.array([0.0, length]), screw.along(np.array(ends))
            after[: temperature.size] = warmed(made, temperature, beside, times, places).temperature
        if drive.scale is not None:
            after[-1] = followed(drive.scale, float(state[-1]), (air, air), length)
        return after

    def displacement(self, state: Array, positions: Array) -> Array:
        """Return what the error adds to the displacement (k, axes) at positions (k,), m.

        Parameters
        ----------
        state : ndarray, shape (d,)
            Its temperatures, K.
        positions : ndarray, shape (k,)
            Of the axis, m.
        """
        zero = positions[:1] if self.zero is None else np.array([self.zero])
        places = np.concatenate([positions, zero])
        error = positioning_error(self.drive, state, places, np.zeros((places.size, 3)))
        least = 0.0 if self.zero is None else error[-1]
        return np.asarray((error[:-1] - least)[:, None] * self.carried)

    def along(self, kept: Sequence[int]) -> AxisDrive:
        """Return the drive for some of the axes of the displacement."""
        return replace(self, carried=self.carried[kept])


@dataclass(frozen=True, eq=False)
class AxisDrives:
    """The drives of all axes of a machine; None for an axis that has none."""

    #: In the order of the axes.
    each: tuple[AxisDrive | None, ...]

    @cached_property
    def _parts(self) -> list[tuple[int, AxisDrive, slice]]:
        """Axis, drive, and its part of the state of all."""
        driven = [(a, drive) for a, drive in enumerate(self.each) if drive is not None]
        ends = np.cumsum([0, *(drive.cold.size for _, drive in driven)]).tolist()
        return [(*one, slice(*part)) for one, part in zip(driven, pairwise(ends), strict=True)]

    @property
    def cold(self) -> Array:
        """Their temperatures (d,) at the initial ambient, K, one after the other."""
        return np.concatenate([np.zeros(0), *(drive.cold for _, drive, _ in self._parts)])

    def later(self, state: Array, air: float, way: Way, length: float) -> Array:
        """Return their temperatures (d,), K, after a step; as `AxisDrive.later`."""
        after = state.copy()
        for a, drive, part in self._parts:
            own = way.start[a], way.end[a], way.gone[a]
            after[part] = drive.later(state[part], air, own, length)
        return after

    def displacement(self, state: Array, places: Array) -> Array:
        """Return what the errors add to the displacement (k, axes), m, at places (k, x), m.

        Without any drive it is zero, of shape (k, 1).
        """
        added = np.zeros((len(places), 1))
        for a, drive, part in self._parts:
            added = added + drive.displacement(state[part], places[:, a])
        return added


def moved_so_far(
    made: BallScrew, way: tuple[float, float, float]
) -> tuple[BallScrew, tuple[float, float]]:
    """Return a screw and positions between which it is heated and cooled as on a longer way, m.

    Per metre between the positions, which are `SHORTEST` apart at least, it takes the heat of all
    that the nut has gone.
    """
    start, end, gone = way
    if gone <= abs(end - start):
        return made, (start, end)
    if abs(end - start) < SHORTEST:
        middle = 0.5 * (start + end)
        start, end = middle - 0.5 * SHORTEST, middle + 0.5 * SHORTEST
    times, heat = gone / abs(end - start), made.heat
    near, far = heat.bearings
    heat = replace(heat, nut=times * heat.nut, bearings=(times * near, times * far))
    film = replace(made.film, speed=made.film.speed / times)
    return replace(made, heat=heat, film=film), (start, end)


def check_drive(name: str, axis: AxisSection) -> None:
    """Refuse the drive of an axis that heats the machine, or is moved or warmed by it.

    Raises
    ------
    InputError
        It does.
    """
    screw, scale = axis.ball_screw, axis.scale
    given = [] if screw is None else [f"surface at its {part}" for part in screw.surfaces()]
    if any(seats_of(axis)):
        given.append("seat")
    if scale is not None and scale.follows is not None:
        given.append("probe that it follows")
    if given:
        raise InputError(
            f"joint-aware: axes.{name}: its drive has a {given[0]}; that of a model stands on "
            "ground that neither warms nor moves: leave it out"
        )


def drive_on(
    axis: AxisSection, material: MaterialSection | None, carried: Array
) -> AxisDrive | None:
    """Return the drive of a case's axis, or None if it has none.

    Parameters
    ----------
    axis : AxisSection
        The axis, by `check_drive`.
    material : MaterialSection, optional
        Of its screw.
    carried : ndarray, shape (axes,)
        As in `AxisDrive`.
    """
    if axis.ball_screw is None and axis.scale is None:
        return None
    zero = None if axis.zero_mm is None else MILLI * axis.zero_mm
    return AxisDrive(axis.ball_screw, material, axis.scale, zero, carried)


def carried_along(
    drives: AxisDrives, times: Array, air: Array, positions: Array, gone: Array
) -> Array:
    """Return what the errors of drives add to a displacement (n, axes), m, from a cold start.

    Parameters
    ----------
    drives : AxisDrives
        The drives.
    times : ndarray, shape (n,)
        From the start, s.
    air : ndarray, shape (n,)
        The ambient, K.
    positions : ndarray, shape (n, x)
        Of the axes, between which they move evenly, m.
    gone : ndarray, shape (n, x)
        How far they have gone since the first one, m.
    """
    state, found = drives.cold, [drives.displacement(drives.cold, positions[:1])[0]]
    for k in range(1, times.size):
        told = gone[k] - gone[k - 1]
        way = way_between(*map(np.ndarray.tolist, (positions[k - 1], positions[k], told)))
        state = drives.later(state, float(air[k]), way, float(times[k] - times[k - 1]))
        found.append(drives.displacement(state, positions[k : k + 1])[0])
    return np.array(found)
