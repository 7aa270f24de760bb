"""Fractions of surfaces covered by joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.pairing import EXCESS, PairedJoint, outward_areas
from meshes.structure import Structure


@dataclass(frozen=True)
class Cover:
    """The covered part of n facets, as quadrature points."""

    #: Shape (n,): covered fraction of the area of each facet; 1 if only rounding is left.
    share: NDArray[np.float64]
    #: Shape (n,): area of each whole facet as a plane, m2.
    area: NDArray[np.float64]
    #: Shape (nq,): index of the facet of each point.
    facet: NDArray[np.int64]
    #: Shape (nq,): cell behind it.
    cell: NDArray[np.int64]
    #: Shape (3, nq): quadrature points, m.
    points: NDArray[np.float64]
    #: Shape (nq,): area weights, m2.
    weights: NDArray[np.float64]


def cover_of(structure: Structure, surface: str, joints: Sequence[PairedJoint]) -> Cover:
    """Return the part of a surface covered by `joints`, on either of their sides."""
    mesh, facets = structure.mesh, structure.surface(surface, "convection_W_m2K")
    place = np.full(mesh.facets.shape[1], -1)
    place[facets] = np.arange(len(facets))
    sides = [
        side
        for joint in joints
        for side in (
            (joint.facets_a, joint.points_a, joint.weights),
            (joint.facets_b, joint.points_b, joint.weights_b),
        )
    ]
    facet = np.concatenate([np.empty(0, dtype=np.int64), *(place[on] for on, _, _ in sides)])
    points = np.hstack([np.empty((3, 0)), *(at for _, at, _ in sides)])
    weights = np.concatenate([np.empty(0), *(each for _, _, each in sides)])
    own = facet >= 0
    facet, points, weights = facet[own], points[:, own], weights[own]
    area = np.linalg.norm(outward_areas(mesh, facets), axis=1)
    share = np.divide(
        np.bincount(facet, weights, len(facets)), area, out=np.zeros(len(facets)), where=area > 0.0
    )
    return Cover(
        share=np.where(share > 1.0 - EXCESS, 1.0, share),
        area=area,
        facet=facet,
        cell=mesh.f2t[0, facets[facet]],
        points=points,
        weights=weights,
    )


def covered_areas(
    structure: Structure, surfaces: Sequence[str], joints: Sequence[PairedJoint]
) -> dict[str, float]:
    """Return the covered area of each surface, m2, if it is not zero."""
    covers = {name: cover_of(structure, name, joints) for name in surfaces}
    return {
        name: float(cover.share @ cover.area) for name, cover in covers.items() if cover.share.any()
    }
