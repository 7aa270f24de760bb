"""Fractions of surfaces covered by joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh

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


def area_by_facet(
    mesh: Mesh, facets: NDArray[np.int64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covered area of every facet, m2, from facets and area weights of points."""
    return np.asarray(np.bincount(facets, weights, mesh.facets.shape[1]), dtype=np.float64)


def areas_of_joints(mesh: Mesh, joints: Iterable[PairedJoint]) -> dict[str, NDArray[np.float64]]:
    """Return the area of every facet that each joint covers, m2, by the names of the joints."""
    return {
        joint.name: area_by_facet(mesh, joint.facets_a, joint.weights)
        + area_by_facet(mesh, joint.facets_b, joint.weights_b)
        for joint in joints
    }


def area_of_both(mesh: Mesh, one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the area that two parts cover both, m2, given the covered area of every facet, m2.

    As far as their sum shows it, which is larger there than a facet.
    """
    both = np.flatnonzero((one > 0.0) & (other > 0.0))
    area = np.linalg.norm(outward_areas(mesh, both), axis=1) if both.size else np.zeros(0)
    return float(np.maximum(one[both] + other[both] - (1.0 + EXCESS) * area, 0.0).sum())


def covered_areas(
    structure: Structure, surfaces: Sequence[str], joints: Sequence[PairedJoint]
) -> dict[str, float]:
    """Return the covered area of each surface, m2, if it is not zero."""
    covers = {name: cover_of(structure, name, joints) for name in surfaces}
    return {
        name: float(cover.share @ cover.area) for name, cover in covers.items() if cover.share.any()
    }
