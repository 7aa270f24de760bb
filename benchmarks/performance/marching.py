"""The march itself: one, many on one condensation, and steps in which a large joint slides.

The other side is the march as it is without machine code for the whole step: each step taken by
itself, with Newton's method and a fresh factorisation (`fesim.joint.compiled_gap`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import perf_counter
from unittest.mock import patch

import numpy as np
import xarray as xr

from benchmarks.performance.cases import reference_case, with_contacts
from benchmarks.performance.timing import Row, paired
from fesim.batch.summary import SLIDES_ABOVE
from fesim.case.schema import Case, step_count
from fesim.case.thermal_sections import StepInput
from fesim.joint.law import JointLaw
from fesim.march.ensemble import march_many
from fesim.march.machine import CondensedMachine, State
from fesim.march.settling import initial_state
from fesim.march.stepping import Advance, march_along, plainly_staggered, staggered
from fesim.march.track import Track, joined
from fesim.one_thread import threads_of_march
from fesim.setup.loads import march_inputs
from fesim.setup.machine import Setup, set_up, with_laws
from fesim.simulate import COUPLINGS, simulate
from thermojoint.artefacts.arrays import Array

REPEATS = 5
#: Marches of the ensemble; its levels of heat and its joint laws are all different.
MARCHES = 20
#: Along and across; the steps that are measured, after so many in which sliding begins.
GRIDS = ((24, 8), (36, 12))
SLIDING_FROM, SLIDING_STEPS = 300, 40
#: Steps of heat, then as many of a fifth of it; those that are measured, after so many.
PERIOD, DUTY_FROM, DUTY_STEPS = 75, 600, 150


def rows() -> Iterator[Row]:
    """Yield march-1050, the rows of ensembles, and the steps of large joints."""
    case = reference_case()
    setup = set_up(case)
    yield march_row(case, setup)
    yield from ensemble_rows(case, setup)
    for along, across in GRIDS:
        yield sliding_row(with_contacts(case, along, across))
    yield duty_row(with_contacts(case, *GRIDS[0]))


def plainly(case: Case, setup: Setup) -> xr.Dataset:
    """Simulate a case with its steps taken one by one, without machine code for the whole."""
    with patch.dict(COUPLINGS, staggered=plainly_staggered):
        return simulate(case, setup=setup).response


def march_row(case: Case, setup: Setup) -> Row:
    """Return the row of one march, response included."""
    ours, other = simulate(case, setup=setup).response, plainly(case, setup)
    off = float(np.abs(ours["displacement"] - other["displacement"]).max())
    return Row(
        "march-1050",
        *paired(lambda: simulate(case, setup=setup), lambda: plainly(case, setup), REPEATS),
        "s",
        f"{step_count(case.march)} steps with {setup.machine.contact.count} contact elements, "
        f"set up before, response made; displacements differ by {off:.1e} m; median of {REPEATS}",
    )


def ensemble(case: Case) -> list[Case]:
    """Return cases on one condensation: levels of heat, friction and roughness all different."""
    rng = np.random.default_rng(1)
    found = []
    for level, friction, roughness in rng.uniform((0.5, 0.15, 0.6), (3.0, 0.6, 2.5), (MARCHES, 3)):
        changed = {"friction_coefficient": float(friction), "roughness_um": float(roughness)}
        joints = {name: joint.model_copy(update=changed) for name, joint in case.joints.items()}
        heat = StepInput(kind="step", level=float(level))
        found.append(case.model_copy(update={"joints": joints, "heat_input": heat}))
    return found


def driven(case: Case) -> Array:
    """Inputs of a case at time zero and at the end of every step."""
    return march_inputs(case).at(case.march.step_s * np.arange(step_count(case.march) + 1.0))


def ensemble_rows(case: Case, setup: Setup) -> Iterator[Row]:
    """Yield the time of a march among many, displacements only, and with full responses."""
    cases = ensemble(case)

    def laws() -> list[Sequence[tuple[JointLaw, int]]]:
        return [with_laws(setup, one).machine.contact.laws for one in cases]

    def many() -> Array:
        return march_many(setup.machine, laws(), np.array([driven(one) for one in cases]))

    def full() -> None:
        for one in cases:
            simulate(one, setup=with_laws(setup, one))

    def one_by_one() -> list[Array]:
        return [plainly(one, with_laws(setup, one))["displacement"].to_numpy() for one in cases]

    off = max(
        float(np.abs(mine - theirs).max())
        for mine, theirs in zip(many(), one_by_one(), strict=True)
    )
    note = (
        f"{MARCHES} marches of {step_count(case.march)} steps on one condensation, heat, friction "
        "and roughness all different, one core, laws made from the case included, for each"
    )
    for name, ours in (("march-ensemble", many), ("march-ensemble-full", full)):
        mine, theirs, ratio = paired(ours, one_by_one, 3)
        what = "displacements only" if ours is many else "whole responses"
        yield Row(
            name,
            mine / MARCHES,
            theirs / MARCHES,
            ratio,
            "s",
            f"{note}; {what}; displacements differ by {off:.1e} m; median of 3",
        )


def sliding_row(case: Case) -> Row:
    """Return the row of a step of a large joint that slides."""
    inputs = driven(case)[1 : SLIDING_FROM + SLIDING_STEPS + 1]
    return _steps_row("step-{}-contacts", "at heat input 3", case, inputs, SLIDING_FROM)


def duty_row(case: Case) -> Row:
    """Return the row of a step of a large joint that has slipped to and fro."""
    inputs = driven(case)[1 : DUTY_FROM + DUTY_STEPS + 1]
    levels = np.where(np.arange(len(inputs)) // PERIOD % 2 == 0, 1.0, 0.2)
    what = f"at heat input 3 and 0.6 in turn, {PERIOD} steps each"
    return _steps_row("duty-{}-contacts", what, case, levels[:, None] * inputs, DUTY_FROM)


def _steps_row(name: str, what: str, case: Case, inputs: Array, first: int) -> Row:
    """The row of the mean of all steps after the first ones."""
    machine = set_up(case).machine
    state = course(machine, inputs[:first]).step(-1).state
    inputs, last = inputs[first:], len(inputs)
    for one in (staggered, plainly_staggered):
        course(machine, inputs[:1], state, one)
    begun = perf_counter()
    ours = course(machine, inputs, state)
    between = perf_counter()
    other = course(machine, inputs, state, plainly_staggered)
    mine, theirs = between - begun, perf_counter() - between
    slides = np.abs(np.diff(ours.slip, axis=0)).max(axis=1) > SLIDES_ABOVE
    off = float(np.abs(ours.displacement - other.displacement).max())
    count = machine.contact.count
    return Row(
        name.format(count),
        1e3 / len(inputs) * mine,
        1e3 / len(inputs) * theirs,
        theirs / mine,
        "ms",
        f"mean of steps {first + 1} to {last} {what}, set up before, in which "
        f"{slides.sum(axis=1).mean():.0f} of {count} contact elements slide; displacements differ "
        f"by {off:.1e} m; measured once",
    )


def course(
    machine: CondensedMachine,
    inputs: Array,
    start: State | None = None,
    advance: Advance = staggered,
) -> Track:
    """March from a state, or from rest, on as many threads as `simulate`."""
    begun = start or initial_state(machine, inputs[0])
    with threads_of_march(machine.contact.count):
        return joined(list(march_along(machine, inputs, advance, begun)))
