"""Displacements at positions where the axes do not stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fesim.axes.guideway import Place
from fesim.axes.machine import MovingMachine
from fesim.march.machine import Step
from fesim.march.settling import displaced, settle_along
from thermojoint.artefacts.arrays import Array


def displaced_at(moving: MovingMachine, step: Step, at: Place) -> Array:
    """Return the displacement probes (p,) if the axes stood elsewhere at the end of a step.

    Temperatures and friction's memory are those of the step; the joints settle there.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    step : Step
        Of its march.
    at : tuple of float
        Position of every axis, m.

    Raises
    ------
    ConvergenceError
        There is no equilibrium there.
    """
    free = moving.guideway.free_at(at, moving.machine.strained(step.state.temperature))
    machine = replace(moving.machine, contact=moving.settling(at))
    there = replace(step.state, change=np.zeros_like(step.state.change))
    settled, _ = settle_along(machine.contact, there, free[: there.gap.size])
    return displaced(machine, free, settled, step.inputs)[1]
