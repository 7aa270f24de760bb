"""Checks that refuse structures and names that would give wrong results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fesim.case.history import read_history
from fesim.case.schema import Case
from meshes.covered import area_of_both, areas_of_joints, covered_areas
from meshes.inspection import (
    TOUCHING,
    area_of,
    facing_facets,
    facing_warnings,
    hinge_warnings,
    overlap_warnings,
    pieces,
    seam_warnings,
)
from meshes.pairing import EXCESS, PairedJoint
from meshes.structure import Structure
from meshes.units import USUAL_SIZE
from thermojoint.artefacts.errors import ConvergenceError, InputError, shown_point
from thermojoint.artefacts.settings.toml import as_key

#: Sides of a preloaded joint further apart than this fraction of its width were never in contact.
#: The facets of a round bore may leave a few per cent.
APART = 0.05
#: Ambient temperatures at time zero that differ by more than this are contradictory, K.
SAME_AMBIENT = 0.5


def check_sound(case: Case, structure: Structure, joints: Sequence[PairedJoint]) -> None:
    """Refuse a case that every later check would accept but whose results would be wrong.

    Raises
    ------
    InputError
        A body has pieces that touch without a common node; joints overlap; the sides of a preloaded
        joint are far apart; surfaces with the same kind of heat exchange overlap, or walls of a
        cavity and surfaces that lose heat to the ambient; joints cover all of a cavity; the ambient
        of radiation differs from that of the case.
    """
    check_whole(structure, joints)
    check_covered_once(structure, joints)
    films, bare = list(case.convection_W_m2K), list(case.radiation)
    in_cavities = [name for cavity in case.cavities.values() for name in cavity.surfaces]
    check_apart(structure, combinations(films, 2), "convection_W_m2K")
    check_apart(structure, combinations(bare, 2), "radiation")
    check_apart(structure, combinations(in_cavities, 2), "cavities")
    check_apart(structure, product(in_cavities, [*films, *bare]), "cavities")
    check_open(case, structure, joints)
    check_laws(case, joints)


def check_laws(case: Case, joints: Sequence[PairedJoint]) -> None:
    """Refuse joint laws and an ambient as `check_sound` does.

    Cases that share a condensation may differ in these.

    Raises
    ------
    InputError
        The sides of a preloaded joint are far apart; the ambient of radiation differs from that of
        the case.
    """
    for joint in joints:
        if case.joints[joint.name].preload_MPa > 0.0:
            check_closed(joint)
    check_one_ambient(case)


def check_stands(case: Case) -> None:
    """Refuse a case with axes where the machine must be at rest.

    Raises
    ------
    InputError
        The case has axes.
    """
    if case.axes:
        raise InputError(
            f"axes.{next(iter(case.axes))}: `simulate`, `view` and joint-aware models move bodies; "
            "leave out [axes] for a machine that stands"
        )


def suspicions(structure: Structure, joints: Sequence[PairedJoint]) -> list[str]:
    """Return a warning for bodies that touch without a joint, overlap, are glued or hang loosely.

    Parameters
    ----------
    structure, joints
        As for `check_sound`.
    """
    return [
        *facing_warnings(structure, _sides(joints)),
        *seam_warnings(structure, _sides(joints)),
        *hinge_warnings(structure),
        *overlap_warnings(structure),
        *_glued_warnings(structure, joints),
    ]


def _glued_warnings(structure: Structure, joints: Sequence[PairedJoint]) -> Iterator[str]:
    """Yield a warning for each joint of two bodies whose sides have nodes in common.

    Within a body they may: a slit has a tip.
    """
    mesh, bodies = structure.mesh, structure.bodies
    for joint in joints:
        ahead, behind = (
            {name for name, own in bodies.items() if np.isin(cells, own).any()}
            for cells in (joint.cells_a, joint.cells_b)
        )
        common = np.intersect1d(mesh.facets[:, joint.facets_a], mesh.facets[:, joint.facets_b])
        if common.size and not ahead & behind:
            yield (
                f"joint {joint.name!r}: its sides share {common.size} nodes, where it neither "
                "opens nor slides and heat passes unhindered; give each side its own nodes"
            )


def _sides(joints: Sequence[PairedJoint]) -> list[NDArray[np.int64]]:
    """Facets of the sides of joints."""
    return [side for joint in joints for side in (joint.facets_a, joint.facets_b)]


@contextmanager
def explained_by_size(structure: Structure) -> Iterator[None]:
    """Add to an error of a structure of implausible size that its unit may be the cause."""
    try:
        yield
    except (InputError, ConvergenceError) as error:
        size = float(np.ptp(structure.mesh.p, axis=1).max())
        if USUAL_SIZE[0] <= size <= USUAL_SIZE[1]:
            raise
        raise type(error)(
            f"{error}; the structure is {size:.3g} m long: perhaps structure.unit is another one"
        ) from error


def check_open(case: Case, structure: Structure, joints: Sequence[PairedJoint]) -> None:
    """Refuse a cavity whose walls are completely covered by joints: it contains no air."""
    for name, cavity in case.cavities.items():
        where = f"cavities.{name}.surfaces"
        whole = sum(area_of(structure, structure.surface(one, where)) for one in cavity.surfaces)
        covered = sum(covered_areas(structure, cavity.surfaces, joints).values())
        if covered >= (1.0 - EXCESS) * whole:
            raise InputError(
                f"cavities.{name}: joints cover all of its surfaces, so it holds no air; leave it "
                "out, or name surfaces that face it"
            )


def radiated_to(case: Case) -> dict[str, float]:
    """Return the ambient of radiation at time zero, °C, by the section that specifies it."""
    given = {f"radiation.{name}": one.ambient_degC for name, one in case.radiation.items()}
    gaps = {name: joint.gap for name, joint in case.joints.items() if joint.gap is not None}
    return given | {
        f"joints.{name}.gap": gap.ambient_degC
        for name, gap in gaps.items()
        if gap.ambient_degC is not None
    }


def check_one_ambient(case: Case) -> None:
    """Refuse an ambient of radiation that differs from that at time zero or between sections."""
    given = radiated_to(case)
    if not given:
        return
    where, ambient = next(iter(given.items()))
    if case.ambient is not None:
        where = "ambient"
        ambient = float(read_history(case.ambient.file, "ambient_degC")(np.zeros(1))[0])
    for name, value in given.items():
        if abs(value - ambient) > SAME_AMBIENT:
            raise InputError(
                f"{name}.ambient_degC: {value:g} °C, but {where} begins with {ambient:g} °C, and "
                "both are the ambient at time zero; give the same"
            )


def check_whole(structure: Structure, joints: Sequence[PairedJoint]) -> None:
    """Refuse a body whose pieces touch without common nodes: it would transfer no heat or force."""
    mesh = structure.mesh
    near = TOUCHING * float(np.ptp(mesh.p, axis=1).max())
    for name, cells in structure.bodies.items():
        corners = mesh.t[:, cells]
        piece = pieces(corners)
        if not piece.any():
            continue
        nodes, first = np.unique(corners.T, return_index=True)
        of = piece[first // len(corners)]
        pairs = cKDTree(mesh.p[:, nodes].T).query_pairs(near, output_type="ndarray")
        split = pairs[of[pairs[:, 0]] != of[pairs[:, 1]]] if pairs.size else pairs
        touching = mesh.p[:, nodes[split[:, 0]]]
        if not touching.size:  # their meshes need not match
            part = np.full(mesh.nelements, -1)
            part[cells] = piece
            faces = facing_facets(mesh, part, _sides(joints))
            touching = mesh.p[
                :, mesh.facets[0, np.concatenate([np.empty(0, int), *faces.values()])]
            ]
        if touching.size:
            raise InputError(
                f"body {name!r} is in {1 + piece.max()} pieces that touch without a common node, "
                f"first at {shown_point(touching[:, 0])} m: nothing passes between them; merge the "
                "nodes, or give the pieces names of their own and a joint"
            )


def check_covered_once(structure: Structure, joints: Sequence[PairedJoint]) -> None:
    """Refuse joints that cover the same part of a face: their heat flows and forces would add."""
    mesh, covered = structure.mesh, areas_of_joints(structure.mesh, joints)
    for (first, one), (other, another) in combinations(covered.items(), 2):
        if (both := area_of_both(mesh, one, another)) > 0.0:
            raise InputError(
                f"joints: {first!r} and {other!r} cover the same {1e4 * both:.4g} cm2 "
                "of their faces, where both would count; remove one, or divide the surfaces"
            )


def check_closed(joint: PairedJoint) -> None:
    """Refuse a preloaded joint whose sides are far apart, or overlap far, in the mesh."""
    between = joint.separation
    most = APART * float(np.sqrt(joint.area.sum()))
    if float(np.abs(between).max()) > most:
        raise InputError(
            f"joint {joint.name!r}: its sides are {1e3 * between.min():.3g} to "
            f"{1e3 * between.max():.3g} mm apart in the mesh, where a preloaded joint is closed; "
            "move a body, or let it start open: preload_MPa = 0 and initial_opening_um"
        )


def check_apart(structure: Structure, pairs: Iterable[tuple[str, str]], where: str) -> None:
    """Refuse pairs of surfaces that share facets: there the effects of both would be added."""
    for surface, other in pairs:
        shared = np.intersect1d(structure.surface(surface, where), structure.surface(other, where))
        if shared.size:
            area = 1e4 * area_of(structure, shared)
            raise InputError(
                f"{where}: surfaces {surface!r} and {other!r} share {area:.4g} cm2, where both "
                f"would count; omit {as_key(surface)} or {as_key(other)}, or divide the surfaces"
            )
