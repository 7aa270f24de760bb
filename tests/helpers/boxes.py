"""Boxes that touch each other: structures of several bodies, each face a surface of its own."""

import numpy as np
from skfem import MeshHex

from meshes.box_grid import put_side_by_side
from meshes.structure import Structure


def boxes(joints, **corners):
    """Bodies by name, each (low, high) or (low, high, divisions); surfaces BODY.x0 to BODY.z1."""
    grids = []
    for low, high, *divisions in corners.values():
        counts = divisions[0] if divisions else (2, 2, 2)
        lines = zip(low, high, counts, strict=True)
        grids.append(MeshHex.init_tensor(*(np.linspace(a, b, n + 1) for a, b, n in lines)))
    mesh, cells = put_side_by_side(grids)
    facets = mesh.boundary_facets()
    centre = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    surfaces = {}
    for (name, (low, high, *_)), own in zip(corners.items(), cells, strict=True):
        of_body = np.isin(mesh.f2t[0, facets], own)
        for axis, letter in enumerate("xyz"):
            for number, end in enumerate((low[axis], high[axis])):
                on = of_body & (np.abs(centre[axis] - end) < 1e-9)
                surfaces[f"{name}.{letter}{number}"] = facets[on]
    return Structure(
        mesh, bodies=dict(zip(corners, cells, strict=True)), surfaces=surfaces, joints=joints
    )
