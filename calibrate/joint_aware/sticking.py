"""Displacement with all joints sticking at their preload, a linear function of temperature."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from fesim.joint.law import NORMAL
from fesim.march.contact import Laws
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import Modes, contact_of, placed, rest_of

#: A contact element sticks if its pressure is more than this part of the reference pressure.
TOUCHES = 1e-3


def sticking_tangent(modes: Modes, laws: Laws) -> Array:
    """Return the displacement per amplitude with every joint sticking as it does at rest.

    With z = s g, s the slopes of the joint's laws, the gap equations of docs/joint-aware.md are
    (1 - C A (s + k)) g = S_T a, and the displacement is (D_T + D_C A (s + k) g/a) a.

    Parameters
    ----------
    modes : Modes
        Gaps and displacement per amplitude.
    laws : sequence of (JointLaw, int)
        The law of each joint and its number of contact elements.

    Returns
    -------
    ndarray, shape (axes, r)
        m per amplitude.
    """
    elastic, contact = modes.elastic, contact_of(modes, laws)
    if not contact.count:
        return elastic.probe_thermal
    rest = rest_of(contact, modes)
    touches = rest.pressure > TOUCHES * contact.reference_pressure
    stiffness = [-law.friction.stiffness * (law.friction.coefficient > 0.0) for law, _ in laws]
    sticking = np.where(touches, np.repeat(stiffness, [count for _, count in laws]), 0.0)
    normal = contact.traction(rest.gap, rest.slip).tangent[NORMAL]
    slope = np.concatenate([normal, sticking, sticking]) + elastic.reference
    force = elastic.compliance * elastic.area
    gaps = np.linalg.solve(np.eye(slope.size) - force * slope, elastic.thermal_gap)
    tangent: Array = elastic.probe_thermal + elastic.probe_compliance @ (
        (elastic.area * slope)[:, None] * gaps
    )
    return tangent


def combinations(positions: Sequence[Array]) -> Array:
    """Return places (k, x), m, that stand for the working volume of x axes.

    Parameters
    ----------
    positions : sequence of ndarray, shape (p,)
        Of each axis, ascending, m. All of them count of one axis; of several axes the
        combinations of the first, the middle and the last.
    """
    if len(positions) > 1:
        positions = [one[[0, len(one) // 2, -1]] for one in positions]
    return np.array(list(product(*positions)), dtype=np.float64)


def tangents_at(modes: Modes, laws: Laws, places: Array) -> list[Array]:
    """Return `sticking_tangent` at each of some places (k, x), m, of the axes, with their drives.

    A machine without axes has one place, (1, 0).
    """
    if (drives := modes.drives) is None:
        return [sticking_tangent(modes, laws)]
    return [
        drives.tangent(lambda place: sticking_tangent(placed(modes, place), laws), tuple(place))
        for place in places.tolist()
    ]
