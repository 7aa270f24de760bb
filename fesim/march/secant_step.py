"""Heat step with temperature-dependent properties, convection or radiation, by iteration.

Each iteration is a step of the constant operators with a correction at the last temperatures, so
that no factorisation is needed. Anderson's method (1965) combines the last few iterates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fesim.march.heat_step import heat_balance, heat_step
from fesim.solid.condensation import ThermalCondensation
from fesim.solid.friction_heat import GivenHeat
from fesim.solid.variable_heat import VariableHeat
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Largest change of a temperature between the last two secant steps, K.
TOLERANCE = 1e-8
#: ... or this fraction of the largest temperature, the rounding error of a solve.
ROUNDING = 1e-12
MOST = 200
#: Number of iterates that are combined.
DEPTH = 5


@dataclass(frozen=True)
class HeatTaken:
    """Result of a step of the heat equation."""

    #: Shape (n,): temperatures at its end, K.
    temperature: Array
    #: Shape (m,): heat flows across the joints, W.
    heat_flow: Array
    #: `fesim.march.heat_step.heat_balance`.
    balance: float
    #: Largest change of a temperature in the last secant step, K; zero if nothing depends on
    #: temperature.
    residual: float


class HeatLoads(NamedTuple):
    """Loads of a step of the heat equation; arrays as for `fesim.march.heat_step.heat_step`.

    `given` is heat that enters in addition to the inputs.
    """

    inputs: Array
    joint: Array
    given: GivenHeat | None = None


def step_heat(
    thermal: ThermalCondensation,
    variable: VariableHeat | None,
    temperature: Array,
    loads: HeatLoads,
    most: int = MOST,
) -> HeatTaken:
    """Take one step of the heat equation; `most` is the largest number of secant steps.

    Raises
    ------
    ConvergenceError
        The secant steps do not converge.
    """
    inputs, joint, given = loads
    load, total = (0.0, 0.0) if given is None else (given.load, given.total)
    if variable is None:
        leaves = None if given is None else -given.load
        after, flow = heat_step(thermal, temperature, inputs, joint, leaves)
        left = None if given is None else (-total, np.zeros(len(thermal.balance.drive)))
        balance = heat_balance(thermal, temperature, after, inputs, flow, left)
        return HeatTaken(after, flow, balance, 0.0)

    def lacking(after: Array) -> Array:
        retained = variable.retained(temperature, after) / thermal.step
        return variable.lost(after, inputs) + retained

    at, size = temperature, np.inf
    guesses: list[Array] = []
    changes: list[Array] = []
    for _ in range(most):
        lost = lacking(at)
        lost[variable.held] = 0.0
        after, flow = heat_step(thermal, temperature, inputs, joint, lost - load)
        change = after - at
        size = float(np.abs(change).max())
        if size <= TOLERANCE + ROUNDING * float(np.abs(after).max()):
            lost = lacking(after)
            held = lost[variable.held]
            left = float(lost.sum()) - total, held
            balance = heat_balance(thermal, temperature, after, inputs, flow, left)
            return HeatTaken(after, flow, balance, size)
        if not np.isfinite(size):
            break
        guesses, changes = [*guesses[-DEPTH:], at], [*changes[-DEPTH:], change]
        at = accelerated(guesses, changes)
    raise ConvergenceError(
        f"secant steps: temperatures still change by {size:.1e} K; take a shorter march.step_s, or "
        "smaller changes of conductivity_factor, heat_capacity_factor, convection_factor and "
        "radiation"
    )


def accelerated(guesses: list[Array], changes: list[Array]) -> Array:
    """Return the next iterate: the linear combination of iterates with the least change."""
    step = guesses[-1] + changes[-1]
    if len(guesses) == 1:
        return step
    moves = np.diff(np.array(guesses), axis=0).T
    turns = np.diff(np.array(changes), axis=0).T
    weights = np.linalg.lstsq(turns, changes[-1], rcond=1e-10)[0]
    return np.asarray(step - (moves + turns) @ weights)
