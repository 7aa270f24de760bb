"""Actual position of a moving axis relative to the position assumed by its control.

A control with a rotary encoder at the motor counts turns: the nut follows the screw, and is
displaced by the seat of the fixed bearing and by the elongation between that and the nut. A control
with a scale reads the graduation below the reading head, and is displaced by the fixed point of the
scale and by the elongation between that and the head. The positioning error is the position of the
bodies less that of the control. It is zero in a machine at the initial ambient; at `zero`, if
given, at all times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fesim.axes.ball_screw import (
    BallScrew,
    Beside,
    Film,
    Heat,
    Hold,
    Rod,
    conduction_along,
    moved,
    tension,
    warmed,
)
from fesim.case.drive_sections import BallScrewSection, ScaleSection
from fesim.march.exponential import phi_functions
from fesim.march.machine import State, Step
from fesim.solid.materials import Material
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MICRO, MILLI

#: Newtons per metre in N/µm; newtons in kN.
PER_MICRON, KILO = 1e6, 1e3


@dataclass(frozen=True, eq=False)
class Screw:
    """A ball screw on an axis."""

    made: BallScrew
    #: Position of its fixed bearing, m, and the direction of its far end, 1 or -1.
    start: float
    towards: float
    #: Position of the nut while the axis is at zero, m.
    nut: float
    #: Shape (3,): frictional heat of the nut and of the near and the far bearing that the screw
    #: does not take up, J per m of travel.
    spared: Array

    def along(self, positions: Array) -> Array:
        """Return the distance of the nut from the fixed bearing at positions of the axis, m."""
        return self.towards * (positions + self.nut - self.start)

    def apart(self, seats: Array) -> Array:
        """Return the distance by which seats (..., 3) have moved apart, m."""
        return np.asarray(self.towards * (seats[..., 1] - seats[..., 0]))


@dataclass(frozen=True)
class Scale:
    """A scale on an axis."""

    #: Thermal expansion coefficient, 1/K.
    expansion: float
    #: Position of its fixed point, and of the head while the axis is at zero, m.
    fixed: float
    head: float
    #: Time constant of its temperature, s.
    lag: float


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Surfaces of the machine at the nut, the near and the far bearing of a screw."""

    #: Shape (3,): index of the step input of their heat, W; -1 if there is none.
    column: NDArray[np.int64]
    #: Shape (3, r): rows of their mean temperatures; zero if there is none.
    temperature: Array


@dataclass(frozen=True, eq=False)
class Drive:
    """Drive of an axis; its state has the temperatures of the screw, then of the scale."""

    #: Ball screw, if any.
    screw: Screw | None
    #: Scale, if any; the control then reads it.
    scale: Scale | None
    #: Shape (r,): row of the machine temperature that the scale follows; None for the ambient.
    followed: Array | None
    #: Index of the ambient among the inputs of a step.
    ambient: int
    #: Position at which the error is zero at all times, m.
    zero: float | None
    #: Surfaces heated by the screw.
    surfaces: Surfaces
    #: Shape (3,): displacement probe of the machine at the near and the far bearing and at the
    #: scale, along the axis; -1 for none.
    seat: NDArray[np.int64]


@dataclass(frozen=True)
class Way:
    """Motion of an axis in a step."""

    #: Shape (j,): times, s, and positions, m, from start to end, between which it is uniform.
    times: Array
    positions: Array

    @property
    def speed(self) -> float:
        """Mean speed, to and fro, m/s."""
        return float(np.abs(np.diff(self.positions)).sum() / (self.times[-1] - self.times[0]))


def screw_of(section: BallScrewSection, material: Material) -> Screw:
    """Return the screw of a case."""
    length = MILLI * abs(section.far_end_mm - section.fixed_bearing_mm)
    rod = Rod(length, MILLI * section.diameter_mm, material)
    lead = MILLI * section.lead_mm
    sink = section.bearing_conductance_W_K
    sinks = (sink, 0.0 if section.bearings == "fixed-free" else sink)
    # J per m of travel: torque times angle.
    turned = 2.0 * math.pi / lead
    rubbed = turned * np.array(
        [section.nut_torque_Nm, section.bearing_torque_Nm, section.far_bearing_torque_Nm]
    )
    taken = rubbed * [section.nut_share, section.bearing_share, section.bearing_share]
    nut, near, far = taken.tolist()
    heat = Heat(nut, MILLI * section.nut_length_mm, (near, far), section.motor_heat_W)
    made = BallScrew(
        rod, conduction_along(rod, section.cells, sinks), _film(section), heat, _hold(section, rod)
    )
    return Screw(
        made,
        start=MILLI * section.fixed_bearing_mm,
        towards=math.copysign(1.0, section.far_end_mm - section.fixed_bearing_mm),
        nut=MILLI * section.nut_mm,
        spared=rubbed - taken,
    )


def _film(section: BallScrewSection) -> Film:
    rotating = section.rotating_film
    if rotating is None:
        return Film(section.film_W_m2K, 0.0, 1.0, 1.0)
    speed = MILLI * section.lead_mm * rotating.rotation_rpm / 60.0
    return Film(section.film_W_m2K, rotating.added_W_m2K, speed, rotating.exponent)


def _hold(section: BallScrewSection, rod: Rod) -> Hold:
    if section.pretension_kN is not None:
        pulled = KILO * section.pretension_kN
    else:
        stretch = MICRO * (section.stretch_um or 0.0)
        pulled = rod.material.youngs_modulus * rod.area * stretch / rod.length
    near, far = (
        0.0 if stiffness is None else 1.0 / (PER_MICRON * stiffness)
        for stiffness in (section.bearing_stiffness_N_um, section.far_bearing_stiffness_N_um)
    )
    return Hold(pulled, (near, far))


def scale_of(section: ScaleSection) -> Scale:
    """Return the scale of a case."""
    return Scale(
        section.expansion_1_K,
        MILLI * section.fixed_mm,
        MILLI * section.head_mm,
        section.lag_s,
    )


def cold(drive: Drive | None) -> Array:
    """Return the state of a drive (d,) at the initial ambient, K."""
    if drive is None:
        return np.zeros(0)
    cells = 0 if drive.screw is None else len(drive.screw.made.conduction.rates)
    return np.zeros(cells + (drive.scale is not None))


def screw_temperature(screw: Screw, state: Array) -> Array:
    """Return the temperatures (..., n) of a screw in the states (..., d) of its drive, K."""
    return state[..., : len(screw.made.conduction.rates)]


def warm_screw(drive: Drive, state: State, inputs: Array, way: Way) -> tuple[Array, Array]:
    """Take a step of a screw; return its temperature and the heat to the machine.

    Parameters
    ----------
    drive : Drive
        The drive.
    state : State
        State of the march at the start of the step.
    inputs : ndarray, shape (k,)
        Inputs of the machine in the step.
    way : Way
        Motion of the axis in the step.

    Returns
    -------
    temperature : ndarray, shape (n,)
        Temperatures of the screw at the end, K; empty without one.
    inputs : ndarray, shape (k,)
        Inputs with the heat of the surfaces heated by the screw.
    """
    screw, surfaces = drive.screw, drive.surfaces
    if screw is None:
        return np.zeros(0), inputs
    air = float(inputs[drive.ambient])
    felt = np.where(surfaces.column >= 0, surfaces.temperature @ state.temperature, air)
    step = warmed(
        screw.made,
        screw_temperature(screw, state.drive),
        Beside(air, felt[1:]),
        way.times,
        screw.along(way.positions),
    )
    heat = screw.spared * way.speed + np.concatenate([np.zeros(1), step.seated])
    heated = surfaces.column >= 0
    filled = inputs.copy()
    filled[surfaces.column[heated]] = heat[heated]
    return step.temperature, filled


def warm_scale(drive: Drive, state: State, step: Step, length: float) -> Array:
    """Return the temperature of a scale, K, after a step of the machine; empty without one.

    Parameters
    ----------
    drive, state
        As in `warm_screw`.
    step : Step
        The step of the machine.
    length : float
        Length of the step, s.
    """
    if drive.scale is None:
        return np.zeros(0)
    air = float(step.inputs[drive.ambient])
    ends = air, air
    if (row := drive.followed) is not None:
        ends = float(row @ state.temperature), float(row @ step.state.temperature)
    return np.array([followed(drive.scale, float(state.drive[-1]), ends, length)])


def followed(scale: Scale, temperature: float, ends: tuple[float, float], length: float) -> float:
    """Return the temperature of a scale after a step, K.

    Parameters
    ----------
    scale : Scale
        The scale.
    temperature : float
        Temperature at the start, K.
    ends : tuple of float
        Temperature that it follows, at the start and the end, linear in between, K.
    length : float
        Length of the step, s.
    """
    start, end = ends
    if not scale.lag:
        return end
    one = float(phi_functions(np.array([length / scale.lag]))[0][0])
    return start + (temperature - start) * math.exp(-length / scale.lag) + (end - start) * (1 - one)


def seated(drive: Drive, probes: Array) -> Array:
    """Return the displacement (..., 3) of both bearings and of the scale along the axis, m.

    Parameters
    ----------
    drive : Drive
        The drive.
    probes : ndarray, shape (..., p)
        Displacement probes of the machine, m.
    """
    return np.where(drive.seat >= 0, probes[..., drive.seat], 0.0)


def positioning_error(drive: Drive, state: Array, positions: Array, seats: Array) -> Array:
    """Return the position of the bodies less that of the control.

    Parameters
    ----------
    drive : Drive
        The drive.
    state : ndarray, shape (..., d)
        Its temperatures, K.
    positions : ndarray, shape (..., k)
        Positions of the axis, m.
    seats : ndarray, shape (..., k, 3)
        Displacements at these positions, from `seated`.

    Returns
    -------
    ndarray, shape (..., k)
        Error along the axis, m; that at `zero` is not subtracted yet.
    """
    if (scale := drive.scale) is not None:
        from_fixed = positions + scale.head - scale.fixed
        return np.asarray(seats[..., 2] + scale.expansion * state[..., -1:] * from_fixed)
    if (screw := drive.screw) is None:
        return np.zeros_like(positions)
    temperature, places = screw_temperature(screw, state), screw.along(positions)
    grown = moved(screw.made, temperature, places, screw.apart(seats))
    return np.asarray(seats[..., 0] + screw.towards * grown)


def screw_tension(screw: Screw, state: Array, seats: Array) -> Array:
    """Return the tension (...) of a screw, N, from states (..., d) of its drive, seats (..., 3)."""
    apart = screw.apart(seats)[..., None]
    return tension(screw.made, screw_temperature(screw, state), apart)[..., 0]


def station_positions(screw: Screw) -> Array:
    """Return the centres (n,) of the cells of a screw as positions of the axis, m."""
    edges = screw.made.conduction.edges
    return screw.start + screw.towards * 0.5 * (edges[1:] + edges[:-1])
