"""Structures whose joints are not one plane: vees, and sleeves in bores."""

from dataclasses import replace

import numpy as np
from bars import WIDTH, two_bars
from skfem import MeshHex, MeshHex2

from meshes.box_grid import put_side_by_side
from meshes.structure import Structure


def vee(angle, left=(4, 3, 2), right=(2, 5, 3)):
    """Two bars whose joint is a vee across their width: every point is moved along x."""
    bars = two_bars(left, right)
    points = bars.mesh.p.copy()
    points[0] += np.tan(angle) * np.abs(points[1] - WIDTH / 2)
    return replace(bars, mesh=type(bars.mesh)(points, bars.mesh.t), probes={})


INNER, SEAT, OUTER, HEIGHT = 0.03, 0.05, 0.08, 0.02


def two_rings(inner, outer, second_order):
    """A quarter of a sleeve in a bore; the two meshes do not match around the seat."""
    meshes = []
    for (low, high), divisions in (((INNER, SEAT), inner), ((SEAT, OUTER), outer)):
        grid = MeshHex.init_tensor(*(np.linspace(0.0, 1.0, n + 1) for n in divisions))
        grid = MeshHex2.from_mesh(grid) if second_order else grid
        radius, turn = low + (high - low) * grid.doflocs[0], 0.5 * np.pi * grid.doflocs[1]
        bent = np.array([radius * np.cos(turn), radius * np.sin(turn), HEIGHT * grid.doflocs[2]])
        meshes.append(replace(grid, doflocs=bent))
    first, second = meshes
    if second_order:
        # Corners come first in a mesh of second order: put them together, then the rest.
        n, m = first.nvertices, second.nvertices
        straight = MeshHex(
            np.hstack([first.p[:, :n], second.p[:, :m]]), np.hstack([first.t, second.t + n])
        )
        mesh = MeshHex2.from_mesh(straight)
        places = mesh.doflocs.copy()
        cells = np.split(mesh.dofs.element_dofs, [first.nelements], axis=1)
        for part, numbers in zip(meshes, cells, strict=True):
            places[:, numbers] = part.doflocs[:, part.dofs.element_dofs]
        mesh = replace(mesh, doflocs=places)
    else:
        points = np.hstack([first.p, second.p])
        mesh = MeshHex(points, np.hstack([first.t, second.t + first.p.shape[1]]))
    facets = mesh.boundary_facets()
    corner_radius = np.hypot(*mesh.p[:2, mesh.facets[:, facets]])
    owner = mesh.f2t[0, facets] < first.nelements
    on = {
        name: np.abs(corner_radius - radius).max(axis=0) < 1e-9
        for name, radius in (("bore", INNER), ("seat", SEAT), ("rim", OUTER))
    }
    return Structure(
        mesh,
        bodies={
            "left": np.arange(first.nelements),
            "right": np.arange(first.nelements, mesh.nelements),
        },
        surfaces={
            "bore": facets[on["bore"]],
            "rim": facets[on["rim"]],
            "joint.a": facets[on["seat"] & owner],
            "joint.b": facets[on["seat"] & ~owner],
        },
        joints={"joint": ("joint.a", "joint.b")},
    )


def tube(low, high, length, around, along):
    """A closed tube of one layer of cells."""
    grid = MeshHex.init_tensor(*(np.linspace(0.0, 1.0, n + 1) for n in (1, around, along)))
    radius, turn = low + (high - low) * grid.p[0], 2 * np.pi * grid.p[1]
    bent = np.array([radius * np.cos(turn), radius * np.sin(turn), length * grid.p[2]])
    _, first, closed = np.unique(
        np.round(bent, 9) + 0.0, axis=1, return_index=True, return_inverse=True
    )
    return MeshHex(bent[:, first], closed.ravel()[grid.t])


def long_sleeve(length, inner, outer):
    """A tube in a tube, closed around; their meshes, each (around, along), do not match."""
    mesh, (left, _) = put_side_by_side(
        [tube(INNER, SEAT, length, *inner), tube(SEAT, OUTER, length, *outer)]
    )
    facets = mesh.boundary_facets()
    at_seat = np.abs(np.hypot(*mesh.p[:2, mesh.facets[:, facets]]) - SEAT).max(axis=0) < 1e-9
    on_left = np.isin(mesh.f2t[0, facets], left)
    return Structure(
        mesh,
        bodies={"all": np.arange(mesh.nelements)},
        surfaces={"joint.a": facets[at_seat & on_left], "joint.b": facets[at_seat & ~on_left]},
        joints={"joint": ("joint.a", "joint.b")},
    )
