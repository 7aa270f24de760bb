"""Frictional heat of sliding joints: half of it enters each side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from fesim.solid.condensation import FULL, ElasticCondensation, ThermalCondensation
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class FrictionHeat:
    """Frictional heat of the contact elements as a load of the heat equation."""

    #: Shape (n, m): heat of each unknown per W of each element; zero where temperatures are held
    #: and for joints without slip heating.
    into: csr_array | Array
    #: Shape (m,): its sum over the free nodes.
    entering: Array
    #: Shape (m,): 1 for elements with frictional heat, 0 for the others.
    counted: Array


@dataclass(frozen=True)
class GivenHeat:
    """Heat that enters in addition to the inputs of a step."""

    #: Shape (n,): heat of each unknown, W; zero where temperatures are held.
    load: Array
    #: Its sum over the nodes, W.
    total: float


def friction_heat(thermal: ThermalCondensation, counted: Array) -> FrictionHeat:
    """Return the frictional heat, for elements (m,) with (1) or without (0) slip heating.

    The mean temperature of both sides is the dual of heat that enters them in equal parts.
    """
    rows = diags_array(counted) @ csr_array(thermal.mean)
    held = thermal.capacity_rate.diagonal() == 0.0
    into = csr_array(diags_array(1.0 - held) @ rows.T)
    # Rows of means over nodes add up to one; amplitudes of held surfaces are nodal temperatures.
    entering = counted - np.asarray(rows[:, held].sum(axis=1)).ravel()
    return FrictionHeat(into if thermal.model == FULL else into.toarray(), entering, counted)


def given_heat(friction: FrictionHeat, power: Array) -> GivenHeat:
    """Return the load for a frictional power (m,), W."""
    return GivenHeat(friction.into @ power, float(friction.entering @ power))


def friction_work(
    elastic: ElasticCondensation, remainder: Array, gap: Array, slip_change: Array
) -> Array:
    """Return the work of friction of each contact element in steps, shape (n, m), J.

    Parameters
    ----------
    elastic : ElasticCondensation
        Areas and reference springs.
    remainder : ndarray, shape (n, 3 m)
        z + k g at the end of each step, Pa: with the gaps, it gives the shear tractions.
    gap : ndarray, shape (n, 3, m)
        Gaps at the end of each step, m.
    slip_change : ndarray, shape (n, 2, m)
        Change of the irreversible slip in the step, m.
    """
    count = gap.shape[2]
    springs = elastic.reference.reshape(3, count)
    traction = remainder.reshape(gap.shape) - springs * gap
    return -elastic.area[:count] * (traction[:, 1:] * slip_change).sum(axis=1)
