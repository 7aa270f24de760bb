"""Displacements at positions where the axis does not stand, and the line through them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fesim.axes.machine import MovingMachine
from fesim.march.machine import Step
from fesim.march.settling import displaced, settle_along
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class Line:
    """Least-squares line delta = K0 + tan(beta) (P - P0) of each component of a displacement.

    Attributes
    ----------
    offset : ndarray, shape (..., c)
        K0, m.
    slope : ndarray, shape (..., c)
        tan beta.
    left : ndarray, shape (..., c)
        Largest magnitude of what the line leaves, m.
    """

    offset: Array
    slope: Array
    left: Array


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


def line_over(positions: Array, displacements: Array, reference: float) -> Line:
    """Fit the line of a control's axis to displacements over its positions.

    Parameters
    ----------
    positions : ndarray, shape (k,)
        Two different ones or more, m.
    displacements : ndarray, shape (..., k, c)
        m.
    reference : float
        P0, m.
    """
    arm = positions - positions.mean()
    mean = displacements.mean(axis=-2)
    slope = np.einsum("k,...kc->...c", arm, displacements) / (arm @ arm)
    rest = displacements - mean[..., None, :] - arm[:, None] * slope[..., None, :]
    offset = mean + (reference - positions.mean()) * slope
    return Line(offset, slope, np.abs(rest).max(axis=-2))
