"""Field snapshots for ParaView and pyvista: VTU files for each time and a PVD index of them.

Each snapshot has two parts: the structure with temperature, displacement and stress, and, if there
are joints, their faces with the state of the contact elements. VTU has no units, so the names
include them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
from numpy.typing import NDArray
from skfem.io.meshio import to_meshio

from fesim.case.schema import first_step_at
from fesim.march.machine import Step
from fesim.setup.machine import Setup
from fesim.solid.stress import corner_stresses, principal, von_mises
from meshes.structure import Structure
from meshes.volume_cells import corner_mesh
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import whole_file

INDEX = "snapshots.pvd"


def snapshot_writer(setup: Setup, folder: Path, times_s: Sequence[float]) -> Callable[[Step], None]:
    """Return a function that writes the snapshot of a step if it is due.

    A step is due if it is the first at or after a requested time. The index lists the snapshots of
    this writer and is rewritten after each of them: a march that is continued from a saved state
    needs its own folder.

    Parameters
    ----------
    setup : Setup
        Set-up of the case.
    folder : Path
        Folder of ``snapshots.pvd`` and the VTU files; created if it is missing.
    times_s : sequence of float
        Requested times, s (case key ``output.snapshots_s``); 0 gives the first step.

    Returns
    -------
    callable
        For ``on_step`` of `fesim.simulate.simulate`.

    Raises
    ------
    InputError
        A time is negative or not finite.
    """
    for time in times_s:
        if not (np.isfinite(time) and time >= 0.0):
            raise InputError(
                f"output.snapshots_s: {time} s is not a time of the march; give 0 or more"
            )
    folder = Path(folder)
    length = setup.machine.thermal.step
    due = {first_step_at(time, length) for time in times_s}
    if due:
        setup.make_field()  # the factorisation, before the march rather than within it
    written: list[tuple[float, dict[str, Path]]] = []

    def write(step: Step) -> None:
        index = step.state.index
        if index not in due:
            return
        parts = {"structure": structure_snapshot(setup, step)}
        if setup.joints:
            parts["joints"] = joint_snapshot(setup, step)
        files = {name: folder / f"{name}_{index:06d}.vtu" for name in parts}
        for name, grid in parts.items():
            with whole_file(files[name]) as part:
                meshio.vtu.write(part, grid)
        written.append((index * length, files))
        _write_index(folder / INDEX, written)

    return write


def structure_snapshot(setup: Setup, step: Step) -> meshio.Mesh:
    """Undeformed mesh with the fields of one step.

    Point data ``temperature_K`` (above the initial ambient), ``displacement_m``, ``von_mises_Pa``
    and ``principal_stress_Pa`` (the largest first); cell data ``body``, the number of the body in
    the order of ``structure.bodies``. Points are the nodes of the mesh, followed by copies of those
    shared by bodies, so that each body has its own stress there: the mean over its cells.
    """
    spaces, structure = setup.spaces, setup.structure
    temperature = setup.nodal_temperature(step.state)
    displacement = setup.displacement(step)
    body = np.zeros(structure.mesh.nelements, dtype=np.int32)
    for number, cells in enumerate(structure.bodies.values()):
        body[cells] = number
    node, corners = points_of_bodies(structure)
    mesh = corner_mesh(structure.mesh)
    inside = corner_stresses(
        structure,
        spaces,
        setup.materials,
        setup.deformation(step),
        setup.machine.strained(temperature),
    )
    if setup.machine.stiffness is not None:
        inside *= setup.machine.stiffness.relative(temperature[spaces.heat.element_dofs])[..., None]
    stress = point_means(corners, inside)
    return to_meshio(
        replace(mesh, doflocs=np.ascontiguousarray(mesh.p[:, node]), t=corners),
        point_data={
            "temperature_K": temperature[spaces.heat.nodal_dofs[0]][node],
            "displacement_m": displacement.reshape(-1, 3)[spaces.displacement.nodal_dofs[0]][node],
            "von_mises_Pa": von_mises(stress),
            "principal_stress_Pa": principal(stress),
        },
        cell_data={"body": [body]},
        encode_cell_data=False,
    )


def points_of_bodies(structure: Structure) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return points that are not shared by bodies, and the points of each cell.

    Returns
    -------
    tuple of ndarray of int, shapes (points,) and (corners, cells)
        The node of each point: first every node, then, body by body, those that also belong to an
        earlier body; and the points at the corners of each cell.
    """
    corners = structure.mesh.t.astype(np.int64)
    count = int(corners.max()) + 1
    nodes, taken, split = [np.arange(count)], np.zeros(count, dtype=bool), corners.copy()
    for cells in structure.bodies.values():
        own = np.unique(corners[:, cells])
        again = own[taken[own]]
        number = np.arange(len(taken))
        number[again] = count + np.arange(len(again))
        split[:, cells] = number[corners[:, cells]]
        nodes.append(again)
        taken[own] = True
        count += len(again)
    return np.concatenate(nodes), split


def point_means(corners: NDArray[np.int64], values: Array) -> Array:
    """Return the mean of the values of all cells at each point.

    Parameters
    ----------
    corners : ndarray of int, shape (corners, cells)
        Points of each cell; every point is in a cell.
    values : ndarray, shape (corners, cells, k)
        Values at the corners of each cell.

    Returns
    -------
    ndarray, shape (points, k)
    """
    at = corners.ravel()
    sums = [np.bincount(at, column) for column in values.reshape(at.size, -1).T]
    return np.asarray((np.array(sums) / np.bincount(at)).T)


def joint_snapshot(setup: Setup, step: Step) -> meshio.Mesh:
    """Side a of all joints, at least one, with the contact quantities of one step.

    Cell data ``contact`` (number of the contact element, from 1, as in the response),
    ``pressure_Pa``, ``conductance_W_m2K``, ``heat_flux_W_m2`` (from side a to side b),
    ``opening_m`` and ``slip_m`` (along, across).
    """
    firsts = np.cumsum([0, *(len(joint.area) for joint in setup.joints)])
    # All cells of a block have the same number of corners.
    pieces = sorted(
        (
            (first + int(element), corners)
            for joint, first in zip(setup.joints, firsts[:-1], strict=True)
            for corners, element in zip(joint.pieces, joint.piece_element, strict=True)
        ),
        key=lambda piece: len(piece[1]),
    )
    starts = np.cumsum([0, *(len(corners) for _, corners in pieces)])
    numbered = [
        (contact, start + np.arange(len(corners)))
        for (contact, corners), start in zip(pieces, starts[:-1], strict=True)
    ]
    blocks = [list(block) for _, block in groupby(numbered, key=lambda piece: len(piece[1]))]
    contacts = [np.array([contact for contact, _ in block]) for block in blocks]
    area = np.concatenate([joint.area for joint in setup.joints])
    values: dict[str, NDArray] = {
        "contact": np.arange(1, area.size + 1),
        "pressure_Pa": step.state.pressure,
        "conductance_W_m2K": step.conductance,
        "heat_flux_W_m2": step.heat_flow / area,
        "opening_m": step.state.gap[0],
        "slip_m": step.state.slip.T,
    }
    return meshio.Mesh(
        np.concatenate([corners for _, corners in pieces]),
        [("polygon", np.array([nodes for _, nodes in block])) for block in blocks],
        cell_data={name: [value[at] for at in contacts] for name, value in values.items()},
    )


def _write_index(path: Path, written: list[tuple[float, dict[str, Path]]]) -> None:
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for time, files in written:
        for number, (name, file) in enumerate(files.items()):
            ElementTree.SubElement(
                collection,
                "DataSet",
                timestep=f"{time!r}",
                part=str(number),
                name=name,
                file=file.name,
            )
    ElementTree.indent(root)
    with whole_file(path) as part:
        ElementTree.ElementTree(root).write(part, encoding="utf-8", xml_declaration=True)
