"""Field snapshots for ParaView and pyvista: VTU files for each time and a PVD index of them.

Each snapshot has two parts: the structure with its temperature and displacement, and, if there are
joints, their faces with what happens at the contact elements. VTU knows no units: they stand in
the names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
from numpy.typing import NDArray
from skfem.io.meshio import to_meshio

from artefacts.errors import InputError
from artefacts.files import whole_file
from fesim.case.schema import first_step_at
from fesim.march.stepping import Step
from fesim.setup.machine import Setup
from meshes.volume_cells import corner_mesh

INDEX = "snapshots.pvd"


def snapshot_writer(setup: Setup, folder: Path, times_s: Sequence[float]) -> Callable[[Step], None]:
    """Return a function that writes the snapshots due at the step it is given.

    A step is due if it is the first at or after a requested time. The index lists the snapshots of
    this writer and is rewritten after each of them: a march that is continued from a saved state
    needs a folder of its own.

    Parameters
    ----------
    setup : Setup
        What marches.
    folder : Path
        Where ``snapshots.pvd`` and the VTU files go; made if it is missing.
    times_s : sequence of float
        Requested times, s (case key ``output.snapshots_s``); 0 gives the first step.

    Returns
    -------
    callable
        Fits ``on_step`` of `fesim.simulate.simulate`.

    Raises
    ------
    InputError
        A time is negative or not finite.
    """
    for time in times_s:
        if not (np.isfinite(time) and time >= 0.0):
            raise InputError(
                f"output.snapshots_s: {time} s is no time of the march; give 0 or more"
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

    Point data ``temperature_K`` (above the initial ambient) and ``displacement_m``, both of the
    mesh's nodes; cell data ``body``, the number of the body in the order of ``structure.bodies``.
    """
    spaces, structure = setup.spaces, setup.structure
    temperature = setup.nodal_temperature(step.state)
    displacement = setup.displacement(step)
    body = np.zeros(structure.mesh.nelements, dtype=np.int32)
    for number, cells in enumerate(structure.bodies.values()):
        body[cells] = number
    return to_meshio(
        corner_mesh(structure.mesh),
        point_data={
            "temperature_K": temperature[spaces.heat.nodal_dofs[0]],
            "displacement_m": displacement.reshape(-1, 3)[spaces.displacement.nodal_dofs[0]],
        },
        cell_data={"body": [body]},
        encode_cell_data=False,
    )


def joint_snapshot(setup: Setup, step: Step) -> meshio.Mesh:
    """Side a of all joints with the contact quantities of one step; there is a joint or more.

    Cell data ``contact`` (number of the contact element, from 1, as in the response),
    ``pressure_Pa``, ``conductance_W_m2K``, ``heat_flux_W_m2`` (from side a to side b),
    ``opening_m`` and ``slip_m`` (along, across).
    """
    firsts = np.cumsum([0, *(len(joint.area) for joint in setup.joints)])
    # Cells of one block have as many corners as each other.
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
