"""A step of the reduced thermal model in two halves: its heat equation is diagonal.

Where pressure and heat flow do not agree within a step, they mostly do within shorter ones: the
gain of their map falls with the length (docs/march.md, Coupling).
"""

from __future__ import annotations

from dataclasses import replace

from fesim.march.machine import CondensedMachine, Step
from fesim.march.reduced import at_step
from fesim.solid.condensation import FULL


def can_be_halved(machine: CondensedMachine) -> bool:
    """Return whether shorter steps cost nothing.

    The full thermal model would need another factorisation, and contact elements that move have
    their places within a whole step.
    """
    return machine.thermal.model != FULL and machine.passing is None


def halved(machine: CondensedMachine) -> CondensedMachine:
    """Return a machine with steps of half the length, of one that `can_be_halved`."""
    return replace(machine, thermal=at_step(machine.thermal, 0.5 * machine.thermal.step))


def joined(first: Step, second: Step) -> Step:
    """Return two halves of a step as one: its end, mean heat flows and largest residuals."""
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
