"""Accuracy of the displacement of a march, from its contact elements, its mesh and its steps.

Marches with longer steps give the error of the steps (implicit Euler is of first order), and with
merged contact elements the error of these (of second order); rows of the mesh errors, computed with
the condensation, are applied to the states of the march. All of it takes a fraction of the march
itself.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fesim.accuracy.coarse_joints import (
    means_of,
    merged_elements,
    merged_joint,
    merged_machine,
    merged_state,
)
from fesim.case.schema import Case
from fesim.march.machine import CondensedMachine, State
from fesim.march.settling import initial_state
from fesim.march.stepping import Advance, march_along
from fesim.march.track import Track, joined
from fesim.one_thread import threads_of_march
from fesim.setup.loads import march_inputs
from fesim.setup.machine import Setup
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ThermojointError

#: Most steps of the marches for comparison; a march of fewer steps than the second is halved.
MOST, FEW = 200, 16
#: Their steps are up to this many times as long, if there are enough.
LONGER = 8
#: Larger machines are not merged: dense products would take longer than a march.
LARGEST = 600


@dataclass(frozen=True)
class Accuracy:
    """Largest estimated errors of a displacement in a march, m; None if there is no estimate."""

    #: Due to the contact elements of all joints.
    joint: float | None
    #: Due to the meshes of temperatures and displacements.
    mesh: float | None
    #: Due to the steps.
    time: float | None
    #: Parts of `joint`; joints whose elements cannot be merged are missing.
    by_joint: dict[str, float]

    @property
    def total(self) -> float:
        """Root of the sum of the squares of the known errors."""
        known = [part for part in (self.joint, self.mesh, self.time) if part is not None]
        return float(np.linalg.norm(known))


@dataclass(frozen=True)
class Marched:
    """The march to be assessed."""

    #: Case of the march.
    case: Case
    #: Its machine.
    setup: Setup
    #: Its coupling.
    advance: Advance
    #: State that it continued from; None at time zero.
    start: State | None
    #: Shape (n, axes): displacement at the end of each step, m.
    displacement: Array


def accuracy_of(marched: Marched, known: float | None = None) -> Accuracy:
    """Estimate the errors of a march.

    Parameters
    ----------
    marched : Marched
        The march.
    known : float, optional
        Error of the steps, m, if the march has estimated it itself.
    """
    count, setup = len(marched.displacement), marched.setup
    longer = max(-(-count // MOST), min(LONGER, count // FEW), 1)
    fine, time = None, known
    with suppress(ThermojointError):
        machine = _with_steps(marched, longer)
        fine = _track(marched, machine, marched.start)
        time = _of_steps(marched, fine, longer) if known is None else known
    if fine is None:
        return Accuracy(None, None, time, {})
    by_joint: dict[str, float] = {}
    for joint in setup.joints:
        pairings = []
        for first_alone in (False, True):
            with suppress(ThermojointError, np.linalg.LinAlgError):
                pairings.append(_of_joint(marched, machine, fine, (joint.name, first_alone)))
        errors = [error for error in pairings if error is not None]
        if errors:
            by_joint[joint.name] = float(np.mean(errors))
    mesh = None
    with suppress(ThermojointError):
        mesh = _of_mesh(marched, fine, machine.thermal.step)
    unknown = setup.joints and not by_joint
    joints = None if unknown else float(sum(by_joint.values()))
    return Accuracy(joints, mesh, time, by_joint)


def _of_steps(marched: Marched, fine: Track, longer: int) -> float:
    """Error of the steps: their first-order difference from longer ones or from halves."""
    if longer > 1:
        at = longer * np.arange(1, len(fine) + 1) - 1
        return _largest(fine.displacement - marched.displacement[at]) / (longer - 1)
    halves = _track(marched, _with_steps(marched, 0.5), marched.start)
    return 2.0 * _largest(halves.displacement[1::2] - marched.displacement)


def _of_joint(
    marched: Marched, machine: CondensedMachine, fine: Track, merging: tuple[str, bool]
) -> float | None:
    """Error due to the contact elements of a joint; None if they cannot be merged.

    `merging` is the name of the joint, and whether its first elements remain single.
    """
    setup, numbers, ratio = marched.setup, [], 1.0
    for joint in setup.joints:
        number = np.arange(len(joint.area))
        if joint.name == merging[0]:
            number, ratio = merged_elements(joint, merging[1])
        numbers.append(number)
    if ratio == 1.0 or machine.contact.count > LARGEST or machine.stiffness is not None:
        return None
    joints = [merged_joint(*pair) for pair in zip(setup.joints, numbers, strict=True)]
    means = means_of(setup.joints, numbers)
    merged = merged_machine(marched.case, setup, machine.thermal, joints, means)
    start = None if marched.start is None else merged_state(marched.start, means)
    coarse = _track(marched, merged, start)
    return _largest(coarse.displacement - fine.displacement) / (ratio - 1.0)


def _of_mesh(marched: Marched, fine: Track, step: float) -> float | None:
    """Error due to the meshes at steps (s) of a march; None if the structure is too large for rows.

    Also None with a temperature-dependent modulus, whose variation in a cell is unknown.
    Temperatures are taken to have risen uniformly since time zero, like the dual ones.
    """
    setup = marched.setup
    machine, found = setup.machine, []
    if machine.stiffness is not None:
        return None
    loose = machine if setup.bolts is None else setup.bolts.loose
    rows = setup.make_mesh_errors(loose, 60.0 * marched.case.march.duration_min)
    if rows is None:
        return None
    heat, stress = rows.heat, rows.stress.temperature
    if setup.modes is not None:
        heat, stress = heat.on(setup.modes.basis), stress @ setup.modes.basis
    first, begun = machine.assembly, _begun(marched)
    before = 0.0 if marched.start is None else machine.thermal.step * marched.start.index
    for at in range(len(fine)):
        taken = fine.step(at)
        acting, remainder = setup.acting(taken), taken.remainder
        if first is not None:
            acting, remainder = acting - first.factors[:-1], remainder - first.remainder
        stressed = stress @ machine.strained(taken.state.temperature)
        stressed = stressed + rows.stress.remainder @ remainder + rows.stress.forces @ acting
        time = before + step * (at + 1.0)
        heated = heat.of(taken, begun, time)
        if rows.variable is not None:
            warm = taken.state.temperature
            heated = heated + rows.variable(begun, warm, time, taken.inputs)
        found.append(np.hypot(heated, stressed))
    return _largest(np.array(found))


def _begun(marched: Marched) -> Array:
    """Temperatures (n,) at time zero; amplitudes of a reduced model."""
    machine = marched.setup.machine
    if machine.start is None:
        return np.zeros(machine.thermal.inputs.shape[0])
    (at_zero,) = march_inputs(marched.case).at(np.zeros(1))
    return machine.start.temperature(at_zero)


def _with_steps(marched: Marched, longer: float) -> CondensedMachine:
    """The machine with steps `longer` times as long."""
    setup = marched.setup
    return setup.at_step(longer * setup.machine.thermal.step).machine


def _track(marched: Marched, machine: CondensedMachine, start: State | None) -> Track:
    """The march of another machine, whose steps end with those of the march or halfway."""
    step, own = machine.thermal.step, marched.setup.machine.thermal.step
    march = marched.case.march.model_copy(update={"step_s": step})
    inputs = march_inputs(marched.case.model_copy(update={"march": march}))
    (at_zero,) = inputs.at(np.zeros(1))
    begun = 0.0 if start is None else own * start.index
    count = int(round(own * len(marched.displacement) / step, 6))
    ends = begun + step * np.arange(1.0, count + 1.0)
    first = initial_state(machine, at_zero) if start is None else start
    between = inputs.reversed_forces(ends)
    with threads_of_march(machine.contact.count):
        return joined([*march_along(machine, inputs.at(ends), marched.advance, first, between)])


def _largest(errors: Array) -> float:
    """The largest component at any time."""
    return float(np.abs(errors).max(initial=0.0))
