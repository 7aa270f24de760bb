"""Convection coefficients of single surfaces: parts of a machine's convection, on its modes.

The film of a real machine is not uniform: draughts, fans and enclosed air differ from surface to
surface. Every named surface that convects has a factor of its own beside the common one. A named
surface without convection may have a little that the case lacks. Patches of them, by body and by
direction, are for a machine that is unlike its case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fesim.case.schema import Case
from fesim.setup.faces import LOOKS, directions_of
from fesim.setup.machine import Setup
from fesim.solid.heat import convection_matrix
from thermojoint.artefacts.arrays import Array

#: Largest number of surfaces with a film of their own; smaller ones share the common factor.
MOST = 6
#: Likewise of patches, and the least share of one in all of them: no data determine smaller ones.
MOST_PATCHES, LEAST = 12, 0.01


@dataclass(frozen=True, eq=False)
class Film:
    """Convection of a surface."""

    #: Its name.
    surface: str
    #: Its factor in the case: 1, or 0 where the case has no convection.
    nominal: float
    #: Shape (r, r): V^T H V at factor 1, W/K: at the case's coefficient, or at 1 W/(m2 K) where it
    #: has none.
    convection: Array
    #: Shape (r,): V^T h likewise, W/K.
    ambient: Array


def films_of(case: Case, setup: Setup) -> tuple[Film, ...]:
    """Return the films of single surfaces on the modes of a set-up, the largest first.

    The surfaces that convect are divided among those of them that have a name of their own. The
    part with the largest heat loss has no film here: its factor is the common one.
    """
    return _films(setup, _divided(case, setup), _without_film(case, setup), MOST)


def patches_of(case: Case, setup: Setup) -> tuple[Film, ...]:
    """Return the films of patches of the surfaces, likewise.

    A patch is the part of a surface that convects which belongs to one body and faces one
    direction, or the part of a surface without a film in the case which belongs to one body.
    """
    structure = setup.structure
    convecting: dict[str, csr_array] = {}
    free: dict[str, csr_array] = {}
    for whole, coefficient in case.convection_W_m2K.items():
        if coefficient:
            looks = np.array(LOOKS)[directions_of(structure, structure.surfaces[whole])]
            patched = _patched(setup, whole, looks)
            convecting |= {name: coefficient * matrix for name, matrix in patched.items()}
    for whole in _without_film(case, setup):
        free |= _patched(setup, whole, np.full(structure.surfaces[whole].size, whole))
    return _films(setup, convecting, free, MOST_PATCHES)


def _films(
    setup: Setup, convecting: dict[str, csr_array], free: dict[str, csr_array], most: int
) -> tuple[Film, ...]:
    """Films of parts of the surface, by their matrices, without the largest that convects."""
    assert setup.modes is not None  # reduce_machine needs them
    basis = setup.modes.basis
    ones = np.ones(basis.shape[0])
    parts = [(name, 1.0, matrix) for name, matrix in convecting.items()]
    parts.sort(key=lambda part: -float(part[2].sum()))
    parts = parts[1:] + [(name, 0.0, matrix) for name, matrix in free.items()]
    return tuple(
        Film(name, nominal, basis.T @ (matrix @ basis), basis.T @ (matrix @ ones))
        for name, nominal, matrix in parts[:most]
    )


def _patched(setup: Setup, whole: str, labels: NDArray[np.str_]) -> dict[str, csr_array]:
    """Convection matrices at 1 W/(m2 K) of the parts of a surface, by body and label."""
    structure = setup.structure
    facets = structure.surfaces[whole]
    patches = {
        f"{body} {label}": facets[(labels == label) & np.isin(structure.mesh.f2t[0, facets], cells)]
        for body, cells in structure.bodies.items()
        for label in np.unique(labels)
    }
    patches = {name: own for name, own in patches.items() if own.size}
    named = replace(structure, surfaces=structure.surfaces | patches)
    matrices = {name: _matrix(replace(setup, structure=named), name) for name in patches}
    least = LEAST * sum(float(matrix.sum()) for matrix in matrices.values())
    return {name: matrix for name, matrix in matrices.items() if matrix.sum() > least}


def _divided(case: Case, setup: Setup) -> dict[str, csr_array]:
    """Convection matrix of every part of the surfaces that convect, W/K."""
    surfaces = setup.structure.surfaces
    parts: dict[str, csr_array] = {}
    for whole, coefficient in case.convection_W_m2K.items():
        if not coefficient:
            continue
        rest, own = coefficient * _matrix(setup, whole), surfaces[whole]
        taken: list[str] = []
        for name in sorted(surfaces, key=lambda name: surfaces[name].size):
            inside = np.isin(surfaces[name], own).all() and surfaces[name].size < own.size
            if inside and not _overlaps(setup, name, taken):
                taken.append(name)
                parts[name] = coefficient * _matrix(setup, name)
                rest = rest - parts[name]
        parts[whole] = csr_array(rest)
    return {name: matrix for name, matrix in parts.items() if matrix.sum() > 0.0}


def _without_film(case: Case, setup: Setup) -> dict[str, csr_array]:
    """Convection matrix at 1 W/(m2 K) of the free surfaces to which the case gives no film."""
    surfaces, supports = setup.structure.surfaces, case.supports
    taken = [
        *(name for name, coefficient in case.convection_W_m2K.items() if coefficient),
        *case.radiation,
        *(name for cavity in case.cavities.values() for name in cavity.surfaces),
        *(*supports.fixed, *supports.symmetry, *supports.springs),
        *(side for sides in setup.structure.joints.values() for side in sides),
    ]
    chosen: list[str] = []
    for name in sorted(surfaces, key=lambda name: -surfaces[name].size):
        if not _overlaps(setup, name, [*taken, *chosen]):
            chosen.append(name)
    return {name: _matrix(setup, name) for name in chosen}


def _matrix(setup: Setup, name: str) -> csr_array:
    return convection_matrix(setup.structure, setup.spaces.heat, name, setup.joints)


def _overlaps(setup: Setup, name: str, others: Sequence[str]) -> bool:
    surfaces = setup.structure.surfaces
    return any(np.isin(surfaces[name], surfaces[other]).any() for other in others)
