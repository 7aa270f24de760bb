"""A step of the reduced thermal model in two halves: its heat equation is diagonal.

Where pressure and heat flow do not agree within a step, they mostly do within shorter ones: the
gain of their map falls with the length (docs/march.md, Coupling).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fesim.march.machine import CondensedMachine, Step
from fesim.march.reduced import with_diagonal
from fesim.solid.condensation import FULL


def can_be_halved(machine: CondensedMachine) -> bool:
    """Return whether shorter steps cost nothing.

    The full thermal model would need another factorisation, and contact elements that move have
    their places within a whole step.
    """
    return machine.thermal.model != FULL and machine.passing is None


def halved(machine: CondensedMachine) -> CondensedMachine:
    """Return a machine with steps of half the length, of one that `can_be_halved`."""
    thermal = machine.thermal
    rate = thermal.capacity_rate.diagonal()
    diagonal = thermal.factor.matrix.diagonal() + rate
    influence = np.where(rate > 0.0, np.asarray(thermal.jump) / diagonal, 0.0).T
    sums = thermal.balance
    shorter = replace(
        with_diagonal(thermal, diagonal, 2.0 * rate, influence),
        balance=replace(sums, after=sums.after + sums.before, before=2.0 * sums.before),
        step=0.5 * thermal.step,
    )
    return replace(machine, thermal=shorter)


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
