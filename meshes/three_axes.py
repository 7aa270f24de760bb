"""A small machine of boxes with three axes: a column, a ram on it, and a table.

The column moves along x on the bed and carries the ram, which moves along y; the table moves along
z on the bed. x runs across, y up, and z from the column to the table.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from meshes.box_grid import Box, box_mesh, put_side_by_side
from meshes.structure import Structure

#: Boxes of each body where the axes are at zero, m.
BODIES = {
    "bed": (Box((0.0, -0.1, 0.0), (0.8, 0.0, 0.3)), Box((0.2, -0.1, 0.3), (0.6, 0.0, 0.9))),
    "column": (Box((0.3, 0.0, 0.1), (0.5, 0.8, 0.3)),),
    "ram": (Box((0.3, 0.3, 0.3), (0.5, 0.5, 0.5)),),
    "table": (Box((0.3, 0.0, 0.5), (0.5, 0.1, 0.7)),),
}
#: Which coordinates of the axes move each body.
MOVED = {"bed": (0, 0, 0), "column": (1, 0, 0), "ram": (1, 1, 0), "table": (0, 0, 1)}
#: Surfaces: body, normal (0, 1, 2), and its coordinate where the axes are at zero, m.
FACES = {
    "column_foot": ("column", 1, 0.0),
    "column_front": ("column", 2, 0.3),
    "column_back": ("column", 2, 0.1),
    "column_top": ("column", 1, 0.8),
    "column_side": ("column", 0, 0.3),
    "ram_back": ("ram", 2, 0.3),
    "ram_top": ("ram", 1, 0.5),
    "ram_side": ("ram", 0, 0.3),
    "spindle": ("ram", 2, 0.5),
    "table_foot": ("table", 1, 0.0),
    "table_top": ("table", 1, 0.1),
    "table_back": ("table", 2, 0.5),
    "table_side": ("table", 0, 0.3),
    "bed_top": ("bed", 1, 0.0),
    "bed_foot": ("bed", 1, -0.1),
    "bed_left": ("bed", 0, 0.0),
    "bed_back": ("bed", 2, 0.0),
    "bed_end": ("bed", 2, 0.9),
}
#: What pads cover, and what they cover it with.
COVERED = ("bed_top", "column_foot", "column_front", "ram_back", "table_foot")


def three_axis_machine(size: float, at: Sequence[float] = (0.0, 0.0, 0.0)) -> Structure:
    """Return the machine meshed where its axes stand.

    The surface "exterior" has all that guides and pads leave.

    Parameters
    ----------
    size : float
        Largest element edge, m.
    at : sequence of float
        Position of the axes x, y and z, m.
    """
    shifts = {name: np.multiply(moved, at) for name, moved in MOVED.items()}
    meshes = [
        box_mesh(boxes, (), ((), (), ()), size).translated(shifts[name])
        for name, boxes in BODIES.items()
    ]
    mesh, cells = put_side_by_side(meshes)
    bodies = dict(zip(BODIES, cells, strict=True))
    facets = mesh.boundary_facets()
    centres = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    surfaces = {}
    for name, (body, normal, place) in FACES.items():
        own = np.isin(mesh.f2t[0, facets], bodies[body])
        there = np.abs(centres[normal] - place - shifts[body][normal]) < 1e-7
        surfaces[name] = facets[own & there]
    covered = np.concatenate([surfaces[name] for name in COVERED])
    surfaces["exterior"] = np.setdiff1d(facets, covered)
    return Structure(mesh, bodies, surfaces)
