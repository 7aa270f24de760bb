"""Set-up of a case with moving axes: every body is factorised and reduced once."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, kron, vstack

from fesim.axes.axis import Axis, Volume
from fesim.axes.collision import Wanted, check_collisions
from fesim.axes.condensation import TiedCondensations, Ties, condense_apart
from fesim.axes.guideway import GuideStations, Guideway
from fesim.axes.machine import MovingMachine
from fesim.axes.operators import GuidedOperators, guided_operators, places_at
from fesim.axes.positioning import Drive, Screw, Surfaces, scale_of, screw_of
from fesim.cache import remembered
from fesim.case.axis_section import AxisSection, seats_of
from fesim.case.drive_sections import HEATED
from fesim.case.history import History, read_history, step_history
from fesim.case.identity import thermal_key
from fesim.case.schema import Case, heated_by_drives, step_count
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.march.passing import Rows
from fesim.march.reduced import (
    DISPLACEMENT_ERROR,
    GAP_ERROR,
    TEMPERATURE_ERROR,
    ThermalModes,
    project_heat,
    shortest,
    thermal_modes,
)
from fesim.march.start_field import start_field
from fesim.setup.discretised import (
    Discretised,
    discretised,
    elastic_structure,
    relative_rows,
)
from fesim.setup.loads import MarchInputs, input_layout, march_inputs
from fesim.setup.machine import CacheKeys, Setup, cache_keys
from fesim.setup.parts import Parts, make_parts, unit_direction
from fesim.setup.soundness import explained_by_size, suspicions
from fesim.setup.structure import material_of, measured_points
from fesim.setup.temperature_dependence import convecting_surfaces
from fesim.solid.condensation import ThermalCondensation
from fesim.solid.reduction import reduce_apart
from fesim.solid.rotation import rotation_rows
from fesim.solid.spaces import probe_cells, probe_rows
from fesim.solid.substructures import UntiedCondensation
from meshes.travel import Travel, stations_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI

#: A rotation is weighted as its displacement at this distance, m.
LEVER = 0.1
#: Displacement probes that are rotations, if requested.
TURNED = slice(3, 6)
#: Number of positions along the stroke with displacements if the case specifies none.
USUAL = 5
#: A recorded position this far beyond an end of the stroke, mm, is that end.
STROKE_SLACK = 2e-3
#: Numbers in the matrices of pads and stations, condensed apart: 3.2 GB.
MOST_NUMBERS = 400_000_000


@dataclass(frozen=True)
class MovingSetup:
    """A condensed case with moving axes."""

    #: Set-up of the machine at its position at time zero, without fields or other step lengths.
    setup: Setup
    #: The machine at all positions.
    moving: MovingMachine
    #: In the order of the case.
    axes: tuple[Axis, ...]
    #: Whether the displacement probes include rotations.
    turned: bool
    #: Requested combinations of positions.
    volume: Volume


def set_up_axes(case: Case) -> MovingSetup:
    """Build, check and condense a case with axes.

    Raises
    ------
    InputError
        As `fesim.setup.machine.set_up`; or a position is outside the stroke, or pads leave their
        guide or cover the same part of it as those of another axis.
    """
    before = thermal_key(case)
    courses = [course_of(axis, name) for name, axis in case.axes.items()]
    parts = make_parts(case)
    for line in suspicions(parts.structure, parts.joints):
        warnings.warn(line, stacklevel=2)
    _check_guides(case, parts)
    _check_seats(case, parts)
    asked, volume = [asked_positions(axis) for axis in case.axes.values()], volume_of(case)
    check_collisions(case, parts, Wanted(courses, asked, volume.places))
    with explained_by_size(parts.structure):
        whole = discretised(case, parts)
        moving, modes = _moving(whole, cache_keys(case, before))
    at_zero = tuple(float(course(np.zeros(1))[0]) for course in courses)
    setup = Setup(
        case=case,
        structure=parts.structure,
        spaces=whole.spaces,
        joints=parts.joints,
        machine=moving.standing(at_zero),
        make_field=_unavailable,
        probes=parts.probes,
        probe_rows=whole.rows @ modes.basis,
        modes=modes,
        constraints=parts.constraints,
        forces=np.zeros((whole.spaces.displacement_size, 0)),
        outputs=None,
        bolts=None,
        materials=whole.materials,
        make_thermal=_unavailable,
        make_mesh_errors=lambda *_: None,
    )
    axes = tuple(
        Axis(
            name,
            course,
            wanted,
            reference_of(axis),
            drive_of(case, setup, name, surfaces_of(whole, modes, name)),
            _carried(case, axis, parts),
        )
        for (name, axis), course, wanted in zip(case.axes.items(), courses, asked, strict=True)
    )
    return MovingSetup(setup, moving, axes, turned_within(case) is not None, volume)


def axis_inputs(case: Case) -> MarchInputs:
    """Return the inputs of a case with axes; the last ones are the frictional heat of motion."""
    return replace(march_inputs(case), forces=[step_history(0.0) for _ in case.axes])


def course_of(axis: AxisSection, name: str) -> History:
    """Return the position of an axis, m, as a function of time.

    Raises
    ------
    InputError
        The history is invalid or leaves the stroke.
    """
    if axis.file is None:
        return step_history(MILLI * (axis.position_mm or 0.0))
    course = read_history(axis.file, "position_mm")
    low, high = axis.stroke_mm
    within = np.clip(course.values, low, high)
    outside = np.flatnonzero(np.abs(course.values - within) > STROKE_SLACK)
    if outside.size:
        at = outside[0]
        raise InputError(
            f"axes.{name}: {axis.file}: {course.values[at]:g} mm at {course.times[at]:g} s is "
            f"outside stroke_mm, {low:g} to {high:g} mm; correct the history or the stroke"
        )
    return History(course.times, MILLI * within)


def aligned_positions(axis: AxisSection) -> Array:
    """Return the positions without interpolation, at most a station length apart, m."""
    low, high = axis.stroke_mm
    count = int(np.ceil((high - low) / axis.station_mm - 1e-9))
    return MILLI * np.linspace(low, high, count + 1)


def asked_positions(axis: AxisSection) -> Array:
    """Return the positions at which displacements are requested, m."""
    if axis.asked_mm is None:
        return MILLI * np.linspace(*axis.stroke_mm, USUAL)
    return MILLI * np.array(axis.asked_mm)


def reference_of(axis: AxisSection) -> float:
    """Return P0 of the line over the stroke, m: the middle unless the case specifies it."""
    given = axis.reference_mm
    return MILLI * (0.5 * sum(axis.stroke_mm) if given is None else given)


def turned_within(case: Case) -> float | None:
    """Return the radius, m, of the nodes for the rotation at a point; None if not requested."""
    wanted = (axis.rotation_within_mm for axis in case.axes.values())
    return next((MILLI * radius for radius in wanted if radius is not None), None)


def volume_of(case: Case) -> Volume:
    """Return the combinations of positions requested in a case; none if there are none."""
    if case.volume is None:
        return Volume(np.zeros((0, len(case.axes))), np.zeros(0, dtype=np.int64))
    step, end = case.march.step_s, step_count(case.march)
    times = case.volume.at_s
    steps = [end] if times is None else [max(0, round(time / step)) for time in times]
    return Volume(MILLI * np.array(case.volume.places_mm(list(case.axes))), np.unique(steps))


def drive_of(case: Case, setup: Setup, name: str, surfaces: Surfaces) -> Drive | None:
    """Return the drive of an axis of a case; None if the bodies are at the commanded position.

    Parameters
    ----------
    case : Case
        The case with the axis.
    setup : Setup
        Set-up of the same machine, independent of its drives.
    name : str
        Name of the axis.
    surfaces : Surfaces
        Surfaces heated by its screw.
    """
    axis = case.axes[name]
    if axis.ball_screw is None and axis.scale is None:
        return None
    screw = scale = followed = None
    if (section := axis.ball_screw) is not None:
        screw = screw_of(section, material_of(case.materials[section.material]))
        _check_bearings(screw, surfaces, setup.machine.thermal)
    if axis.scale is not None:
        scale = scale_of(axis.scale)
        if axis.scale.follows is not None:
            followed = setup.probe_rows[list(setup.probes).index(axis.scale.follows)]
    zero = None if axis.zero_mm is None else MILLI * axis.zero_mm
    first = TURNED.stop if turned_within(case) is not None else TURNED.start
    seats = {seat: first + k for k, seat in enumerate(_all_seats(case))}
    seat = np.array([-1 if at is None else seats[name, at] for at in seats_of(axis)])
    return Drive(screw, scale, followed, input_layout(case).ambient, zero, surfaces, seat)


def _check_bearings(screw: Screw, surfaces: Surfaces, thermal: ThermalCondensation) -> None:
    """Refuse bearings that would make a surface oscillate, as its temperature lags one step."""
    for end, sink in enumerate(screw.made.conduction.sinks):
        column = surfaces.column[1 + end]
        if column < 0:
            continue
        warmed = surfaces.temperature[1 + end] @ thermal.factor.solve(thermal.inputs[:, column])
        if sink * warmed > 1.0:
            raise InputError(
                f"axes: bearing_conductance_W_K: one step of {thermal.step:g} s would bring the "
                f"surface of the {HEATED[1 + end]} past the temperature of the screw; take a "
                "shorter march.step_s, or name a larger surface"
            )


def surfaces_of(whole: Discretised, modes: ThermalModes, name: str) -> Surfaces:
    """Return the surfaces heated by an axis's screw, with nodes weighted as for uniform heat."""
    case = whole.case
    columns = {heated: len(case.sources) + k for k, heated in enumerate(heated_by_drives(case))}
    own = np.array([columns.get(f"{name} {part}", -1) for part in HEATED])
    weights = np.zeros((len(HEATED), whole.heat.inputs.shape[0]))
    for row, column in zip(weights, own, strict=True):
        if column >= 0:
            row[:] = whole.parts.structure.symmetry_factor * whole.heat.inputs[:, column]
    return Surfaces(own, weights @ modes.basis)


def _carried(case: Case, axis: AxisSection, parts: Parts) -> Array:
    """Direction of an axis if it moves the point of `[displacement]`, less that of its origin."""
    moves = _moving_points(parts, axis, measured_points(case)).astype(np.float64)
    return float(moves[0] - moves[1:].sum()) * unit_direction(axis)


def _moving_points(parts: Parts, axis: AxisSection, names: Sequence[str]) -> NDArray[np.bool_]:
    """Whether each probe is on a body that moves along an axis."""
    if not names:
        return np.zeros(0, dtype=bool)
    moving = np.concatenate([parts.structure.bodies[name] for name in axis.bodies])
    probes = {name: parts.structure.probes[name] for name in names}
    moves = dict(zip(probes, np.isin(probe_cells(parts.structure, probes), moving), strict=True))
    return np.array([moves[name] for name in names])


def _moving(whole: Discretised, keys: CacheKeys) -> tuple[MovingMachine, ThermalModes]:
    """Condense pads, guides and modes once; combinations of positions are tied when needed."""
    case, parts = whole.case, whole.parts
    positions, operators = operators_of(whole)
    _check_held(whole, operators)
    _check_size(whole, operators)
    apart = _apart(whole, operators, _probes(whole), keys.elasticity)
    modes = _modes(whole, operators, apart, keys.heat)
    area = operators.pads.area
    ties = Ties(apart.springs, apart.compliance, operators.place, area, whole.springs)
    elastic = TiedCondensations(ties, apart.thermal @ modes.basis)
    thermal = project_heat(whole.heat, operators.pads, case.march.step_s, modes)
    copies = parts.structure.symmetry_factor
    thermal = _with_friction(thermal, len(positions), copies)
    running = [
        np.full(joint.area.size, case.joints[joint.name].running_friction_coefficient)
        for joint in parts.joints
    ]
    rows = _rows(thermal, operators, modes)
    guideway = Guideway(
        GuideStations(positions, operators.place),
        elastic,
        rows.temperature,
        operators.pads.mean @ modes.basis,
        np.concatenate(running) * operators.pads.area,
    )
    machine = CondensedMachine(
        thermal,
        ContactProblem(guideway.first, parts.laws, constraints=parts.constraints),
        start=start_field(whole.heat, whole.warm, modes),
    )
    return MovingMachine(machine, guideway, rows, copies), modes


def operators_of(whole: Discretised) -> tuple[tuple[Array, ...], GuidedOperators]:
    """Return the aligned positions (k,) of every axis, m, and the rows of pads and stations."""
    case, parts = whole.case, whole.parts
    positions = tuple(map(aligned_positions, case.axes.values()))
    travels = [
        Travel(
            name,
            axis.bodies,
            {
                rides: (joint.along, joint.across)
                for rides, joint in case.joints.items()
                if joint.axis == name
            },
            (aligned - MILLI * axis.mesh_position_mm)[:, None] * unit_direction(axis),
        )
        for (name, axis), aligned in zip(case.axes.items(), positions, strict=True)
    ]
    stations = stations_of(parts.structure, parts.joints, travels)
    return positions, guided_operators(parts.joints, stations, whole.spaces)


def _probes(whole: Discretised) -> csr_array:
    """Rows of the displacement between tool and workpiece, then of the rotation if requested.

    Then of the seats of the drives, each along its axis.
    """
    case, structure = whole.case, whole.parts.structure
    rows = [relative_rows(whole)]
    if (radius := turned_within(case)) is not None:
        point, *origin = (
            rotation_rows(structure, whole.spaces, name, radius) for name in measured_points(case)
        )
        rows.append(point - origin[0] if origin else point)
    for name, seat in _all_seats(case):
        along = csr_array(unit_direction(case.axes[name])[None])
        at = {seat: structure.probes[seat]}
        rows.append(kron(probe_rows(whole.spaces.displacement, structure, at), along))
    return csr_array(vstack(rows, format="csr"))


def _all_seats(case: Case) -> list[tuple[str, str]]:
    """Axes, and the probes at the seats of their drives, each once."""
    return [(name, seat) for name, axis in case.axes.items() for seat in _seats(axis)]


def _seats(axis: AxisSection) -> list[str]:
    """Probes at the seats of a drive, each once."""
    return list(dict.fromkeys(name for name in seats_of(axis) if name is not None))


def _apart(
    whole: Discretised, operators: GuidedOperators, probes: csr_array, key: str | None
) -> UntiedCondensation:
    solid = elastic_structure(whole)
    return remembered(
        UntiedCondensation,
        key,
        lambda: condense_apart(solid.one_by_one(), operators, probes, solid.shape[1]),
    )


def _modes(
    whole: Discretised, operators: GuidedOperators, apart: UntiedCondensation, key: str | None
) -> ThermalModes:
    """Modes of each body for heat at every pad and every station."""
    march, pads = whole.case.march, operators.pads
    by_body = partial(reduce_apart, solver=march.solver)
    every = replace(pads, jump=csr_array(vstack([pads.jump, operators.heat], format="csr")))
    ties = pads.gap.shape[0] + operators.gap.shape[0]
    moved = apart.thermal[apart.springs.size :] / DISPLACEMENT_ERROR
    if turned_within(whole.case) is not None:
        moved[TURNED] *= LEVER
    outputs = np.vstack(
        [whole.rows.toarray() / TEMPERATURE_ERROR, apart.thermal[:ties] / GAP_ERROR, moved]
    )
    return remembered(
        ThermalModes,
        key,
        partial(thermal_modes, whole.heat, every, outputs, march.step_s, by_body, whole.warm),
        also=f"along the stroke from {shortest(march.step_s)!r} s",
    )


def _rows(thermal: ThermalCondensation, operators: GuidedOperators, modes: ThermalModes) -> Rows:
    temperature = np.vstack([operators.pads.jump @ modes.basis, operators.heat @ modes.basis])
    influence = thermal.factor.solve(np.ascontiguousarray(temperature.T))
    influence[modes.rates.size :] = 0.0  # held surfaces do not change
    return Rows(temperature, np.ascontiguousarray(influence.T), temperature @ influence)


def _with_friction(thermal: ThermalCondensation, axes: int, copies: int) -> ThermalCondensation:
    """Add inputs for the frictional heat of motion of each axis, W, of all copies.

    They only enter the balance: a step distributes the heat over the rows (`Passing.rubbed`).
    """
    balance = thermal.balance
    return replace(
        thermal,
        inputs=np.pad(thermal.inputs, ((0, 0), (0, axes))),
        balance=replace(
            balance,
            entering=np.pad(balance.entering, (0, axes), constant_values=1.0 / copies),
            drive=np.pad(balance.drive, ((0, 0), (0, axes))),
        ),
    )


def _check_guides(case: Case, parts: Parts) -> None:
    """Refuse convection from a guide's surface, whose covered part depends on the position."""
    for name, joint in case.joints.items():
        if joint.axis is None:
            continue
        guide = parts.structure.surfaces[parts.structure.joints[name][1]]
        for surface in convecting_surfaces(case):
            if np.isin(parts.structure.surface(surface), guide).any():
                raise InputError(
                    f"convection_W_m2K.{surface}: contains the guide of joint {name!r}, of which "
                    "the pads cover another part at every position; leave the guide out"
                )


def _check_seats(case: Case, parts: Parts) -> None:
    """Refuse seats of a drive that move along the axis."""
    for name, axis in case.axes.items():
        for seat, moves in zip(
            _seats(axis), _moving_points(parts, axis, _seats(axis)), strict=True
        ):
            if moves:
                raise InputError(
                    f"axes.{name}: the seat {seat!r} is on a body that moves; bearings and scales "
                    "stand, so name a probe of another body"
                )


def _check_held(whole: Discretised, operators: GuidedOperators) -> None:
    riding = places_at(operators.place, (0,) * len(operators.place)) >= 0
    held = whole.heat.held
    for rows in (operators.pads.jump[riding], operators.heat):
        if csr_array(rows[:, held]).count_nonzero():
            raise InputError(
                "held_temperatures: a pad or the guide of an axis touches a held surface; hold the "
                "temperature of another one"
            )


def _check_size(whole: Discretised, operators: GuidedOperators) -> None:
    rows, stations = operators.pads.gap.shape[0] + operators.gap.shape[0], operators.heat.shape[0]
    if rows * (rows + whole.heat.inputs.shape[0]) > MOST_NUMBERS:
        raise InputError(
            f"axes: {stations} stations need gigabytes; raise station_mm, or lower along or across "
            "of the joints"
        )


def check_still(case: Case, where: str) -> None:
    """Refuse a case with axes where its fields are needed; `where` is the place in the message.

    Raises
    ------
    InputError
        The case has axes.
    """
    if case.axes:
        raise InputError(
            f"{where}: the fields of a machine that moves cannot be drawn so far; leave it out"
        )


def _unavailable(*_: object) -> NoReturn:
    raise InputError("axes: neither fields nor steps of another length for a machine that moves")
