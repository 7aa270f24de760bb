"""Drives of axes on the modes of a machine: ball screws and scales, as `fesim.axes.positioning`.

A ball screw warms up by its own motion and exchanges heat with surfaces of the machine; a scale
follows the ambient or a probe; both stand on seats that the machine displaces. The positioning
error is the displacement of an axis that its control does not see.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fesim.axes.ball_screw import Beside, moved_so_far, warmed
from fesim.axes.guideway import Place
from fesim.axes.positioning import (
    Drive,
    Surfaces,
    cold,
    followed,
    positioning_error,
    scale_of,
    screw_of,
    screw_temperature,
    seated,
)
from fesim.axes.setup import TURNED, MovingSetup
from fesim.case.drive_sections import BallScrewSection, ScaleSection
from fesim.case.schema import Case, heated_by_drives
from fesim.case.thermal_sections import MaterialSection
from fesim.setup.structure import material_of
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.axis_way import Way

#: Heat of a screw in its case.
HEATS = ("nut_torque_Nm", "bearing_torque_Nm", "far_bearing_torque_Nm", "motor_heat_W")
#: Displacement of a seat that makes no screw go slack, m.
TIGHT = 1e-9


@dataclass(frozen=True, eq=False)
class AxisDrive:
    """A ball screw or a scale, or both."""

    #: As in the case.
    screw: BallScrewSection | None
    #: Of the screw.
    material: MaterialSection | None
    #: As in the case; the control then reads it.
    scale: ScaleSection | None
    #: Position at which the error is zero at all times, m.
    zero: float | None
    #: Shape (axes,): displacement per m that the bodies on the axis move along it.
    carried: Array
    #: Shape (3,): columns in `AxisDrives.heated` of the surfaces at the nut, the near and the far
    #: bearing; -1 where there is none.
    column: NDArray[np.int64]
    #: Row of `AxisDrives.felt` that the scale follows; -1 for the ambient.
    follows: int
    #: Shape (3,): displacement probes of the near and the far bearing and of the scale, along the
    #: axis; -1 for none.
    seat: NDArray[np.int64]

    @cached_property
    def drive(self) -> Drive:
        """The drive for the simulator, on ground with which it exchanges no heat."""
        screw = None
        if self.screw is not None and self.material is not None:
            screw = screw_of(self.screw, material_of(self.material))
        scale = None if self.scale is None else scale_of(self.scale)
        none = Surfaces(np.full(3, -1), np.zeros((3, 0)))
        return Drive(screw, scale, None, 0, self.zero, none, self.seat)

    def along(self, kept: Sequence[int]) -> AxisDrive:
        """Return the drive for some of the axes of the displacement."""
        fewer = self.carried.size - len(kept)
        seat = np.where(self.seat >= 0, self.seat - fewer, -1)
        return replace(self, carried=self.carried[kept], seat=seat)

    def scaled(self, by: Mapping[str, float]) -> AxisDrive:
        """Return the drive with factors on its fitted quantities (`scalable`), by their names."""
        screw, scale = self.screw, self.scale
        if screw is not None:
            rotating, heat, film = screw.rotating_film, by["screw heat"], by["screw film"]
            if rotating is not None:
                added = film * rotating.added_W_m2K
                rotating = rotating.model_copy(update={"added_W_m2K": added})
            values = {name: heat * getattr(screw, name) for name in HEATS}
            films = {"film_W_m2K": film * screw.film_W_m2K, "rotating_film": rotating}
            screw = screw.model_copy(update=values | films)
        if scale is not None:
            values = {
                "expansion_1_K": by["scale expansion"] * scale.expansion_1_K,
                "lag_s": by["scale lag"] * scale.lag_s,
            }
            scale = scale.model_copy(update=values)
        return replace(self, screw=screw, scale=scale)

    @property
    def scalable(self) -> tuple[str, ...]:
        """Quantities that a fit may change: those that are not zero in the case."""
        found = list[str]()
        if (screw := self.screw) is not None and any(getattr(screw, name) for name in HEATS):
            found += ["screw heat", "screw film"]
        if self.scale is not None:
            found += ["scale expansion", "scale lag"] if self.scale.lag_s else ["scale expansion"]
        return tuple(found)


@dataclass(frozen=True, eq=False)
class AxisDrives:
    """The drives of all axes of a machine with r modes."""

    #: In the order of the axes; None for an axis that has none.
    each: tuple[AxisDrive | None, ...]
    #: Shape (r, c): drive of the modes per W at each of the surfaces that screws heat.
    heated: Array
    #: Shape (c + f, r): mean temperatures of these surfaces, K, then of probes that scales follow.
    felt: Array

    @cached_property
    def _parts(self) -> list[tuple[int, AxisDrive, slice]]:
        """Axis, drive, and its part of the state of all."""
        driven = [(a, drive) for a, drive in enumerate(self.each) if drive is not None]
        ends = np.cumsum([0, *(cold(drive.drive).size for _, drive in driven)]).tolist()
        return [(*one, slice(*part)) for one, part in zip(driven, pairwise(ends), strict=True)]

    @property
    def any(self) -> bool:
        """Whether there is one."""
        return bool(self._parts)

    @property
    def cold(self) -> Array:
        """Their temperatures (d,) at the initial ambient, K: of screws, each before its scale."""
        return np.concatenate([np.zeros(0), *(cold(one.drive) for _, one, _ in self._parts)])

    @property
    def lasts(self) -> float:
        """Longest time constant of the temperature of a drive, s."""
        lasting = [0.0]
        for _, one, _ in self._parts:
            if (screw := one.drive.screw) is not None:
                along = screw.made.conduction
                film = screw.made.film.still * along.surface / along.capacity
                lasting.append(1.0 / float(along.rates.min() + film))
            if (scale := one.drive.scale) is not None:
                lasting.append(scale.lag)
        return max(lasting)

    def along(self, kept: Sequence[int]) -> AxisDrives:
        """Return the drives for some of the axes of the displacement, before their seats."""
        each = tuple(None if one is None else one.along(kept) for one in self.each)
        return replace(self, each=each)

    def turned(
        self, rows: Callable[[Array], Array], columns: Callable[[Array], Array]
    ) -> AxisDrives:
        """Return the drives on other modes, by transforms of rows (..., r) and columns (r, ...)."""
        return replace(self, heated=columns(self.heated), felt=rows(self.felt))

    def scaled(self, factors: Sequence[Mapping[str, float]]) -> AxisDrives:
        """Return the drives with factors of each axis, as for `AxisDrive.scaled`."""
        pairs = zip(self.each, factors, strict=True)
        each = tuple(None if one is None else one.scaled(by) for one, by in pairs)
        return replace(self, each=each)

    def driving(self, ambient: int, first: int) -> list[Drive | None]:
        """Return the drives for the simulator, on these modes.

        Parameters
        ----------
        ambient, first : int
            Indices of the ambient and of the heat of the first heated surface in a step's inputs.
        """
        found: list[Drive | None] = [None] * len(self.each)
        rows = np.pad(self.felt, ((0, 1), (0, 0)))
        for a, one, _ in self._parts:
            column = np.where(one.column >= 0, first + one.column, -1)
            found[a] = replace(
                one.drive,
                followed=rows[one.follows] if one.follows >= 0 else None,
                ambient=ambient,
                surfaces=Surfaces(column, rows[one.column]),
            )
        return found

    def warmed(
        self, state: Array, felt: Array, air: float, way: Way, length: float
    ) -> tuple[Array, Array]:
        """Take a step of the screws; scales stay.

        Parameters
        ----------
        state : ndarray, shape (d,)
            Before, K.
        felt : ndarray, shape (c + f,)
            Temperatures beside them before the step, by `felt`, K.
        air : float
            The ambient, K.
        way : Way
            Of the axes.
        length : float
            Of the step, s.

        Returns
        -------
        tuple of ndarray, shapes (d,) and (c,)
            Temperatures after it, K; mean heat of the surfaces that they heat, W.
        """
        after, heat = state.copy(), np.zeros(self.heated.shape[1] + 1)
        # Index -1 is the ambient, and is not heated.
        around, times = np.append(felt, air), np.array([0.0, length])
        for a, one, part in self._parts:
            if (screw := one.drive.screw) is None:
                continue
            temperature = screw_temperature(screw, state[part])
            made, ends = moved_so_far(screw.made, (way.start[a], way.end[a], way.gone[a]))
            beside = Beside(air, around[one.column[1:]])
            step = warmed(made, temperature, beside, times, screw.along(np.array(ends)))
            after[part.start : part.start + temperature.size] = step.temperature
            heat[one.column] = screw.spared * way.gone[a] / length + np.append(0.0, step.seated)
        return after, heat[:-1]

    def followed(self, state: Array, ends: tuple[Array, Array], air: float, length: float) -> Array:
        """Take a step of the scales; return the temperatures of all drives after it, (d,), K.

        Parameters
        ----------
        state : ndarray, shape (d,)
            By `warmed`, K.
        ends : tuple of ndarray, shape (c + f,)
            Temperatures beside them before and after the step, by `felt`, K.
        air, length : float
            As for `warmed`.
        """
        after = state.copy()
        start, end = (np.append(one, air) for one in ends)
        for _, one, part in self._parts:
            if (scale := one.drive.scale) is not None:
                at, place = one.follows, part.stop - 1
                beside = float(start[at]), float(end[at])
                after[place] = followed(scale, float(state[place]), beside, length)
        return after

    @cached_property
    def seated_zeros(self) -> dict[int, float]:
        """Zero positions, m, of the axes whose drive stands on seats and has one."""
        found = ((a, one) for a, one, _ in self._parts if (one.seat >= 0).any())
        return {a: one.zero for a, one in found if one.zero is not None}

    def with_zeros(self, places: Array) -> Array:
        """Return places (..., x), m, followed by those at the zeros of drives, (..., 1 + z, x).

        One drive after the other, the other axes at the place; only for drives on seats, whose
        displacement depends on the positions.
        """
        every = np.repeat(places[..., None, :], 1 + len(self.seated_zeros), axis=-2)
        for z, (a, zero) in enumerate(self.seated_zeros.items(), start=1):
            every[..., z, a] = zero
        return every

    def displacement(self, state: Array, places: Array, probes: Array) -> Array:
        """Return the displacement (..., k, axes), m, with the positioning errors of the axes.

        Parameters
        ----------
        state : ndarray, shape (..., d)
            Temperatures of the drives, K.
        places : ndarray, shape (..., k + z, x)
            Positions of the axes, m; the last z of them by `with_zeros`.
        probes : ndarray, shape (..., k + z, p)
            Displacement probes there, m, of the axes of the displacement and of seats.
        """
        if not self._parts:
            return probes
        count = places.shape[-2] - len(self.seated_zeros)
        right = {a: count + z for z, a in enumerate(self.seated_zeros)}
        found = probes[..., :count, : self._parts[0][1].carried.size].copy()
        for a, one, part in self._parts:
            own, at = state[..., part], places[..., a]
            error = positioning_error(one.drive, own, at, seated(one.drive, probes))
            if a in right:
                error = error - error[..., right[a], None]
            elif one.zero is not None:
                # On fixed ground.
                there = np.full_like(at[..., :1], one.zero)
                ground = np.zeros((*there.shape, 3))
                error = error - positioning_error(one.drive, own, there, ground)
            found += error[..., :count, None] * one.carried
        return found

    def tangent(self, rows_at: Callable[[Place], Array], place: Place) -> Array:
        """Return rows (axes, n) of the displacement from those of its probes, seats included.

        Parameters
        ----------
        rows_at : callable
            Rows (p, n) of the displacement probes while the axes stand at a place.
        place : tuple of float, length x
            Where they stand, m. Screws that are held at both ends are tight.
        """
        places = self.with_zeros(np.array(place))
        rows = np.concatenate([rows_at(tuple(at)) for at in places.tolist()])
        # Each row displaces its own probe.
        probes = TIGHT * np.eye(len(rows)).reshape(len(rows), len(places), -1)
        moved = self.displacement(self.cold, places, probes)[:, 0]
        return np.asarray(moved.T / TIGHT @ rows)


def drives_on(case: Case, ready: MovingSetup) -> AxisDrives:
    """Return the drives of a case's axes, on the modes of its set-up.

    Parameters
    ----------
    case : Case
        The machine.
    ready : MovingSetup
        Of this case; `displacement_probes` are those of the drives.
    """
    first, count = len(case.sources), len(heated_by_drives(case))
    inputs = ready.setup.machine.thermal.inputs
    felt, each = [np.zeros(len(inputs))] * count, list[AxisDrive | None]()
    probes = displacement_probes(ready).tolist()
    for axis in ready.axes:
        if (drive := axis.drive) is None:
            each.append(None)
            continue
        section = case.axes[axis.name]
        column, follows = drive.surfaces.column, -1
        for at, row in zip(column, drive.surfaces.temperature, strict=True):
            if at >= 0:
                felt[at - first] = row
        if drive.followed is not None:
            follows, felt = len(felt), [*felt, drive.followed]
        screw = section.ball_screw
        each.append(
            AxisDrive(
                screw,
                None if screw is None else case.materials[screw.material],
                section.scale,
                drive.zero,
                axis.carried,
                np.where(column >= 0, column - first, -1),
                follows,
                np.array([probes.index(at) if at >= 0 else -1 for at in drive.seat]),
            )
        )
    rows = np.array(felt).reshape(len(felt), len(inputs))
    return AxisDrives(tuple(each), inputs[:, first : first + count], rows)


def displacement_probes(ready: MovingSetup) -> NDArray[np.int64]:
    """Return the indices of a set-up's displacement probes in a model: all but rotations."""
    every = np.arange(len(ready.setup.machine.contact.elastic.probe_thermal))
    rotations = every[TURNED] if ready.turned else every[:0]
    return np.setdiff1d(every, rotations)
