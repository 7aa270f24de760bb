"""Machines of boxes whose bodies stand where the axes that move them are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.box_grid import Box, box_mesh, put_side_by_side
from meshes.structure import Structure


@dataclass(frozen=True)
class BoxMachine:
    """Boxes, surfaces and axes of a machine; every axis moves along its own coordinate."""

    #: Name to boxes where the axes are at zero, m.
    bodies: Mapping[str, tuple[Box, ...]]
    #: Body to which of the axes x, y, z move it: 0 or 1 each.
    moved: Mapping[str, tuple[int, int, int]]
    #: Surface to body, normal (0, 1, 2), and its coordinate where the axes are at zero, m.
    faces: Mapping[str, tuple[str, int, float]]
    #: What pads cover, and what they cover it with.
    covered: tuple[str, ...]


def meshed(machine: BoxMachine, size: float, at: Sequence[float] = (0.0, 0.0, 0.0)) -> Structure:
    """Return a machine meshed where its axes stand.

    The surface "exterior" has all that guides and pads leave.

    Parameters
    ----------
    machine : BoxMachine
    size : float
        Largest element edge, m.
    at : sequence of float
        Position of the axes x, y and z, m.
    """
    shifts = {name: np.multiply(moved, at) for name, moved in machine.moved.items()}
    meshes = [
        box_mesh(boxes, (), ((), (), ()), size).translated(shifts[name])
        for name, boxes in machine.bodies.items()
    ]
    mesh, cells = put_side_by_side(meshes)
    bodies = dict(zip(machine.bodies, cells, strict=True))
    facets = mesh.boundary_facets()
    centres = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    surfaces = {}
    for name, (body, normal, place) in machine.faces.items():
        own = np.isin(mesh.f2t[0, facets], bodies[body])
        there = np.abs(centres[normal] - place - shifts[body][normal]) < 1e-7
        surfaces[name] = facets[own & there]
    covered = np.concatenate([surfaces[name] for name in machine.covered])
    surfaces["exterior"] = np.setdiff1d(facets, covered)
    return Structure(mesh, bodies, surfaces)
