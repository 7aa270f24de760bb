"""Displacements at positions where the axes do not stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fesim.axes.guideway import Place
from fesim.axes.machine import MovingMachine
from fesim.march.machine import Step
from fesim.march.settling import displaced, settle_along
from thermojoint.artefacts.arrays import Array


def displaced_at(moving: MovingMachine, step: Step, places: Sequence[Place]) -> Array:
    """Return the displacement probes (c, p) if the axes stood elsewhere at the end of a step.

    Temperatures and friction's memory are those of the step; the joints settle there.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    step : Step
        Of its march.
    places : sequence of tuple of float
        c times the position of every axis, m.

    Raises
    ------
    ConvergenceError
        There is no equilibrium there.
    """
    alone = moving.guideway.elastic.alone(step.state.temperature)
    there = replace(step.state, change=np.zeros_like(step.state.change))

    def displacement(at: Place) -> Array:
        free = moving.guideway.free_at(at, alone)
        machine = replace(moving.machine, contact=moving.settling(at))
        settled, _ = settle_along(machine.contact, there, free[: there.gap.size])
        return displaced(machine, free, settled, step.inputs)[1]

    return np.array([displacement(at) for at in places])
