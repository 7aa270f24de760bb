"""Bolts of a case in SI: ends, springs and forces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skfem import FacetBasis

from fesim.case.bolts import BoltEndSection, BoltSection
from fesim.case.history import History, read_history, step_history
from fesim.case.schema import Case
from fesim.solid.bolts import Bolt, Patch
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.spaces import cells_at, make_spaces
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, shown_point, unknown_name
from thermojoint.artefacts.units import MEGA

#: Rings of equal area that represent a disc, and points on each: means of second-order fields over
#: it are exact.
RINGS, AROUND = 3, 8
#: Ends closer to each other than this fraction of the structure's size coincide.
APART = 1e-6


def bolts_of(case: Case, structure: Structure) -> list[Bolt]:
    """Return the bolts of the meshed part, in the order of the case.

    Raises
    ------
    InputError
        A bolt refers to a surface, body or material that does not exist, an end lies in no cell, or
        its ends coincide.
    """
    return [_bolt(case, structure, name, bolt) for name, bolt in case.bolts.items()]


def tightening(case: Case) -> list[History]:
    """Return the history of each bolt's force, N: that with unmoved ends."""

    def given(bolt: BoltSection) -> History:
        factor = step_history(1.0) if bolt.file is None else read_history(bolt.file, "factor")
        return History(factor.times, 1e3 * bolt.force_kN * factor.values)

    return [given(bolt) for bolt in case.bolts.values()]


def first_forces(case: Case) -> Array:
    """Return the force of each bolt after all are tightened, N, shape (b,).

    Raises
    ------
    InputError
        A history starts without a force.
    """
    forces = np.array([force(np.zeros(1))[0] for force in tightening(case)])
    for name, force in zip(case.bolts, forces, strict=True):
        if force <= 0.0:
            raise InputError(
                f"bolts.{name}: its factor is not positive at the start, but bolts are tightened "
                "before anything acts; let its file begin above 0"
            )
    return forces


def _bolt(case: Case, structure: Structure, name: str, section: BoltSection) -> Bolt:
    where = f"bolts.{name}"
    if section.material not in case.materials:
        raise unknown_name("material", section.material, case.materials, f"{where}.material")
    material = case.materials[section.material]
    anchors = [_anchor(structure, e, f"{where}.{n}") for n, e in _ends(section)]
    size = float(np.linalg.norm(np.ptp(structure.mesh.p, axis=1)))
    mirrored = _mirrored(case, structure, section, APART * size)
    between = np.where(mirrored, 0.0, anchors[0] - anchors[1])
    distance = float(np.linalg.norm(between))
    if distance < APART * size:
        raise InputError(
            f"{where}: head and thread coincide, around {shown_point(anchors[0])} m; move "
            "one of them"
        )
    head, thread = (
        _disc(structure, e, between / distance, f"{where}.{n}")
        if e.surface is None
        else _surface_patch(structure, e.surface, f"{where}.{n}")
        for n, e in _ends(section)
    )
    along = np.where(mirrored, 0.0, head.centre - thread.centre)
    length = 1e-3 * (section.clamped_length_mm or 1e3 * distance)
    if section.diameter_mm is not None:
        area = 0.25 * np.pi * (1e-3 * section.diameter_mm) ** 2
        stiffness = 1e9 * material.youngs_modulus_GPa * area / length
    else:
        stiffness = MEGA * (section.stiffness_N_um or 0.0)
    growth = material.expansion_1_K * length
    return Bolt(head, thread, along / np.linalg.norm(along), float(stiffness), growth)


def _mirrored(
    case: Case, structure: Structure, section: BoltSection, near: float
) -> NDArray[np.bool_]:
    """Directions (3,) across the symmetry planes that both ends of a bolt reach, within `near`, m.

    The other half of such a bolt is in the mirror image: together they pull along the plane, while
    the centres of unequal halves differ across it.
    """
    mesh, mirrored = structure.mesh, np.zeros(len(DIRECTIONS), dtype=bool)
    if structure.symmetry_factor == 1:
        return mirrored
    for surface, direction in case.supports.symmetry.items():
        across = DIRECTIONS.index(direction)
        plane = mesh.p[across, mesh.facets[:, structure.surface(surface, "supports")]]
        away = [
            np.abs(_reach(structure, end, f"bolts.{name}")[across] - plane.mean()).min()
            for name, end in _ends(section)
        ]
        mirrored[across] |= np.ptp(plane) <= near and max(away) <= near
    return mirrored


def _reach(structure: Structure, end: BoltEndSection, where: str) -> Array:
    """Middle of a disc, or nodes of a surface, shape (3, n), m."""
    if end.position_mm is not None:
        return 1e-3 * np.array(end.position_mm)[:, None]
    facets = structure.surface(end.surface or "", f"{where}.surface")
    return np.asarray(structure.mesh.p[:, structure.mesh.facets[:, facets].ravel()])


def _ends(section: BoltSection) -> tuple[tuple[str, BoltEndSection], ...]:
    return ("head", section.head), ("thread", section.thread)


def _anchor(structure: Structure, end: BoltEndSection, where: str) -> Array:
    """Centre of an end as specified in the case, m."""
    if end.position_mm is not None:
        return 1e-3 * np.array(end.position_mm)
    return _surface_patch(structure, end.surface or "", where).centre


def _surface_patch(structure: Structure, name: str, where: str) -> Patch:
    """A whole surface, by quadrature."""
    facets = structure.surface(name, f"{where}.surface")
    mesh = structure.mesh
    heat = make_spaces(mesh).heat
    basis = FacetBasis(mesh, heat.elem, heat.mapping, facets=facets, intorder=4)
    weights = basis.dx.ravel()
    return Patch(
        points=np.asarray(basis.global_coordinates()).reshape(3, -1),
        cells=np.repeat(mesh.f2t[0, facets], basis.dx.shape[1]),
        weights=weights / weights.sum(),
    )


def _disc(structure: Structure, end: BoltEndSection, axis: Array, where: str) -> Patch:
    """Points of a disc perpendicular to the axis that lie in the body, with equal weights."""
    cells = structure.body(end.body or "", f"{where}.body")
    centre = _anchor(structure, end, where)
    across = np.linalg.svd(axis[None, :])[2][1:]
    radius = 5e-4 * (end.diameter_mm or 0.0) * np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
    angle = 2.0 * np.pi * (np.arange(AROUND) + 0.5) / AROUND
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = centre + np.concatenate([r * circle for r in radius]) @ across
    containing = cells_at(structure.mesh, points, cells)
    inside = containing >= 0
    if not inside.any():
        raise InputError(
            f"{where}: the disc around {shown_point(centre)} m lies in no cell of body "
            f"{end.body!r}; move it into the body"
        )
    count = int(inside.sum())
    return Patch(points[inside].T, containing[inside], np.full(count, 1.0 / count))
