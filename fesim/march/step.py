"""One step of heat, then of contact, with given joint conductances."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from fesim.march.machine import CondensedMachine, State, Step
from fesim.march.passing import pass_heat
from fesim.march.secant_step import HeatLoads, HeatTaken, step_heat
from fesim.march.settling import acting_on, displaced, exerted, loaded_gap, settle_along
from fesim.march.softening import lifted
from fesim.solid.friction_heat import GivenHeat, friction_work, given_heat
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, ThermojointError

#: Largest relative change of the frictional heat between sweeps, and number of sweeps.
FRICTION_TOLERANCE, FRICTION_SWEEPS = 1e-9, 50


def step_with(machine: CondensedMachine, state: State, inputs: Array, conductance: Array) -> Step:
    """Take one step of heat, then of contact.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    state : State
        State at the start of the step.
    inputs : ndarray, shape (k + l,)
        Inputs of the step.
    conductance : ndarray, shape (m,)
        Conductances of the contact elements, W/(m2 K).

    Raises
    ------
    ConvergenceError
        There is no equilibrium, a body has come loose, or friction and its heat do not agree.
    InputError
        A pressure is beyond the law.
    """
    take = partial(_step_heated, machine, state, inputs, conductance)
    return take() if machine.friction is None else _with_friction(machine, state.slip, take)


def said_at(time: float, error: ThermojointError) -> ThermojointError:
    """Return an error with the time, s, of the step that raised it."""
    return type(error)(f"step to t = {time:g} s: {error}")


def _with_friction(
    machine: CondensedMachine, before: Array, take: Callable[[GivenHeat], Step]
) -> Step:
    """Repeat a step until the heat supplied equals the friction work in it."""
    length, friction, contact = machine.thermal.step, machine.friction, machine.contact
    assert friction is not None
    # Work within the tolerance of the gap equations.
    area = contact.elastic.area[: contact.count]
    least = float((area * contact.reference_pressure).max()) * contact.tolerance / length
    power = np.zeros(contact.count)
    for _ in range(FRICTION_SWEEPS):
        step = take(given_heat(friction, power))
        moved = (step.state.slip - before)[None]
        work = friction_work(contact.elastic, step.remainder[None], step.state.gap[None], moved)[0]
        change, power = work / length - power, work / length
        if np.abs(change).max() <= FRICTION_TOLERANCE * np.abs(power).max() + least:
            return step
    raise ConvergenceError(
        "the heat of friction still changes the slip after "
        f"{FRICTION_SWEEPS} sweeps; take a shorter march.step_s"
    )


def _conducted(machine: CondensedMachine, temperature: Array, loads: HeatLoads) -> HeatTaken:
    if machine.passing is not None:
        return pass_heat(machine.thermal, machine.passing, temperature, loads.inputs, loads.joint)
    return step_heat(machine.thermal, machine.variable, temperature, loads)


def _step_heated(
    machine: CondensedMachine,
    state: State,
    inputs: Array,
    conductance: Array,
    given: GivenHeat | None = None,
) -> Step:
    count = machine.contact.count
    elastic = machine.contact.elastic
    thermal = inputs if machine.contact.loads is None else inputs[: machine.thermal.inputs.shape[1]]
    joint = conductance * elastic.area[:count]
    loads = HeatLoads(thermal, joint, given)
    heat = _conducted(machine, state.temperature, loads)
    strained = machine.strained(heat.temperature)
    thermal_gap = loaded_gap(machine, strained, inputs)
    added = None
    if machine.stiffness is not None:
        without = thermal_gap

        def settle(added: Array) -> Array:
            found, _ = settle_along(machine.contact, state, without + added)
            return exerted(machine.contact, found.gap, found.traction.value)

        lift = lifted(machine.stiffness, acting_on(machine, heat.temperature, inputs), settle)
        thermal_gap, added = without + lift.gap, lift.probes
    settled, cuts = settle_along(machine.contact, state, thermal_gap)
    pressure = machine.contact.preload + settled.traction.value[0]
    if machine.contact.watch is not None:
        machine.contact.watch.check(pressure, settled.traction.tangent)
    remainder, displacement = displaced(machine, strained, settled, inputs)
    if added is not None:
        displacement = displacement + added
    return Step(
        state=State(
            index=state.index + 1,
            temperature=heat.temperature,
            gap=settled.gap,
            slip=settled.traction.slip,
            pressure=pressure,
            change=settled.gap - state.gap,
            differences=np.zeros_like(state.differences),
            model=machine.thermal.model,
            frozen=np.zeros_like(state.frozen),
            turning=state.turning,
            parts=state.parts,
            drive=state.drive,
        ),
        inputs=inputs,
        conductance=conductance,
        heat_flow=heat.heat_flow,
        displacement=displacement,
        remainder=remainder,
        residual=settled.residual,
        iterations=settled.iterations,
        cuts=cuts,
        heat_balance=heat.balance,
        secant_residual=heat.residual,
    )
