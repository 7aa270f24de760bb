"""Condensed machine, its state, and the result of a step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from fesim.joint.gap import TOLERANCE, Equilibrium, GapProblem, gap_problem, solve_gap
from fesim.joint.law import JointLaw, Traction, evaluate, stiffness_at_rest
from fesim.solid.condensation import ElasticCondensation, LoadInfluence, ThermalCondensation
from fesim.solid.rigid_motions import Holds
from thermojoint.artefacts.arrays import Array

if TYPE_CHECKING:
    from fesim.joint.loosening import Watch
    from fesim.march.start_field import StartField
    from fesim.solid.temperature_factor import ThermalGrowth
    from fesim.solid.variable_heat import VariableHeat

#: Thermal gap (3 m,), slip (2, m) at the start of the step and a first guess of the gaps (3, m).
Settle = Callable[[Array, Array, Array], Equilibrium]


@dataclass(frozen=True)
class Assembly:
    """A machine whose bolts have just been tightened: nothing else acts on it.

    Attributes
    ----------
    gap : ndarray, shape (3, m)
        From the state before, m.
    slip : ndarray, shape (2, m)
        Irreversible slip, m.
    pressure : ndarray, shape (m,)
        Pa.
    remainder : ndarray, shape (3 m,)
        z + k g, Pa.
    factors : ndarray, shape (l,)
        What stands behind the other inputs of a step in this state.
    """

    gap: Array
    slip: Array
    pressure: Array
    remainder: Array
    factors: Array


@dataclass(frozen=True, eq=False)
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
    assembly : Assembly, optional
        Where a machine with bolts starts (`fesim.march.assembly`).
    start : StartField, optional
        Temperatures at time zero; default the ambient's.
    variable : VariableHeat, optional
        What of conduction, film and radiation depends on temperature; of the full model only.
    growth : ThermalGrowth, optional
        How bodies expand whose coefficient depends on temperature; of the full model only.
    """

    thermal: ThermalCondensation
    elastic: ElasticCondensation
    laws: Sequence[tuple[JointLaw, int]]
    gap_tolerance: float = TOLERANCE
    holds: Holds | None = None
    loads: LoadInfluence | None = None
    assembly: Assembly | None = None
    start: StartField | None = None
    variable: VariableHeat | None = None
    growth: ThermalGrowth | None = None

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

    def strained(self, temperature: Array) -> Array:
        """Return what temperature unknowns count as in S_T: others where `growth` says so."""
        return temperature if self.growth is None else self.growth.strained(temperature)

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


@dataclass(frozen=True)
class State:
    """Everything the next step depends on.

    Attributes
    ----------
    index : int
        Steps taken; time is index times the step length.
    temperature : ndarray, shape (n,)
        Nodal temperatures above the initial ambient, K, or a reduced model's amplitudes.
    gap : ndarray, shape (3, m)
        Gaps, m.
    slip : ndarray, shape (2, m)
        Irreversible slip, m: the history of friction.
    pressure : ndarray, shape (m,)
        Contact pressure, Pa.
    change : ndarray, shape (3, m)
        By how much the last step changed the gaps, m: the next step's first guess goes on so.
    model : str
        Whose temperature it is: the `model` of the `ThermalCondensation`.
    anchor : ndarray, shape (7, m)
        Where the inverses were made that machine code keeps from step to step: six entries of the
        joint law's tangent (Pa/m), conductance times area (W/K); zero where there are none.
    """

    index: int
    temperature: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    model: str
    anchor: Array


@dataclass(frozen=True)
class Step:
    """One step of the march and the evidence that it is right.

    Attributes
    ----------
    state : State
        At the end of the step.
    inputs : ndarray, shape (k + l,)
        What drove the step: sources, W; ambient and held surfaces, K; factors of the loads.
    conductance, heat_flow : ndarray, shape (m,)
        W/(m2 K), and W from side a to side b.
    displacement : ndarray, shape (k,)
        Displacement probes, m.
    remainder : ndarray, shape (3 m,)
        z + k g, Pa: with the temperature, it gives the displacement field.
    residual : float
        Largest residual of the gap equations, m.
    iterations, cuts : int
        Newton iterations, and viscous steps where a joint snapped.
    heat_balance : float
        (in - stored - convected) / the largest of the three.
    secant_residual : float
        Largest change of a temperature in the last secant step, K; zero where none is needed.
    """

    state: State
    inputs: Array
    conductance: Array
    heat_flow: Array
    displacement: Array
    remainder: Array
    residual: float
    iterations: int
    cuts: int
    heat_balance: float
    secant_residual: float = 0.0


def load_factors(machine: CondensedMachine, inputs: Array) -> Array:
    """Return the factors (l,) of the mechanical loads among the inputs (k + l,) of a step."""
    return inputs[machine.thermal.inputs.shape[1] :]
