"""Machines made of boxes, whose bodies are placed according to the positions of the axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.box_grid import Box, box_mesh, put_side_by_side
from meshes.structure import Structure


@dataclass(frozen=True)
class BoxMachine:
    """Boxes, surfaces and axes of a machine; every axis moves along its own coordinate."""

    #: From name to boxes with the axes at zero, m.
    bodies: Mapping[str, tuple[Box, ...]]
    #: From body to the motion with each of the axes x, y, z: 0 or 1.
    moved: Mapping[str, tuple[int, int, int]]
    #: From surface to body, normal (0, 1, 2), and its coordinate with the axes at zero, m.
    faces: Mapping[str, tuple[str, int, float]]
    #: Surfaces of guides and pads.
    covered: tuple[str, ...]


def meshed(machine: BoxMachine, size: float, at: Sequence[float] = (0.0, 0.0, 0.0)) -> Structure:
    """Return a machine meshed at a position of its axes.

    The surface "exterior" contains everything except guides and pads.

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
