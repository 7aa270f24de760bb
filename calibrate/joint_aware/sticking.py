"""Displacement with all joints sticking at their preload, a linear function of temperature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fesim.joint.law import JointLaw
from fesim.solid.condensation import ElasticCondensation
from thermojoint.artefacts.arrays import Array


def sticking_tangent(elastic: ElasticCondensation, laws: Sequence[tuple[JointLaw, int]]) -> Array:
    """Return the displacement per amplitude with every joint sticking at its preload.

    With z = s g, s the slopes of the joint's laws, the gap equations of docs/joint-aware.md are
    (1 - C A (s + k)) g = S_T a, and the displacement is (D_T + D_C A (s + k) g/a) a.

    Parameters
    ----------
    elastic : ElasticCondensation
        Gaps and displacement per amplitude.
    laws : sequence of (JointLaw, int)
        The law of each joint and its number of contact elements.

    Returns
    -------
    ndarray, shape (axes, r)
        m per amplitude.
    """
    if not laws:
        return elastic.probe_thermal
    stiffness = []
    for part in range(3):
        for law, count in laws:
            normal = float(law.normal.slope(np.zeros(1))[0])
            sliding = 0.0 if law.friction.coefficient == 0.0 else -law.friction.stiffness
            stiffness.append(np.full(count, normal if part == 0 else sliding))
    slope = np.concatenate(stiffness) + elastic.reference
    force = elastic.compliance * elastic.area
    gaps = np.linalg.solve(np.eye(slope.size) - force * slope, elastic.thermal_gap)
    tangent: Array = elastic.probe_thermal + elastic.probe_compliance @ (
        (elastic.area * slope)[:, None] * gaps
    )
    return tangent
