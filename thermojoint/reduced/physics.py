"""One time step on the modes: heat with the last conductance, then the gap equations.

The same equations as `fesim.march.stepping.staggered`, in two halves: between them the observer
corrects the temperatures. The conductance that the joint has at its preload belongs to the modes'
rates, so that the linear part of the machine is diagonal; only what goes beyond it is solved for
here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from fesim.axes.corner_table import CornerTables
from fesim.axes.guideway import Place, sides
from fesim.axes.mapping import surveyed
from fesim.joint.blocks import one_block
from fesim.joint.loosening import UNWATCHED
from fesim.march.alternation import alternating
from fesim.march.compiled_march import MarchKernel, Moving, march_steps
from fesim.march.compiled_step import (
    HeatStep,
    JointKernel,
    JointState,
    conduct_step,
    heat_work,
    joint_work,
    settle_step,
)
from fesim.march.contact import ContactProblem
from fesim.march.kernel import joint_kernel, new_kept, new_record, owned
from fesim.march.machine import FURTHER
from fesim.march.passing import exchange, leaving
from fesim.march.settling import Rest, settle_along
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced import axes_march
from thermojoint.reduced.axis_way import Way, way_between
from thermojoint.reduced.guided_march import (
    Aligned,
    Guided,
    Guiding,
    Steps,
    aligned_elasticity,
    guided,
    march_along,
    new_steps,
    settle_at,
    there_of,
)
from thermojoint.reduced.machine import (
    Joint,
    Modes,
    conducted,
    contact_of,
    evenly_exchanged,
    rest_of,
)

#: Steps that alternate are halved down to this length, s.
SHORTEST = 0.05
#: Number of positions of axes whose joints are cached.
KEPT = 64


class Driving(NamedTuple):
    """Temperatures of a machine with moving axes."""

    #: Shape (r,): amplitudes of its modes.
    amplitudes: Array
    #: Shape (d,): of the drives, K.
    drive: Array


@dataclass(frozen=True, eq=False)
class Physics:
    """A machine on the modes that diagonalise it with its joint at the preload."""

    #: With the joint held at its preload.
    modes: Modes
    #: Shape (m,): conductance times area that belongs to the modes, W/K.
    held: Array
    #: Its gap equations, without the heat. On axes, those at the first positions.
    contact: ContactProblem

    def standing(self, loads: Array) -> Physics:
        """Return the joints at the positions of the axes, the last of the factors (l,), m.

        Their amplitudes are those of `felt`; they conduct nothing.
        """
        place = place_in(self.modes, loads)
        return self if place is None else _standing(self, place)

    def felt(self, amplitudes: Array, loads: Array) -> Array:
        """Return the amplitudes for the joints of `standing`, at the positions of the axes."""
        way, place = self.modes.way, place_in(self.modes, loads)
        if way is None or place is None:
            return amplitudes
        return way.free_at(place, way.elastic.alone(amplitudes))

    @cached_property
    def held_exchange(self) -> Array:
        """Exchange between the rows of a guideway that the modes include, W/K, (q, q)."""
        assert self.modes.way is not None  # asked for on an axis only
        return evenly_exchanged(self.modes.way, self.held)

    @cached_property
    def aligned(self) -> Aligned:
        """Elasticity at the aligned positions of an axis."""
        assert self.modes.way is not None  # asked for on an axis only
        return aligned_elasticity(self.modes.way, self.contact.laws)

    @cached_property
    def tables(self) -> CornerTables:
        """Combinations of aligned positions of axes, packed for many places at once."""
        assert self.modes.way is not None  # asked for on an axis only
        return CornerTables(self.modes.way)

    @cached_property
    def guided_joint(self) -> JointKernel | None:
        """Data of its compiled steps on an axis, at the first position.

        None for laws that are not compiled, and with several axes.
        """
        if self.modes.way is None or len(self.modes.way.stations.positions) > 1:
            return None
        return joint_kernel(self.contact, np.zeros((self.contacts, 0)), self.held)

    @property
    def contacts(self) -> int:
        """Number of contact elements."""
        return self.held.size

    @cached_property
    def kernel(self) -> JointKernel | None:
        """Data of its compiled steps; None for laws that are not compiled, and on an axis."""
        if self.modes.way is not None:
            return None
        return joint_kernel(self.contact, self.modes.jump, self.held)

    @cached_property
    def rest(self) -> JointState:
        """The joints before the first step; not to be written to."""
        first = self.modes.factors
        here, start = self.standing(first), self.felt(self.modes.start, first)
        return JointState(*rest_of(here.contact, replace(here.modes, start=start)))

    def at_rest(self) -> JointState:
        """The joints before the first step, to continue from."""
        return JointState(*map(np.array, self.rest))

    def beyond_held(self, joint: JointState, amplitudes: Array) -> Array:
        """Conductance times area that the modes do not include, W/K, shape (m,)."""
        rise, jump = self.modes.mean @ amplitudes, self.modes.jump @ amplitudes
        return conducted(self.contact, Rest(*joint), rise, jump) - self.held


@lru_cache(maxsize=KEPT)
def _standing(physics: Physics, place: Place) -> Physics:
    way = physics.modes.way
    assert way is not None  # asked for on an axis only
    elastic = way.contact_at(place)
    unused = np.zeros((physics.contacts, elastic.thermal_gap.shape[1]))
    modes = replace(physics.modes, elastic=elastic, jump=unused, mean=unused, way=None)
    contact = contact_of(modes, physics.contact.laws)
    return Physics(modes, np.zeros_like(physics.held), contact)


def make_physics(modes: Modes, joints: Sequence[Joint], held: Array) -> Physics:
    """Return the physics of a machine whose modes were made with `held`."""
    laws = [(joint.law, joint.conductivity.size) for joint in joints]
    return Physics(modes, held, contact_of(modes, laws))


@lru_cache(maxsize=64)
def heat_step(modes: Modes, length: float) -> HeatStep:
    """Return the step of some length (s); cached, as samples are usually evenly spaced."""
    decay = 1.0 / (1.0 + length * modes.rates)
    entering = modes.drive
    if modes.drives is not None:
        entering = np.hstack([entering, modes.drives.heated])
    drive, influence = (
        np.ascontiguousarray(length * decay[:, None] * influence)
        for influence in (entering, modes.entry)
    )
    return HeatStep(decay, drive, influence, np.ascontiguousarray(modes.jump @ influence))


def conduct(
    physics: Physics,
    amplitudes: Array,
    inputs: Array,
    joint: JointState,
    length: float,
    way: Way | None = None,
) -> Array:
    """Return the amplitudes (r,) after `length` (s) at the joint's previous conductance.

    Parameters
    ----------
    physics : Physics
        The machine.
    amplitudes : ndarray, shape (r,)
        Before.
    inputs : ndarray, shape (s + h + 1 + c,)
        Heat of each source, W, the held surfaces and the ambient, K, and heat of the surfaces that
        screws of axes heat, W.
    joint : JointState
        After the last step.
    length : float
        s.
    way : Way, optional
        Of the axes.
    """
    step = heat_step(physics.modes, length)
    if (kernel := physics.kernel) is not None:
        after = np.array(amplitudes)
        conduct_step(step, kernel, heat_work(kernel), after, inputs, joint.pressure)
        return after
    alone = step.decay * amplitudes + step.drive @ inputs
    if way is not None:
        return _conduct_passing(physics, amplitudes, alone, joint, length, way)
    if not physics.contacts:
        return alone
    beyond = physics.beyond_held(joint, amplitudes)
    system = beyond[:, None] * step.joint_influence
    system.flat[:: len(beyond) + 1] += 1.0
    flow = np.linalg.solve(system, beyond * (physics.modes.jump @ alone))
    return np.asarray(alone - step.influence @ flow)


def conduct_driven(
    physics: Physics, before: Driving, inputs: Array, joint: JointState, length: float, way: Way
) -> Driving:
    """Return amplitudes and drives after `length` (s) of a way; otherwise as `conduct`.

    A screw exchanges heat with its surroundings as they are before the step; a scale follows.
    """
    drives, air = physics.modes.drives, float(inputs[-1])
    assert drives is not None  # there is a way on an axis only
    felt = drives.felt @ before.amplitudes
    state, heat = drives.warmed(before.drive, felt, air, way, length)
    entering = np.append(inputs, heat)
    amplitudes = conduct(physics, before.amplitudes, entering, joint, length, way)
    ends = felt, drives.felt @ amplitudes
    return Driving(amplitudes, drives.followed(state, ends, air, length))


def place_in(modes: Modes, loads: Array) -> Place | None:
    """Return the positions of axes, m, from the factors (l,) of a sample; None without any."""
    if modes.way is None:
        return None
    return tuple(loads[loads.size - len(modes.way.stations.positions) :].tolist())


def positioned(
    physics: Physics, now: Driving, joint: JointState, loads: Array, probes: Array
) -> Array:
    """Return the displacement (axes,), m, from displacement probes (p,), m, at the axes' positions.

    Without drives they are the same. `joint` is settled there.
    """
    drives, place = physics.modes.drives, place_in(physics.modes, loads)
    if drives is None or place is None:
        return probes
    places = drives.with_zeros(np.array(place))
    every = np.vstack([probes, seen_from(physics, joint, now.amplitudes, places[1:])])
    return np.asarray(drives.displacement(now.drive, places, every)[0])


def way_of(modes: Modes, before: Array, loads: Array, gone: Sequence[float] = ()) -> Way | None:
    """Return the way of axes between two samples, by their factors (l,); None without any.

    `gone` (x,) is their travel by odometers, m, if there are any.
    """
    start, end = place_in(modes, before), place_in(modes, loads)
    return None if start is None or end is None else way_between(start, end, gone)


def _conduct_passing(
    physics: Physics,
    amplitudes: Array,
    alone: Array,
    joint: JointState,
    length: float,
    way: Way,
) -> Array:
    """As `conduct`, with heat exchange and friction of pads and the stations that they pass.

    This is the step of `fesim.march.passing`, of which the modes include a part (`held_exchange`);
    `alone` (r,) are the amplitudes without the rest.
    """
    modes, step = physics.modes, heat_step(physics.modes, length)
    assert modes.way is not None  # there is a way on an axis only
    stations, temperature = modes.way.stations, modes.jump @ amplitudes
    passage = stations.passage(way.start, way.end)
    jump, rise = sides(passage.coefficients, temperature, modes.way.means @ amplitudes)
    each = conducted(physics.contact, Rest(*joint), rise, jump)
    beyond = exchange(passage.touches, each, stations.size) - physics.held_exchange
    if any(way.gone):
        ridden = stations.ridden(way.gone).sum(axis=0)
        rubbing = modes.way.friction_heat(joint.pressure, ridden, length)
        alone = alone + step.influence @ stations.rubbed(rubbing, passage.shares)
    left = leaving(beyond, step.joint_influence, modes.jump @ alone)
    return np.asarray(alone - step.influence @ left)


def settle_joint(
    physics: Physics, joint: JointState, amplitudes: Array, loads: Array
) -> tuple[JointState, Array]:
    """Return the joint in equilibrium with the temperatures, and displacement probes (p,), m.

    Those are the axes of the displacement, and seats of drives: `positioned`.

    Parameters
    ----------
    physics : Physics
        The machine.
    joint : JointState
        Before.
    amplitudes : ndarray, shape (r,)
        After the step.
    loads : ndarray, shape (l,)
        Factors of the loads, like `Modes.factors`.

    Raises
    ------
    ConvergenceError
        The gap equations have no solution that Newton's method finds.
    """
    if physics.modes.way is not None:
        settled = _settle_guided(physics, joint, amplitudes, float(loads[-1]))
        if settled is not None:
            return settled
        physics, amplitudes = physics.standing(loads), physics.felt(amplitudes, loads)
    kernel = physics.kernel
    if kernel is not None:
        after = JointState(*map(np.array, joint))
        displacement = np.empty(len(physics.modes.elastic.probe_thermal))
        work = joint_work(kernel)
        if settle_step(kernel, work, amplitudes, loads, after, displacement) == 0:
            return after, displacement
    return settle_plainly(physics, joint, amplitudes, loads)


def _settle_guided(
    physics: Physics, joint: JointState, amplitudes: Array, position: float
) -> tuple[JointState, Array] | None:
    """As `settle_joint`, with the axis at a position, m; None where it needs the plain method."""
    if (kernel := physics.guided_joint) is None:
        return None
    aligned = physics.aligned
    there = there_of(aligned, kernel)
    after = JointState(*map(np.array, joint))
    alone, work = np.ascontiguousarray(amplitudes), joint_work(there.joint)
    settled = settle_at(aligned, there, work, alone, after, position)
    return (after, there.displacement) if settled else None


def settle_plainly(
    physics: Physics, joint: JointState, amplitudes: Array, loads: Array
) -> tuple[JointState, Array]:
    """As `settle_joint`, for laws that are not compiled, and where the joint snaps."""
    physics, amplitudes = physics.standing(loads), physics.felt(amplitudes, loads)
    modes = physics.modes
    if not physics.contacts:
        return joint, moved_by(physics, joint, amplitudes, loads)
    opened = modes.elastic.thermal_gap @ amplitudes + modes.loads.gap @ loads
    settled, _ = settle_along(physics.contact, joint, opened)
    after = JointState(
        settled.gap,
        settled.traction.slip,
        physics.contact.preload + settled.traction.value[0],
        settled.gap - joint.gap,
    )
    return after, moved_by(physics, after, amplitudes, loads)


def seen_from(physics: Physics, joint: JointState, amplitudes: Array, places: Array) -> Array:
    """Return displacement probes (n, p), m, if the axes of a machine stood at places (n, x), m.

    Parameters
    ----------
    physics : Physics
        The machine.
    joint : JointState
        Where they stand; it settles anew at every place.
    amplitudes : ndarray, shape (r,)
        Temperatures.
    places : ndarray, shape (n, x)
        m.

    Raises
    ------
    ConvergenceError
        As `settle_joint`.
    """
    if not len(places):
        return np.empty((0, len(physics.modes.elastic.probe_thermal)))
    assert physics.modes.way is not None  # asked for on an axis only
    alone = physics.modes.way.elastic.alone(amplitudes)
    found = surveyed(physics.contact, physics.tables, (joint.gap, joint.slip), alone, places)
    joint = joint._replace(change=np.zeros_like(joint.change))
    for at in np.flatnonzero(np.isnan(found.residual)):
        found.displacement[at] = settle_joint(physics, joint, amplitudes, places[at])[1]
    return found.displacement


def moved_by(physics: Physics, joint: JointState, amplitudes: Array, loads: Array) -> Array:
    """Return displacement probes (p,), m, with a joint in equilibrium; as `settle_joint`."""
    physics, amplitudes = physics.standing(loads), physics.felt(amplitudes, loads)
    elastic, influence = physics.modes.elastic, physics.modes.loads
    moved = elastic.probe_thermal @ amplitudes + influence.probes @ loads
    if not physics.contacts:
        return moved
    value = physics.contact.traction(joint.gap, joint.slip).value
    remainder = value.ravel() + elastic.reference * joint.gap.ravel()
    return np.asarray(moved + elastic.probe_compliance @ (elastic.area * remainder))


def at_start(physics: Physics) -> tuple[Array, Array]:
    """Return sensors (p,), K, and displacement (axes,), m, before the first step."""
    modes = physics.modes
    probes = moved_by(physics, physics.rest, modes.start, modes.factors)
    cold = Driving(modes.start, np.zeros(0) if modes.drives is None else modes.drives.cold)
    moved = positioned(physics, cold, physics.rest, modes.factors, probes)
    return modes.sensors @ modes.start, moved


def starting_under(physics: Physics, factors: Array) -> Physics:
    """Return a machine whose first loads have other factors (v,) before the first step."""
    usual = physics.modes.factors
    if np.array_equal(factors, usual[: factors.size]):
        return physics
    changed = np.concatenate([factors, usual[factors.size :]])
    return replace(physics, modes=replace(physics.modes, factors=changed))


def simulate_known(
    physics: Physics, inputs: Array, length: float, gone: Array | None = None
) -> tuple[Array, Array]:
    """March from rest under known inputs, with halved steps where they alternate.

    Parameters
    ----------
    physics : Physics
        The machine.
    inputs : ndarray, shape (n, s + h + 1 + v)
        Heat of each source, W, the held surfaces and the ambient, K, at the end of each step;
        factors of the first loads, where they are not those of time zero; then the positions of
        axes, m.
    length : float
        Of a step, s.
    gone : ndarray, shape (n, x), optional
        Travel of each axis in each step, m. Default: from one position to the next.

    Returns
    -------
    tuple of ndarray, shapes (n, p) and (n, axes)
        Sensors, K, and displacement, m.
    """
    marched = march_known(physics, inputs, length, gone)
    judged = physics.modes.way is None and physics.contacts > 0 and length > SHORTEST
    if judged and alternating(marched.joint.pressure / physics.contact.reference_pressure):
        halves = np.repeat(inputs, 2, axis=0)
        sensed, moved = simulate_known(physics, halves, 0.5 * length)
        return sensed[1::2], moved[1::2]
    sensed = marched.amplitudes @ physics.modes.sensors.T
    return sensed, displaced(physics, marched)


class Marched(NamedTuple):
    """n steps of a march."""

    #: Shape (n, r).
    amplitudes: Array
    #: Shape (n, d): temperatures of the drives of axes, K.
    drive: Array
    #: Shape (n, p): displacement probes, m.
    probes: Array
    #: Shape (n, x): positions of the axes at the end of each step, m.
    places: Array
    #: The joints after each step, (n, ...): pressures alone of a machine without axes.
    joint: JointState


def displaced(physics: Physics, marched: Marched) -> Array:
    """Return the displacement (n, axes), m, after the steps of a march."""
    if (drives := physics.modes.drives) is None:
        return marched.probes
    places = drives.with_zeros(marched.places)
    every = np.repeat(marched.probes[:, None], places.shape[1], axis=1)
    if places.shape[1] > 1:
        steps = zip(*marched.joint, marched.amplitudes, places, every, strict=True)
        for *joint, amplitudes, at, probes in steps:
            probes[1:] = seen_from(physics, JointState(*joint), amplitudes, at[1:])
    return np.asarray(drives.displacement(marched.drive, places, every)[:, 0])


def displaced_at(physics: Physics, marched: Marched, places: Array) -> Array:
    """Return the displacement (n, k, axes), m, after the steps of a march at other places.

    As if the axes of a machine stood there, the joints settled anew.

    Parameters
    ----------
    physics : Physics
        The machine.
    marched : Marched
        n steps of it.
    places : ndarray, shape (k, x)
        m.

    Raises
    ------
    ConvergenceError
        As `settle_joint`.
    """
    drives = physics.modes.drives
    assert drives is not None  # asked for with axes only
    every = drives.with_zeros(places)
    flat = every.reshape(-1, places.shape[1])
    steps = zip(*marched.joint, marched.amplitudes, strict=True)
    probes = np.array(
        [seen_from(physics, JointState(*joint), now, flat) for *joint, now in steps]
    ).reshape(len(marched.amplitudes), *every.shape[:2], -1)
    drive = np.repeat(marched.drive[:, None], len(places), axis=1)
    everywhere = np.tile(every, (len(probes), 1, 1, 1))
    return np.asarray(drives.displacement(drive, everywhere, probes)[:, :, 0])


def march_known(
    physics: Physics, inputs: Array, length: float, gone: Array | None = None
) -> Marched:
    """March from rest under known inputs, as `simulate_known` without halving steps."""
    modes = physics.modes
    known = modes.drive.shape[1]
    if modes.way is not None:
        return _march_moving(physics, inputs, length, gone)
    nothing, pressure = np.empty((len(inputs), 0)), np.empty((len(inputs), physics.contacts))
    pressures = JointState(nothing, nothing, pressure, nothing)
    constant = np.tile(modes.factors[inputs.shape[1] - known :], (len(inputs), 1))
    inputs = np.ascontiguousarray(np.hstack([inputs, constant]), dtype=np.float64)
    amplitudes, joint = modes.start.copy(), physics.at_rest()
    history = np.empty((len(inputs), amplitudes.size))
    displacement = np.empty((len(inputs), len(modes.elastic.probe_thermal)))
    step, kernel, k = heat_step(modes, length), physics.kernel, 0
    differences = np.zeros((FURTHER, 3 * physics.contacts))
    if not physics.contacts:
        for at, driven in enumerate(inputs[:, :known] @ step.drive.T):
            amplitudes = step.decay * amplitudes + driven
            history[at] = amplitudes
        moved = history @ modes.elastic.probe_thermal.T + inputs[:, known:] @ modes.loads.probes.T
        return Marched(history, nothing, moved, nothing, pressures)
    if kernel is not None:
        machine = MarchKernel(step, kernel, UNWATCHED)
        kept = new_kept(machine, one_block(kernel.springs, kernel.compliance, kernel.columns))
    while k < len(inputs):
        if kernel is not None:
            now = Moving(amplitudes, joint, differences)
            record = new_record(len(inputs) - k, now, displacement.shape[1])
            taken, _ = march_steps(machine, kept, inputs[k:], now, record)
            history[k : k + taken] = record.amplitudes[:taken]
            displacement[k : k + taken] = record.displacement[:taken]
            pressure[k : k + taken] = record.pressure[:taken]
            k += taken
            if k == len(inputs):
                break
        # Laws that are not compiled, or a joint that snaps.
        amplitudes = conduct(physics, amplitudes, inputs[k, :known], joint, length)
        joint, displacement[k] = settle_plainly(physics, joint, amplitudes, inputs[k, known:])
        history[k], pressure[k] = amplitudes, joint.pressure
        differences[:] = 0.0
        k += 1
    return Marched(history, nothing, displacement, nothing, pressures)


def guided_steps(physics: Physics, length: float) -> tuple[Guided, Steps] | None:
    """Return the data of a compiled march along an axis; None where there is no `guided_joint`."""
    way, drives, joint = physics.modes.way, physics.modes.drives, physics.guided_joint
    if way is None or joint is None or (drives is not None and drives.any):
        return None
    step, held = heat_step(physics.modes, length), physics.held_exchange
    guide = guided(step, way, held, physics.aligned, length)
    return guide, new_steps(guide, there_of(physics.aligned, joint))


def _along_axes(physics: Physics, length: float) -> axes_march.ReducedMarch | None:
    """Return a compiled march along axes with drives, or several; None where it does not apply."""
    way, contact, drives = physics.modes.way, physics.contact, physics.modes.drives
    if way is None or drives is None or physics.held.any():
        return None
    alone = len(way.stations.positions) == 1 and not drives.any
    if alone or not contact.conducts_by_pressure:
        return None
    heat = heat_step(physics.modes, length)
    return axes_march.reduced_march(heat, physics.modes, contact, physics.tables, length)


def _march_moving(physics: Physics, inputs: Array, length: float, gone: Array | None) -> Marched:
    """As `march_known`, of a machine with axes; without positions they do not move."""
    modes = physics.modes
    assert modes.drives is not None  # with axes
    known, first = modes.drive.shape[1], np.array(place_in(modes, modes.factors))
    if inputs.shape[1] == known:
        inputs = np.column_stack([inputs, np.tile(first, (len(inputs), 1))])
    ends = inputs[:, known:]
    starts = np.vstack([first, ends])[:-1]
    whole = np.abs(ends - starts) if gone is None else np.maximum(gone, np.abs(ends - starts))
    ways = np.column_stack([inputs[:, :known], starts, ends, whole])
    now, k = Driving(modes.start.copy(), modes.drives.cold), 0
    joint = physics.at_rest()
    found = axes_march.new_record(len(ways), now, len(modes.elastic.probe_thermal), joint)
    guide, along = guided_steps(physics, length), _along_axes(physics, length)
    while k < len(ways):
        part, taken = axes_march.Record(*(one[k:] for one in found)), 0
        if guide is not None:
            moving = Guiding(now.amplitudes, joint)
            taken = march_along(*guide, ways[k:], moving, part)
        elif along is not None:
            taken = axes_march.march_along(along, ways[k:], k, (now, joint), part)
        if taken:
            k += taken
            continue
        # Modes with an exchange, laws that are not compiled, or a joint that snaps.
        row, (begun, loads, told) = ways[k], np.split(ways[k, known:], 3)
        way = way_of(modes, begun, loads, told.tolist())
        assert way is not None  # with axes
        now = conduct_driven(physics, now, row[:known], joint, length, way)
        settled, part.probes[0] = settle_joint(physics, joint, now.amplitudes, loads)
        joint = JointState(*map(owned, settled))
        part.amplitudes[0], part.drive[0] = now
        part.gap[0], part.slip[0], part.pressure[0], part.change[0] = joint
        k += 1
    return Marched(*found[:3], ends, JointState(*found[3:]))
