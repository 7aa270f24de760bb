"""Six blocks on top of each other: five joints with as many contact elements as one wants."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from skfem import MeshHex

from fesim.case.schema import Case, parse_case
from meshes.exchange import write_structure
from meshes.structure import Structure

BLOCKS, WIDTH, HEIGHT = 6, 0.3, 0.1

CASE = """
title = "Six blocks"
structure = {{ kind = "mesh", file = "pillar.vtu" }}
bodies = {{ {bodies} }}
supports = {{ fixed = ["foot"] }}
convection_W_m2K = {{ sides = 6.0, top = 6.0 }}
sources = {{ spindle = {{ surface = "hot", reference_power_W = 300.0 }} }}
heat_input = {{ kind = "step", level = 1.0 }}
march = {{ step_s = 2.0, duration_min = 5.0 }}
displacement = {{ point = "tip" }}
probes = {{ tip = {{ position_mm = [150.0, 150.0, 600.0] }} }}

[materials.cast_iron]
conductivity_W_mK = 47.0
density_kg_m3 = 7200.0
heat_capacity_J_kgK = 500.0
youngs_modulus_GPa = 104.0
poisson_ratio = 0.27
expansion_1_K = 13.7e-6
"""

JOINT = """
[joints.j{number}]
side_a = "top{number}"
side_b = "bottom{above}"
preload_MPa = 1.0
along = {along}
across = {across}
roughness_um = 1.25
asperity_slope = 0.14
hardness_GPa = 1.961
friction_coefficient = 0.2
"""


def pillar_case(folder: Path, along: int, across: int, divisions: int) -> Case:
    """Write the pillar's mesh into a folder and return its case.

    `folder`: where ``pillar.vtu`` goes. `along`, `across`: contact elements of each of the five
    joints. `divisions`: elements along each edge of a joint; a third of it in a block's height.
    """
    write_structure(pillar(divisions), folder / "pillar.vtu")
    bodies = ", ".join(f'block{k} = "cast_iron"' for k in range(BLOCKS))
    joints = [
        JOINT.format(number=k, above=k + 1, along=along, across=across) for k in range(BLOCKS - 1)
    ]
    return parse_case(CASE.format(bodies=bodies) + "".join(joints), "pillar.toml", folder)


def pillar(divisions: int) -> Structure:
    """Build the blocks; neighbours share no node. Half of one side is heated."""
    edge = np.linspace(0.0, WIDTH, divisions + 1)
    rise = np.linspace(0.0, HEIGHT, max(divisions // 3, 1) + 1)
    blocks = [MeshHex.init_tensor(edge, edge, k * HEIGHT + rise) for k in range(BLOCKS)]
    points, cells = blocks[0].p.shape[1], blocks[0].nelements
    mesh = MeshHex(
        np.hstack([block.p for block in blocks]),
        np.hstack([block.t + k * points for k, block in enumerate(blocks)]),
    )
    facets = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    of = mesh.f2t[0, facets] // cells
    inside = (x > 1e-9) & (x < WIDTH - 1e-9) & (y > 1e-9) & (y < WIDTH - 1e-9)
    surfaces = {
        "sides": facets[~inside],
        "hot": facets[(x < 1e-9) & (y < WIDTH / 2) & (of > 2)],
        "foot": facets[z < 1e-9],
        "top": facets[z > BLOCKS * HEIGHT - 1e-9],
    }
    for k in range(BLOCKS):
        surfaces[f"bottom{k}"] = facets[inside & (of == k) & (z < (k + 0.5) * HEIGHT)]
        surfaces[f"top{k}"] = facets[inside & (of == k) & (z > (k + 0.5) * HEIGHT)]
    own = {f"block{k}": np.arange(k * cells, (k + 1) * cells) for k in range(BLOCKS)}
    return Structure(mesh, own, surfaces)
