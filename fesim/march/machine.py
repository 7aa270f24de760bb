"""Condensed machine, its state, and the result of a step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fesim.march.contact import ContactProblem, Laws
from fesim.solid.condensation import ThermalCondensation
from thermojoint.artefacts.arrays import Array

if TYPE_CHECKING:
    from fesim.march.passing import Passing
    from fesim.march.start_field import StartField
    from fesim.solid.friction_heat import FrictionHeat
    from fesim.solid.variable_heat import VariableHeat
    from fesim.solid.variable_stiffness import VariableStiffness

#: Backward differences of the gaps, beyond the change in the last step, that a state contains.
FURTHER = 3


class Straining(Protocol):
    """Equivalent temperatures of the thermal expansion of bodies."""

    def strained(self, temperature: Array) -> Array:
        """Return the equivalent temperatures (n,) of temperatures (n,)."""


@dataclass(frozen=True)
class Assembly:
    """State of a machine after its bolts are tightened and before any other load.

    Attributes
    ----------
    gap : ndarray, shape (3, m)
        Gaps relative to the state before, m.
    slip : ndarray, shape (2, m)
        Irreversible slip, m.
    pressure : ndarray, shape (m,)
        Contact pressure, Pa.
    remainder : ndarray, shape (3 m,)
        z + k g, Pa.
    factors : ndarray, shape (l,)
        Factors of the loads in this state.
    """

    gap: Array
    slip: Array
    pressure: Array
    remainder: Array
    factors: Array


@dataclass(frozen=True, eq=False)
class CondensedMachine:
    """A condensed structure with its joints, ready for time integration."""

    #: Condensed heat step.
    thermal: ThermalCondensation
    #: Gaps, probes and joint laws.
    contact: ContactProblem
    #: Initial state of a machine with bolts (`fesim.march.assembly`).
    assembly: Assembly | None = None
    #: Temperatures at time zero; default the ambient's.
    start: StartField | None = None
    #: Temperature-dependent part of conduction, convection and radiation; full model only.
    variable: VariableHeat | None = None
    #: Temperature-dependent expansion of the bodies, full model only; or their effect at the
    #: positions of moving axes.
    growth: Straining | None = None
    #: Frictional heat of the joints; default none.
    friction: FrictionHeat | None = None
    #: Bodies that contact elements touch as they move within the step; not with `variable`.
    passing: Passing | None = None
    #: Temperature-dependent part of the stiffness; full model only, and without bolts.
    stiffness: VariableStiffness | None = None

    def with_laws(self, laws: Laws) -> CondensedMachine:
        """Return the machine with other joint laws; the condensations do not depend on them."""
        return replace(self, contact=replace(self.contact, laws=laws))

    def conductance_in(self, state: State) -> Array:
        """Conductance of every contact element in a state, contact and gap together, W/(m2 K)."""
        if self.contact.conducts_by_pressure:
            return self.contact.conductance(state.pressure)
        rise = self.thermal.mean @ state.temperature
        jump = self.thermal.jump @ state.temperature
        return self.contact.conducts(state.pressure, state.gap[0], rise, jump)

    def strained(self, temperature: Array) -> Array:
        """Return the equivalent temperatures (n,) for S_T, which include `growth`."""
        return temperature if self.growth is None else self.growth.strained(temperature)


@dataclass(frozen=True)
class State:
    """State of a march: everything that the next step depends on."""

    #: Steps taken; time is index times the step length.
    index: int
    #: Shape (n,): nodal temperatures above the initial ambient, K, or a reduced model's amplitudes.
    temperature: Array
    #: Shape (3, m): gaps, m.
    gap: Array
    #: Shape (2, m): irreversible slip, m: the history of friction.
    slip: Array
    #: Shape (m,): contact pressure, Pa.
    pressure: Array
    #: Shape (3, m): change of the gaps in the last step, m; the first guess of the next step
    #: extrapolates it.
    change: Array
    #: Shape (3, 3 m): their backward differences of order 2 to 4 over the last steps, m, with which
    #: the compiled march extrapolates (`fesim.march.extrapolation`); zero where they are unknown.
    differences: Array
    #: Thermal model of the temperature: the `model` of the `ThermalCondensation`.
    model: str
    #: Shape (7, m): state at which the stored factors were computed: six entries of the joint
    #: law's tangent (Pa/m), conductance times area (W/K); zero where there are none.
    frozen: Array
    #: Shape (3, m): record of alternating increments of the last steps (`fesim.march.alternation`).
    turning: Array
    #: Smallest number of parts in which this step and all later ones are iterated, because
    #: staggered steps, or iterated ones in fewer parts, alternated; zero while steps are staggered.
    parts: int
    #: Shape (d,): temperatures of the drive of a moving axis above the initial ambient, K
    #: (`fesim.axes.positioning`); empty without one.
    drive: Array
    #: Shape (c,): continuation data of an adaptive march
    #: (`fesim.march.adaptive_state.Now.packed`); else empty.
    course: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Step:
    """Results of one step of a march, and its residuals."""

    #: State at the end of the step.
    state: State
    #: Shape (k + l,): sources, W; ambient and held surfaces, K; factors of the loads.
    inputs: Array
    #: Shape (m,): conductance, W/(m2 K), and heat flow from side a to side b, W.
    conductance: Array
    heat_flow: Array
    #: Shape (k,): readings of the displacement probes, m.
    displacement: Array
    #: Shape (3 m,): z + k g, Pa: with the temperature, it gives the displacement field.
    remainder: Array
    #: Largest residual of the gap equations, m.
    residual: float
    #: Newton iterations, and viscous steps where a joint snapped.
    iterations: int
    cuts: int
    #: (in - stored - convected) / the largest of the three.
    heat_balance: float
    #: Largest change of a temperature in the last secant step, K; zero where none is needed.
    secant_residual: float = 0.0


def load_factors(machine: CondensedMachine, inputs: Array) -> Array:
    """Return the factors (l,) of the mechanical loads among the inputs (k + l,) of a step."""
    return inputs[machine.thermal.inputs.shape[1] :]
