"""Equilibrium of the joints at the start and in every step."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from fesim.joint.cutting import cut
from fesim.joint.gap import Equilibrium
from fesim.joint.relaxation import relax
from fesim.march.contact import ContactProblem
from fesim.march.machine import FURTHER, CondensedMachine, State, Step, load_factors
from fesim.march.softening import Acting, lifted
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError


class JointState(Protocol):
    """Initial state of the gap equations; attributes as in `State`."""

    @property
    def gap(self) -> Array:
        """Gaps."""

    @property
    def slip(self) -> Array:
        """History of friction."""

    @property
    def change(self) -> Array:
        """Change of the gaps in the last step."""


class Rest(NamedTuple):
    """Joints before the first step; attributes as in `State`."""

    gap: Array
    slip: Array
    pressure: Array
    change: Array


def first_equilibrium(
    contact: ContactProblem, tight: Rest | None = None, thermal_gap: Array | None = None
) -> Rest:
    """Return joints at their preload, or `tight` under bolts, then under the loads at time zero.

    Parameters
    ----------
    contact : ContactProblem
        The joints.
    tight : Rest, optional
        State after the bolts have been tightened.
    thermal_gap : ndarray, shape (3 m,), optional
        Gap due to heat and loads before the first step, m; default none.

    Raises
    ------
    ConvergenceError
        There is no equilibrium.
    """
    count = contact.count
    still = np.zeros((3, count))
    rest = tight or Rest(still, np.zeros((2, count)), contact.preload.copy(), still)
    if thermal_gap is None:
        # A joint without preload is at rest only if it is open.
        if tight is not None or contact.preload.all():
            return rest
        thermal_gap = np.zeros(3 * count)
    settled, _ = settle_along(contact, rest, thermal_gap)
    pressure = contact.preload + settled.traction.value[0]
    return Rest(settled.gap, settled.traction.slip, pressure, still)


def initial_state(machine: CondensedMachine, inputs: Array | None = None) -> State:
    """Return the state at time zero: from the preload, under the first loads and temperatures.

    Without a `start` the machine is at ambient temperature. Bolts are tightened before the loads.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    inputs : ndarray, shape (k + l,), optional
        Inputs at time zero, of which only the load factors are used and, with a `start`, held
        temperatures. Default: none.

    Raises
    ------
    ConvergenceError
        There is no equilibrium.
    """
    return _at_zero(machine, undriven(machine) if inputs is None else inputs)[0]


def _at_zero(machine: CondensedMachine, inputs: Array) -> tuple[State, Array | None]:
    """The state at time zero, and the effect of a changed modulus on the probes then."""
    count, start, tight = machine.contact.count, machine.start, machine.assembly
    contact, lift = machine.contact, None
    ambient = np.zeros(machine.thermal.inputs.shape[0])
    temperature = ambient if start is None else start.temperature(inputs)
    opened = None
    if tight is not None or contact.loads is not None or start is not None:
        opened = loaded_gap(machine, machine.strained(temperature), inputs)
    bolted = None
    if tight is not None:
        bolted = Rest(tight.gap, tight.slip, tight.pressure, np.zeros((3, count)))
    if machine.stiffness is not None and opened is not None:
        without = opened

        def settle(added: Array) -> Array:
            rest = first_equilibrium(contact, None, without + added)
            return exerted(contact, rest.gap, contact.traction(rest.gap, rest.slip).value)

        lift = lifted(machine.stiffness, acting_on(machine, temperature, inputs), settle)
        opened = without + lift.gap
    state = State(
        index=0,
        temperature=temperature,
        **first_equilibrium(contact, bolted, opened)._asdict(),
        model=machine.thermal.model,
        differences=np.zeros((FURTHER, 3 * count)),
        frozen=np.zeros((7, count)),
        turning=np.zeros((3, count)),
        parts=0,
        drive=np.zeros(0),
    )
    return state, None if lift is None else lift.probes


def at_rest(machine: CondensedMachine, inputs: Array | None = None) -> Step:
    """Return row zero of a response: the machine under its first temperatures and loads.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    inputs : ndarray, shape (k + l,), optional
        Inputs at time zero; as for `initial_state`. Default: those of an `undriven` machine.
    """
    inputs = undriven(machine) if inputs is None else inputs
    elastic = machine.contact.elastic
    state, added = _at_zero(machine, inputs)
    displacement = elastic.probe_thermal @ machine.strained(state.temperature)
    if added is not None:
        displacement = displacement + added
    remainder = np.zeros(3 * machine.contact.count)
    if state.gap.any():
        value = machine.contact.traction(state.gap, state.slip).value
        remainder = exerted(machine.contact, state.gap, value)
        displacement = displacement + elastic.probe_compliance @ (elastic.area * remainder)
    driven = np.zeros(len(inputs))
    if machine.start is not None:  # Otherwise held surfaces are at ambient temperature, too.
        held = np.unique(machine.start.held.indices)
        driven[held] = inputs[held]
    if machine.contact.loads is not None:
        factors = load_factors(machine, inputs)
        driven[machine.thermal.inputs.shape[1] :] = factors
        displacement = displacement + machine.contact.loads.probes @ factors
    conductance = machine.conductance_in(state)
    jump = machine.thermal.jump @ state.temperature
    return Step(
        state=state,
        inputs=driven,
        conductance=conductance,
        heat_flow=conductance * elastic.area[: machine.contact.count] * jump,
        displacement=displacement,
        remainder=remainder,
        residual=0.0,
        iterations=0,
        cuts=0,
        heat_balance=0.0,
    )


def exerted(contact: ContactProblem, gap: Array, value: Array) -> Array:
    """Return z + k g (3 m,), Pa, from gaps and tractions (3, m)."""
    return np.asarray(value.ravel() + contact.elastic.reference * gap.ravel())


def acting_on(machine: CondensedMachine, temperature: Array, inputs: Array) -> Acting:
    """Return the temperatures (n_heat,) and loads on the bodies from the inputs (k + l,)."""
    return Acting(temperature, machine.strained(temperature), load_factors(machine, inputs))


def undriven(machine: CondensedMachine) -> Array:
    """Return the inputs (k + l,) of a machine without heat or loads other than its bolts."""
    loads = 0 if machine.contact.loads is None else machine.contact.loads.gap.shape[1]
    factors = np.zeros(loads) if machine.assembly is None else machine.assembly.factors
    return np.concatenate([np.zeros(machine.thermal.inputs.shape[1]), factors])


def loaded_gap(machine: CondensedMachine, strained: Array, inputs: Array) -> Array:
    """Return the gap due to heat and loads, (3 m,), m; arguments as for `displaced`."""
    thermal_gap: Array = machine.contact.elastic.thermal_gap @ strained
    if machine.contact.loads is None:
        return thermal_gap
    return thermal_gap + machine.contact.loads.gap @ load_factors(machine, inputs)


def displaced(
    machine: CondensedMachine, strained: Array, settled: Equilibrium, inputs: Array
) -> tuple[Array, Array]:
    """Return z + k g (3 m,), Pa, and the displacement of the probes (axes,), m.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    strained : ndarray, shape (n,)
        Temperatures that strain the bodies (`CondensedMachine.strained`).
    settled : Equilibrium
        Equilibrium of the joints.
    inputs : ndarray, shape (k + l,)
        Inputs with the factors of the loads.
    """
    elastic = machine.contact.elastic
    remainder = exerted(machine.contact, settled.gap, settled.traction.value)
    displacement = elastic.probe_thermal @ strained + elastic.probe_compliance @ (
        elastic.area * remainder
    )
    if machine.contact.loads is not None:
        displacement = displacement + machine.contact.loads.probes @ load_factors(machine, inputs)
    return remainder, displacement


def settled_between(machine: CondensedMachine, state: State, factors: Array) -> State:
    """Return a state after load reversals within the next step.

    They change gaps and slips. Temperatures and pressures, and so the conductance in the step,
    remain those of the state.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    state : State
        State at the start of a step.
    factors : ndarray, shape (k, l)
        Factors of the loads, one row for each reversal.

    Raises
    ------
    ConvergenceError
        There is no equilibrium, or a body has come loose.
    """
    contact = machine.contact
    if not contact.count or contact.loads is None:
        return state
    grown = contact.elastic.thermal_gap @ machine.strained(state.temperature)
    still = np.zeros_like(state.change)
    for row in factors:
        settled, _ = settle_along(contact, state, grown + contact.loads.gap @ row)
        if contact.watch is not None:
            pressure = contact.preload + settled.traction.value[0]
            contact.watch.check(pressure, settled.traction.tangent)
        state = replace(state, gap=settled.gap, slip=settled.traction.slip, change=still)
    return state


def settle_along(
    contact: ContactProblem, state: JointState, thermal_gap: Array
) -> tuple[Equilibrium, int]:
    """Return the equilibrium at the end of a step, and the number of viscous steps.

    The first guess extrapolates the last step; the second is the present gaps. If neither leads to
    an equilibrium, the joint snaps. If that fails as well, the step is subdivided.

    Parameters
    ----------
    contact : ContactProblem
        The joints.
    state : JointState
        State of the joint at the start of the step, e.g. a `State`.
    thermal_gap : ndarray, shape (3 m,)
        g_T at its end, m.

    Raises
    ------
    ConvergenceError
        There is no equilibrium, or a body has come loose.
    """
    moves = [state.gap + state.change] if state.change.any() else []
    for guess in (*moves, state.gap):
        with suppress(ConvergenceError):
            return contact.settle(thermal_gap, state.slip, guess), 0
    step = contact.gap_problem, thermal_gap, state.slip, state.gap, contact.tolerance
    with suppress(ConvergenceError):
        return relax(*step)
    return cut(*step, None if contact.watch is None else contact.watch.explain)
