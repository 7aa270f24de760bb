"""A step of the reduced thermal model in two halves: cheap, as its heat equation is diagonal.

If pressure and heat flow do not agree within a step, they mostly do in shorter ones: the gain of
their map falls with the length (docs/march.md, Coupling).
"""

from __future__ import annotations

from dataclasses import replace

from fesim.march.machine import CondensedMachine, Step
from fesim.march.reduced import at_step
from fesim.solid.condensation import FULL


def can_be_halved(machine: CondensedMachine) -> bool:
    """Return whether shorter steps are available at no cost.

    The full thermal model would need another factorisation, and the places of moving contact
    elements apply to a whole step.
    """
    return machine.thermal.model != FULL and machine.passing is None


def halved(machine: CondensedMachine) -> CondensedMachine:
    """Return the machine with steps of half the length; it must satisfy `can_be_halved`."""
    return replace(machine, thermal=at_step(machine.thermal, 0.5 * machine.thermal.step))


def joined(first: Step, second: Step) -> Step:
    """Return two half steps as one: the end, mean heat flows and largest residuals."""
    return replace(
        second,
        state=replace(second.state, change=first.state.change + second.state.change),
        heat_flow=0.5 * (first.heat_flow + second.heat_flow),
        residual=max(first.residual, second.residual),
        iterations=first.iterations + second.iterations,
        cuts=first.cuts + second.cuts,
        heat_balance=max(first.heat_balance, second.heat_balance, key=abs),
        secant_residual=max(first.secant_residual, second.secant_residual),
    )
