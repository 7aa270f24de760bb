"""The march: heat and contact stepped in time on the condensed structure (docs/march.md).

Nothing is factorised, assembled or allocated by mesh size inside it except the temperature field.
`march` is a generator of steps; a step's state is all it takes to go on with identical results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from artefacts.arrays import Array
from artefacts.errors import ConvergenceError, ThermojointError
from fesim.joint.cutting import cut
from fesim.joint.gap import TOLERANCE, Equilibrium, GapProblem, gap_problem, solve_gap
from fesim.joint.law import JointLaw, Traction, evaluate, stiffness_at_rest
from fesim.joint.relaxation import relax
from fesim.march.heat_step import heat_balance, heat_step
from fesim.march.state import JointState as JointState
from fesim.march.state import State as State
from fesim.march.state import Step as Step
from fesim.march.track import kernel_track
from fesim.solid.condensation import ElasticCondensation, LoadInfluence, ThermalCondensation
from fesim.solid.rigid_motions import Holds

if TYPE_CHECKING:
    from fesim.joint.loosening import Watch
    from fesim.march.kernel import StepKernel

#: Thermal gap (3 m,), slip (2, m) at the start of the step and a first guess of the gaps (3, m).
Settle = Callable[[Array, Array, Array], Equilibrium]

#: In-step iteration: largest change of a pressure between sweeps, relative to the preload.
PRESSURE_TOLERANCE = 1e-9
MAX_SWEEPS = 400
#: Least and largest weight of a sweep.
WEIGHTS = 0.05, 10.0
#: From this sweep on, an agreement within what the gap equations leave open is one.
PATIENCE = 20


@dataclass(frozen=True)
class CondensedMachine:
    """A structure ready to march.

    Attributes
    ----------
    thermal : ThermalCondensation
        One heat step.
    elastic : ElasticCondensation
        Gaps and probes.
    laws : sequence of (JointLaw, int)
        The law of each joint and how many contact elements it has, in their order.
    gap_tolerance : float
        Largest residual of the gap equations, m.
    holds : Holds, optional
        What holds the bodies; with it, a step in which one comes loose is an error.
    loads : LoadInfluence, optional
        Mechanical loads; their factors stand behind the other inputs of a step.
    """

    thermal: ThermalCondensation
    elastic: ElasticCondensation
    laws: Sequence[tuple[JointLaw, int]]
    gap_tolerance: float = TOLERANCE
    holds: Holds | None = None
    loads: LoadInfluence | None = None

    @property
    def contacts(self) -> int:
        """Number of contact elements."""
        return sum(count for _, count in self.laws)

    @cached_property
    def gap_problem(self) -> GapProblem:
        """The gap equations of this machine."""
        elastic = self.elastic
        return gap_problem(
            elastic.compliance * elastic.area,
            elastic.reference,
            stiffness_at_rest(self.laws),
            self.traction,
        )

    @cached_property
    def settle(self) -> Settle:
        """What solves them."""
        return gap_solver(self.gap_problem, self.laws, self.gap_tolerance)

    @cached_property
    def watch(self) -> Watch | None:
        """What sees a body come loose."""
        # Here, not above, as in `gap_solver`.
        from fesim.joint.loosening import watch_of

        return None if self.holds is None else watch_of(self.holds, self.laws)

    @cached_property
    def kernel(self) -> StepKernel | None:
        """What takes its steps in machine code; None if they are to be taken plainly."""
        from fesim.march.kernel import step_kernel

        return step_kernel(self)

    def _slices(self) -> Iterator[tuple[JointLaw, slice]]:
        start = 0
        for law, count in self.laws:
            yield law, slice(start, start + count)
            start += count

    def traction(self, gap: Array, slip: Array) -> Traction:
        """Evaluate every joint's law; shapes as in `fesim.joint.law.evaluate`."""
        parts = [evaluate(law, gap[:, at], slip[:, at]) for law, at in self._slices()]
        if len(parts) == 1:
            return parts[0]
        return Traction(
            np.concatenate([part.value for part in parts], axis=-1),
            np.concatenate([part.tangent for part in parts], axis=-1),
            np.concatenate([part.slip for part in parts], axis=-1),
        )

    def conductance(self, pressure: Array) -> Array:
        """Eq. 11 at every contact element, W/(m2 K)."""
        parts = [law.conductance(pressure[at]) for law, at in self._slices()]
        return np.concatenate([np.empty(0), *parts])

    @cached_property
    def conducts_by_pressure(self) -> bool:
        """Whether pressures alone decide what the joints conduct."""
        return all(law.conducts_by_pressure for law, _ in self.laws)

    def conductance_in(self, state: State) -> Array:
        """What every contact element conducts in a state, by contact and gap, W/(m2 K)."""
        if self.conducts_by_pressure:
            return self.conductance(state.pressure)
        rise = self.thermal.mean @ state.temperature
        parts = [
            law.conducts(state.pressure[at], state.gap[0, at], rise[at])
            for law, at in self._slices()
        ]
        return np.concatenate(parts)

    @cached_property
    def reference_pressure(self) -> Array:
        """Preload of every contact element, or what stands for it where there is none, Pa."""
        parts = [np.full(count, law.reference_pressure) for law, count in self.laws]
        return np.concatenate([np.empty(0), *parts])

    @cached_property
    def preload(self) -> Array:
        """Preload of every contact element, Pa."""
        parts = [np.full(count, law.preload) for law, count in self.laws]
        return np.concatenate([np.empty(0), *parts])


def gap_solver(
    problem: GapProblem, laws: Sequence[tuple[JointLaw, int]], tolerance: float = TOLERANCE
) -> Settle:
    """Return what solves a gap problem: machine code, or `solve_gap` for laws of the user's own."""
    # Here, not above: a compiler is loaded with it, which no structure without joints needs.
    from fesim.joint.compiled_gap import compile_gap

    compiled = compile_gap(problem, laws)
    solve = compiled.solve if compiled is not None else partial(solve_gap, problem)
    return partial(solve, tolerance=tolerance)


#: Time at the end of a step (s) to the inputs (k + l,): sources, W; ambient and held surfaces, K;
#: factors of the mechanical loads.
Inputs = Callable[[float], Array]
Advance = Callable[[CondensedMachine, State, Array], Step]


def initial_state(machine: CondensedMachine, inputs: Array | None = None) -> State:
    """Ambient temperature everywhere, every joint at its preload, under the loads of the start.

    Parameters
    ----------
    machine : CondensedMachine
        What marches.
    inputs : ndarray, shape (k + l,), optional
        At time zero; only the factors of mechanical loads count. Default: no load.

    Raises
    ------
    ConvergenceError
        There is no equilibrium.
    """
    count = machine.contacts
    state = State(
        index=0,
        temperature=np.zeros(machine.thermal.inputs.shape[0]),
        gap=np.zeros((3, count)),
        slip=np.zeros((2, count)),
        pressure=machine.preload.copy(),
        change=np.zeros((3, count)),
        model=machine.thermal.model,
        anchor=np.zeros((7, count)),
    )
    if machine.preload.all() and machine.loads is None:
        return state
    # A joint without preload is at rest by itself only where it is open.
    unheated = np.zeros(3 * count)
    found, _ = settle_along(machine, state, _loaded_gap(machine, unheated, inputs))
    pressure = machine.preload + found.traction.value[0]
    return replace(state, gap=found.gap, slip=found.traction.slip, pressure=pressure)


def march(
    machine: CondensedMachine, inputs: Inputs, advance: Advance, start: State | None = None
) -> Iterator[Step]:
    """Yield one step after another, without end.

    Parameters
    ----------
    machine : CondensedMachine
        What marches.
    inputs : callable
        Time (s) to the inputs (k + l,); implicit Euler takes them at the end of each step.
    advance : callable
        `staggered` or `iterated`.
    start : State, optional
        Where to go on; default `initial_state`.

    Raises
    ------
    ConvergenceError
        A step has no equilibrium, not even another one, or a body has come loose; nothing is
        yielded for it.
    InputError
        A pressure is beyond the conductance law.
    """
    state = start if start is not None else initial_state(machine, inputs(0.0))
    while True:
        step = advanced(machine, advance, state, inputs((state.index + 1) * machine.thermal.step))
        state = step.state
        yield step


def advanced(machine: CondensedMachine, advance: Advance, state: State, inputs: Array) -> Step:
    """Take one step; an error says which.

    Raises
    ------
    ConvergenceError, InputError
        As `march` does.
    """
    try:
        return advance(machine, state, inputs)
    except ThermojointError as error:
        time = (state.index + 1) * machine.thermal.step
        raise type(error)(f"step to t = {time:g} s: {error}") from error


def staggered(machine: CondensedMachine, state: State, inputs: Array) -> Step:
    """One step in which the last step's pressure sets the conductance, as in the paper."""
    if machine.kernel is not None:
        track = kernel_track(machine, state, inputs[None])
        if track is not None:
            return track.step(0)
    return _step_with(machine, state, inputs, machine.conductance_in(state))


def iterated(machine: CondensedMachine, state: State, inputs: Array) -> Step:
    """One step in which conductance and pressure agree at its end, unless the joint snaps in it.

    Sweeps of fixed-point iteration, each from the state at the start of the step, so that friction
    sees one increment only.

    Raises
    ------
    ConvergenceError
        The pressures still change after `MAX_SWEEPS` sweeps.
    """
    carried = _carried(machine, state)
    value = carried.of(state)
    weight, last = 1.0, np.zeros_like(value)
    iterations = cuts = 0
    for sweep in range(MAX_SWEEPS):
        step = _step_with(machine, state, inputs, carried.conductance(value))
        iterations += step.iterations
        cuts += step.cuts
        after = carried.of(step.state)
        misfit = (after - value) / carried.scale
        change = float(np.abs(misfit).max(initial=0.0))
        enough = PRESSURE_TOLERANCE if sweep < PATIENCE else _left_open(machine)
        # Where the joint snaps the pressure leaps: none agrees with the conductance it leaps from.
        if change <= enough or step.cuts > 0:
            return replace(step, iterations=iterations, cuts=cuts)
        # The next sweep's first guess: the same gaps again give the same pressures again, while
        # another guess moves them within the tolerance of the gap equations for ever.
        state = replace(state, change=step.state.change)
        slow = change > 0.5 * float(np.abs(last).max(initial=0.0))
        weight, last = _aitken(weight, last, misfit) if slow else weight, misfit
        ends = 0.5 * np.minimum(value, after), 2.0 * np.maximum(value, after)
        value = np.clip(value + weight * (after - value), *ends)
    raise ConvergenceError(
        f"in-step iteration: pressure and heat flow drive each other: {change:.1e} of the preload "
        f'after {MAX_SWEEPS} sweeps; take coupling = "staggered"'
    )


@dataclass(frozen=True)
class _Carried:
    """What goes from one sweep of an in-step iteration to the next, m values.

    Attributes
    ----------
    of : callable
        Reads it in a state.
    conductance : callable
        Makes conductances of it, W/(m2 K).
    scale : ndarray, shape (m,)
        What its changes are relative to.
    """

    of: Callable[[State], Array]
    conductance: Callable[[Array], Array]
    scale: Array


def _carried(machine: CondensedMachine, state: State) -> _Carried:
    """Pressures; or conductances, where openings or temperatures are in them as well."""
    if machine.conducts_by_pressure:
        pressures = machine.reference_pressure
        return _Carried(lambda found: found.pressure, machine.conductance, pressures)
    given = machine.conductance_in(state)
    scale = np.where(given > 0.0, given, 1.0)
    return _Carried(machine.conductance_in, lambda values: values, scale)


def _left_open(machine: CondensedMachine) -> float:
    """What the gap equations leave open of a pressure, of the preload: ten times that at rest."""
    stiffness = machine.gap_problem.springs[: machine.contacts]
    left = 10.0 * machine.gap_tolerance * stiffness / machine.reference_pressure
    return float(left.max(initial=PRESSURE_TOLERANCE))


def _aitken(weight: float, last: Array, misfit: Array) -> float:
    """Weight of the next sweep by Aitken's method (Irons & Tuck 1969), where sweeps settle slowly.

    Where they go on growing they leave an unstable state, and the whole way leads to a stable one.
    """
    turn = misfit - last
    if last @ turn >= 0.0:
        return 1.0
    return float(np.clip(-weight * (last @ turn) / (turn @ turn), *WEIGHTS))


def _step_with(machine: CondensedMachine, state: State, inputs: Array, conductance: Array) -> Step:
    count = machine.contacts
    elastic = machine.elastic
    thermal = inputs if machine.loads is None else inputs[: machine.thermal.inputs.shape[1]]
    temperature, heat_flow = heat_step(
        machine.thermal, state.temperature, thermal, conductance * elastic.area[:count]
    )
    thermal_gap = _loaded_gap(machine, elastic.thermal_gap @ temperature, inputs)
    found, cuts = settle_along(machine, state, thermal_gap)
    pressure = machine.preload + found.traction.value[0]
    if machine.watch is not None:
        machine.watch.check(pressure, found.traction.tangent)
    remainder = found.traction.value.ravel() + elastic.reference * found.gap.ravel()
    displacement = elastic.probe_thermal @ temperature + elastic.probe_compliance @ (
        elastic.area * remainder
    )
    if machine.loads is not None:
        displacement = displacement + machine.loads.probes @ load_factors(machine, inputs)
    return Step(
        state=State(
            index=state.index + 1,
            temperature=temperature,
            gap=found.gap,
            slip=found.traction.slip,
            pressure=pressure,
            change=found.gap - state.gap,
            model=machine.thermal.model,
            anchor=np.zeros_like(state.anchor),
        ),
        inputs=inputs,
        conductance=conductance,
        heat_flow=heat_flow,
        displacement=displacement,
        remainder=remainder,
        residual=found.residual,
        iterations=found.iterations,
        cuts=cuts,
        heat_balance=heat_balance(
            machine.thermal, state.temperature, temperature, thermal, heat_flow
        ),
    )


def load_factors(machine: CondensedMachine, inputs: Array) -> Array:
    """Return the factors (l,) of the mechanical loads among the inputs (k + l,) of a step."""
    return inputs[machine.thermal.inputs.shape[1] :]


def _loaded_gap(machine: CondensedMachine, thermal_gap: Array, inputs: Array | None) -> Array:
    """What heat and loads together open, (3 m,), m."""
    if machine.loads is None or inputs is None:
        return thermal_gap
    return thermal_gap + machine.loads.gap @ load_factors(machine, inputs)


def settle_along(
    machine: CondensedMachine, state: JointState, thermal_gap: Array
) -> tuple[Equilibrium, int]:
    """Find the equilibrium that the state comes to, and how many viscous steps it took.

    The first guess goes on as the last step did, which suits a smooth march, then it stays where
    the gaps are. Where neither leads to an equilibrium, none is near: the joint snaps. Where that
    leads nowhere, either, and no body is coming loose, the step is cut.

    Parameters
    ----------
    machine : CondensedMachine
        Whose joints they are.
    state : JointState
        Of the joint at the start of the step: a march's `State` is one.
    thermal_gap : ndarray, shape (3 m,)
        g_T at its end, m.

    Raises
    ------
    ConvergenceError
        There is no equilibrium, or a body has come loose.
    """
    for guess in (state.gap + state.change, state.gap):
        with suppress(ConvergenceError):
            return machine.settle(thermal_gap, state.slip, guess), 0
    step = machine.gap_problem, thermal_gap, state.slip, state.gap, machine.gap_tolerance
    with suppress(ConvergenceError):
        return relax(*step)
    if machine.watch is not None:
        machine.watch.explain(machine.traction(state.gap, state.slip))
    return cut(*step)
