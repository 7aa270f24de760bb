"""Displacements at positions where the axis does not stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fesim.axes.machine import MovingMachine
from fesim.march.machine import Step
from fesim.march.settling import displaced, settle_along
from thermojoint.artefacts.arrays import Array


def displaced_at(moving: MovingMachine, step: Step, position: float) -> Array:
    """Return the displacement probes (p,) if the axis stood elsewhere at the end of a step.

    Temperatures and friction's memory are those of the step; the joints settle at the position.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    step : Step
        Of its march.
    position : float
        m.

    Raises
    ------
    ConvergenceError
        There is no equilibrium there.
    """
    machine = moving.standing(position)
    strained = machine.strained(step.state.temperature)
    grown = machine.contact.elastic.thermal_gap @ strained
    there = replace(step.state, change=np.zeros_like(step.state.change))
    settled, _ = settle_along(machine.contact, there, grown)
    return displaced(machine, strained, settled, step.inputs)[1]
