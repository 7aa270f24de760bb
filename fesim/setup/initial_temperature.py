"""Initial nodal temperatures of a case: a value, a formula, a table or a snapshot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import CellBasis, Mesh
from skfem.io.meshio import from_meshio

from fesim.case.formula import formula
from fesim.case.position_table import read_position_table
from fesim.case.schema import Case
from fesim.setup.positions import checked
from fesim.solid.spaces import cells_at, interpolation
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array, OfPosition
from thermojoint.artefacts.errors import InputError, UnreadableError, shown_point

WHERE = "initial_temperature"
#: A node may lie outside the snapshot's body by this fraction of its size: it takes the temperature
#: of the nearest node.
BESIDE = 0.02


@dataclass(frozen=True)
class Snapshot:
    """Nodal temperatures of another simulation."""

    #: File.
    path: Path
    #: First-order mesh.
    mesh: Mesh
    #: Shape (cells,): number of the body of each cell.
    body: NDArray[np.int64]
    #: Shape (nodes,): temperatures above the initial ambient of that simulation, K.
    temperature: Array


def initial_temperature(case: Case, structure: Structure, basis: CellBasis) -> Array | None:
    """Return the temperatures (n,) above the initial ambient at time zero, K; None if all are zero.

    Raises
    ------
    InputError
        The file is unusable, or the field has no finite value at a node.
    """
    given = read_initial_temperature(case)
    if given is None:
        return None
    if isinstance(given, Snapshot):
        return _carried_over(given, structure, basis)
    return given(basis.doflocs)


def read_initial_temperature(case: Case) -> OfPosition | Snapshot | None:
    """Return the initial temperatures of a case: a function of position, or a snapshot.

    Raises
    ------
    InputError
        The file is missing, or is neither a table nor a snapshot.
    """
    section = case.initial_temperature
    if section is None:
        return None
    if section.expression_K is not None:
        return checked(formula(section.expression_K), f"{WHERE}.expression_K")
    if section.file is None:
        rise = section.rise_K or 0.0
        return lambda points: np.full(points.shape[1:], rise)
    if section.file.suffix == ".vtu":
        return read_snapshot(section.file)
    return read_position_table(section.file, "rise_K")


def read_snapshot(path: Path) -> Snapshot:
    """Read the structure's part of a snapshot (`fesim.snapshots`).

    Raises
    ------
    UnreadableError
        The file is missing or damaged.
    InputError
        It is not a snapshot of a structure.
    """
    if not path.is_file():
        raise UnreadableError(f"{path}: no such file; give the structure's snapshot (VTU) or a CSV")
    try:
        grid = meshio.vtu.read(str(path))
    # meshio passes on any error of its parser.
    except Exception as error:
        raise UnreadableError(f"{path}: not a readable VTU, perhaps truncated") from error
    kinds = [block.type for block in grid.cells]
    if (
        "temperature_K" not in grid.point_data
        or "body" not in grid.cell_data
        or kinds not in (["hexahedron"], ["tetra"])
    ):
        raise InputError(
            f"{path}: no snapshot of a structure (temperature_K, body); give structure_NNNNNN.vtu "
            "of a simulation's snapshots"
        )
    temperature = np.asarray(grid.point_data["temperature_K"], dtype=np.float64)
    if not np.isfinite(temperature).all():
        raise InputError(f"{path}: a temperature is not finite; take another snapshot")
    body = np.asarray(grid.cell_data["body"][0], dtype=np.int64)
    return Snapshot(path, from_meshio(grid), body, temperature)


def _carried_over(snapshot: Snapshot, structure: Structure, basis: CellBasis) -> Array:
    """Interpolate a snapshot body by body: touching bodies keep their own temperatures."""
    here, there = len(structure.bodies), int(snapshot.body.max()) + 1
    if here != there:
        raise InputError(
            f"{snapshot.path}: its structure has {there} bodies, this one {here}; take a snapshot "
            "of the same machine"
        )
    temperatures = np.zeros(basis.N)
    source = CellBasis(snapshot.mesh, basis.elem, intorder=1)
    # The unknowns of the snapshot's basis are its nodes, possibly in another order.
    values = np.empty(source.N)
    values[source.nodal_dofs[0]] = snapshot.temperature
    for number, (name, cells) in enumerate(structure.bodies.items()):
        nodes = np.unique(basis.element_dofs[:, cells])
        own = np.flatnonzero(snapshot.body == number)
        points = basis.doflocs[:, nodes]
        at = cells_at(snapshot.mesh, points.T, own)
        inside = at >= 0
        rows = interpolation(source, points[:, inside], at[inside], row_count=int(inside.sum()))
        temperatures[nodes[inside]] = rows @ values
        if not inside.all():
            corners = np.unique(snapshot.mesh.t[:, own])
            next_to = _nearest(snapshot, corners, points[:, ~inside], name)
            temperatures[nodes[~inside]] = snapshot.temperature[next_to]
    return temperatures


def _nearest(
    snapshot: Snapshot, corners: NDArray[np.int64], points: Array, body: str
) -> NDArray[np.int64]:
    """Nodes of the snapshot nearest to points (3, n) slightly outside its body."""
    around = snapshot.mesh.p[:, corners]
    away, nearest = cKDTree(around.T).query(points.T)
    if away.max() > BESIDE * np.ptp(around, axis=1).max():
        point = shown_point(points[:, np.argmax(away)])
        raise InputError(
            f"{snapshot.path}: its body {body!r} does not reach {point} m; take a snapshot of the "
            "same machine"
        )
    return corners[nearest]
