"""The inputs that `benchmarks.fuzz` damages: small cases that work, in every format of a mesh."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
from skfem import MeshHex
from skfem.io.meshio import to_meshio

from meshes.exchange import write_structure
from meshes.milling_machine import box_milling_machine
from meshes.structure import Probe, Structure

Files = dict[str, bytes]

MATERIAL = """
[materials.iron]
conductivity_W_mK = 47.0
density_kg_m3 = 7200.0
heat_capacity_J_kgK = 500.0
youngs_modulus_GPa = 104.0
poisson_ratio = 0.27
expansion_1_K = 13.7e-6
"""

MACHINE = (
    """title = "fuzz"
[structure]
kind = "box_milling_machine"
element_size_mm = 150.0
half = true
dimensions_mm = { wall = 50.0 }
"""
    + MATERIAL
    + """
[bodies]
column = "iron"
table = "iron"
screw = "iron"
[joints.knee]
preload_MPa = 4.41
along = 3
across = 1
roughness_um = 1.25
asperity_slope = 0.14
hardness_GPa = 1.961
normal_law = "surface"
friction_coefficient = 0.6
tangential_stiffness_ratio = 0.844
conductance = { law = "cmy-1969" }
[supports]
fixed = ["column_base", "screw_foot"]
symmetry = { symmetry = "z" }
[convection_W_m2K]
exterior = 6.0
[sources.bearings]
surface = "bearings"
reference_power_W = 295.0
count = 2
reading = "per source"
[heat_input]
kind = "triangle"
peak = 2.0
duration_min = 0.2
[march]
step_s = 2.0
duration_min = 0.2
coupling = "staggered"
[displacement]
point = "A"
relative_to = "B"
[probes.T1]
position_mm = [625.0, 450.0, 87.5]
body = "column"
[[candidates]]
body = "column"
low_mm = [500.0, 500.0, 0.0]
high_mm = [600.0, 850.0, 200.0]
spacing_mm = 50.0
"""
)

BARS = (
    """title = "fuzz of a mesh"
[structure]
kind = "mesh"
file = "FILE"
"""
    + MATERIAL
    + """
[bodies]
left = "iron"
right = "iron"
[joints.joint]
preload_MPa = 4.41
along = 2
across = 2
roughness_um = 1.25
asperity_slope = 0.14
hardness_GPa = 1.961
friction_coefficient = 0.6
normal_law = "back-burdekin"
back_burdekin = { coefficient_um = 0.6, exponent = 0.5 }
[supports]
fixed = ["left_end"]
springs = { right_end = { stiffness_N_um = [100.0, 10.0, 10.0] } }
[convection_W_m2K]
left_end = 20.0
[sources.warm]
body = "left"
reference_power_W = 40.0
heat_input = { kind = "sampled", file = "spindle.csv" }
[ambient]
file = "air.csv"
[held_temperatures.right_end]
rise_K = 3.0
[march]
step_s = 2.0
duration_min = 0.2
coupling = "iterated"
[displacement]
point = "end"
relative_to = "start"
[probes.middle]
position_mm = [50.0, 20.0, 20.0]
"""
)

#: The probes of the bars as a case has them, for formats that hold none.
BAR_PROBES = """
[probes.start]
position_mm = [0.0, 20.0, 20.0]
body = "left"
[probes.end]
position_mm = [200.0, 20.0, 20.0]
body = "right"
"""
HISTORIES = {
    "spindle.csv": b"time_s,heat_input\n0,0\n5,1\n12,2.5\n",
    "air.csv": b"time_s,ambient_degC\n0,20\n12,21.5\n",
}


def bars() -> Structure:
    """Two bars end to end, a joint between them."""
    lines = np.linspace(0.0, 0.04, 3)
    halves = [
        MeshHex.init_tensor(np.linspace(*span, 3), lines, lines)
        for span in ((0.0, 0.1), (0.1, 0.2))
    ]
    points = np.hstack([half.p for half in halves])
    mesh = MeshHex(points, np.hstack([halves[0].t, halves[1].t + halves[0].p.shape[1]]))
    facets = mesh.boundary_facets()
    x = mesh.p[0, mesh.facets[:, facets]].mean(axis=0)
    left = mesh.f2t[0, facets] < halves[0].nelements
    near = np.abs(x - 0.1) < 1e-9
    cells = np.arange(mesh.nelements)
    return Structure(
        mesh=mesh,
        bodies={"left": cells[: halves[0].nelements], "right": cells[halves[0].nelements :]},
        surfaces={
            "left_end": facets[x < 1e-9],
            "right_end": facets[x > 0.2 - 1e-9],
            "joint.a": facets[near & left],
            "joint.b": facets[near & ~left],
        },
        joints={"joint": ("joint.a", "joint.b")},
        probes={
            "start": Probe((0.0, 0.02, 0.02), "left"),
            "end": Probe((0.2, 0.02, 0.02), "right"),
        },
    )


def unharmed(folder: Path) -> list[tuple[Files, str]]:
    """Inputs that work, each with the file of it that is to be damaged; ``case.toml`` is run."""
    machine = {"case.toml": MACHINE.encode()}
    meshed = machine_from_mesh(folder / "machine.msh")
    made = {f"bars{s}": bars_from_mesh(folder / f"bars{s}", w) for s, w in WRITERS.items()}
    return [
        (machine, "case.toml"),
        *((meshed, name) for name in meshed),
        *((made["bars.msh"], name) for name in ("case.toml", *HISTORIES)),
        *((files, name) for name, files in made.items()),
    ]


def bars_from_mesh(mesh: Path, write: Callable[[Structure, Path], None]) -> Files:
    """The bars from a mesh file that `write` writes."""
    write(bars(), mesh)
    text = BARS.replace("FILE", mesh.name) + (BAR_PROBES if mesh.suffix in (".inp", ".med") else "")
    return {mesh.name: mesh.read_bytes(), "case.toml": text.encode()} | HISTORIES


def machine_from_mesh(mesh: Path) -> Files:
    """The machine from a mesh file."""
    write_structure(box_milling_machine(element_size=0.15), mesh)
    text = MACHINE.replace('kind = "box_milling_machine"', f'kind = "mesh"\nfile = "{mesh.name}"')
    text = re.sub(r"element_size_mm.*\nhalf.*\ndimensions_mm.*\n", "symmetry_factor = 2\n", text)
    return {"case.toml": text.encode(), mesh.name: mesh.read_bytes()}


def write_vtk(structure: Structure, path: Path) -> None:
    """Write a structure as legacy VTK, with the cell arrays of VTU."""
    between = path.with_suffix(".vtu")
    write_structure(structure, between)
    grid = meshio.vtu.read(str(between))
    # Legacy VTK has no type for single bytes.
    grid.cell_data = {
        name: [part.astype(np.int32) for part in parts] for name, parts in grid.cell_data.items()
    }
    meshio.vtk.write(str(path), grid)


def write_inp(structure: Structure, path: Path) -> None:
    """Write a structure as Abaqus does, an element set for each body and surface."""
    cells, names, points = named_cells(structure)
    nothing = np.array([], dtype=int)
    sets = {
        name: [np.arange(len(nodes)) if k == i else nothing for k, (_, nodes) in enumerate(cells)]
        for i, name in enumerate(names)
    }
    meshio.abaqus.write(str(path), meshio.Mesh(points, cells, cell_sets=sets))


def write_med(structure: Structure, path: Path) -> None:
    """Write a structure as Salome does, a group for each body and surface."""
    cells, names, points = named_cells(structure)
    blocks = {kind: [i for i, (of, _) in enumerate(cells) if of == kind] for kind, _ in cells}
    tags = [
        np.concatenate([np.full(len(cells[i][1]), -1 - i) for i in block])
        for block in blocks.values()
    ]
    merged = [(kind, np.vstack([cells[i][1] for i in block])) for kind, block in blocks.items()]
    grid = meshio.Mesh(points, merged, cell_data={"cell_tags": tags})
    grid.cell_tags = {-1 - i: [name] for i, name in enumerate(names)}
    grid.point_tags = {}
    meshio.med.write(str(path), grid)


def named_cells(
    structure: Structure,
) -> tuple[list[tuple[str, np.ndarray]], list[str], np.ndarray]:
    """A block of cells for each body and surface of hexahedra, their names, and the points."""
    grid = to_meshio(structure.mesh, encode_cell_data=False)
    cells = [("hexahedron", grid.cells[0].data[chosen]) for chosen in structure.bodies.values()]
    cells += [("quad", structure.mesh.facets[:, at].T) for at in structure.surfaces.values()]
    return cells, [*structure.bodies, *structure.surfaces], grid.points


#: Suffix of a mesh file to what writes it.
WRITERS = {
    ".msh": write_structure,
    ".vtu": write_structure,
    ".vtk": write_vtk,
    ".inp": write_inp,
    ".med": write_med,
}
