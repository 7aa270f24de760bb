"""The structure as in the paper's Figure 6: a cross-section, and the opened joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np

from meshes.pairing import outward_areas
from meshes.structure import Structure
from thermojoint.pictures.camera import Camera, Vector, facing
from thermojoint.pictures.scenes import (
    Marker,
    Mirror,
    Panel,
    Scene,
    Surface,
    away_from,
    bodies,
    part,
    whole,
)

_SIDE_COLOUR, _SOURCE_COLOUR = "#e0a100", "#c8301a"
_SURFACE_COLOURS = (
    *("#8fb8de", "#f2b880", "#a8d5a2", "#e6a4a4", "#c3b1e1", "#d2b48c", "#f4c2d7", "#b8b8b8"),
    *("#dbdb8d", "#9edae5"),
)
#: Displayed distance of the other bodies from the joint, relative to the structure's size.
_APART = 0.35


def structure_scene(
    structure: Structure,
    sources: Sequence[str],
    points: Sequence[Marker],
    up: Vector,
    mirror: Mirror | None = None,
    caption: str = "",
) -> Scene:
    """Structure with its joints, heat sources (surfaces) and named points.

    With the symmetry plane of a half model the first view is towards this plane.
    """
    colours = {side: _SIDE_COLOUR for sides in structure.joints.values() for side in sides}
    colours = dict.fromkeys(sources, _SOURCE_COLOUR) | colours
    plain = bodies(structure, colours)
    coloured = tuple(
        part(structure, structure.surface(name), colour) for name, colour in colours.items()
    )
    heated = [part(structure, structure.surface(name), _SOURCE_COLOUR) for name in sources]
    named = (*points, *(Marker(_centre(surface), "Q") for surface in heated))
    view = onto(structure, up, mirror, sources)
    section = Panel(
        _legend("cross-section" if mirror else "structure", structure, sources, view),
        (*plain.values(), *coloured),
        Camera(view, up),
        named,
    )
    if not structure.joints:
        return Scene((section,), caption)
    side = next(iter(structure.joints.values()))[0]
    holder, normal = away_from(structure, side)
    shift = _APART * float(np.ptp(structure.mesh.p, axis=1).max()) * normal
    apart = tuple(
        surface if name == holder else replace(surface, points=surface.points + shift, opacity=0.25)
        for name, surface in plain.items()
    )
    strips = part(structure, structure.surface(side), _SIDE_COLOUR)
    joint = Panel(
        f"{holder} with its side of the joint, the rest drawn apart",
        whole((*apart, strips), mirror),
        Camera(facing(normal, up, side=-0.8, height=0.5), up),
        tuple(marker for marker in named if _in_body(structure, marker, holder)),
    )
    return Scene((section, joint), caption)


def surfaces_scene(structure: Structure, up: Vector) -> Scene:
    """Named surfaces in different colours with their names, from two opposite sides.

    Joints are labelled at their place; each view labels those other surfaces that face it.
    """
    sides = {side: name for name, both in structure.joints.items() for side in both}
    free = [name for name in structure.surfaces if name not in sides]
    parts = [
        replace(part(structure, structure.surface(name), colour), opacity=1.0)
        for name, colour in zip(structure.surfaces, cycle(_SURFACE_COLOURS), strict=False)
    ]
    rest = bodies(structure, structure.surfaces).values()
    surfaces = (*(one for one in rest if len(one.faces)), *parts)
    joints = [
        Marker(_centre(part(structure, structure.surface(both[0]), "")), f"joint {name}")
        for name, both in structure.joints.items()
    ]
    flat = [k for k in range(3) if not up[k]]
    main = np.eye(3)[flat[0]] + np.eye(3)[flat[1]]
    panels = []
    for sign, height in ((-1.0, 0.7), (1.0, -0.7)):
        view = facing(sign * main, up, side=0.35, height=height)
        names = [name for name in free if _faces(structure, name, view)]
        markers = [Marker(_seen(structure, name, view), name) for name in names]
        title = "from above" if height > 0.0 else "from below, the other side"
        panels.append(Panel(title, surfaces, Camera(view, up), (*joints, *markers)))
    return Scene(tuple(panels))


def _seen(structure: Structure, surface: str, view: Vector) -> Vector:
    """Return the centre of the facet nearest to the centre of all facets that face the eye."""
    facets = structure.surface(surface)
    facets = facets[outward_areas(structure.mesh, facets) @ np.asarray(view) > 0.0]
    middles = structure.mesh.p[:, structure.mesh.facets[:, facets]].mean(axis=1).T
    nearest = np.linalg.norm(middles - middles.mean(axis=0), axis=1).argmin()
    x, y, z = middles[nearest]
    return float(x), float(y), float(z)


def onto(
    structure: Structure, up: Vector, mirror: Mirror | None, sources: Sequence[str] = ()
) -> Vector:
    """View onto the cut of a half model, else onto the heat sources; slightly from above."""
    p = structure.mesh.p
    if mirror is not None:
        middle = 0.5 * (p.min(axis=1) + p.max(axis=1))[mirror.axis]
        main = (1.0 if mirror.plane > middle else -1.0) * np.eye(3)[mirror.axis]
        return facing(main, up, side=-0.64, height=0.36)
    # Along the shortest horizontal edge of the bounding box, so that the broad side is visible.
    flat = [k for k in range(3) if not up[k]]
    main = np.eye(3)[min(flat, key=lambda k: float(np.ptp(p[k])))]
    views = [facing(sign * main, up, side=-0.64, height=0.36) for sign in (1.0, -1.0)]
    return max(views, key=lambda view: sum(_faces(structure, name, view) for name in sources))


def _faces(structure: Structure, surface: str, view: Vector) -> bool:
    """Whether most of a surface faces the eye; occlusion is not considered."""
    areas = outward_areas(structure.mesh, structure.surface(surface))
    towards = areas @ np.asarray(view)
    return bool(towards[towards > 0.0].sum() > 0.5 * np.abs(towards).sum())


def _legend(what: str, structure: Structure, sources: Sequence[str], view: Vector) -> str:
    seen = any(_faces(structure, name, view) for name in sources)
    parts = [f"heat source Q {'red' if seen else 'on the far side'}"] * bool(sources)
    parts += ["joint yellow"] * bool(structure.joints)
    return f"{what} ({', '.join(parts)})" if parts else what


def _centre(surface: Surface) -> Vector:
    x, y, z = surface.points[surface.faces].mean(axis=(0, 1))
    return float(x), float(y), float(z)


def _in_body(structure: Structure, marker: Marker, body: str) -> bool:
    mesh = structure.mesh
    points = mesh.p[:, mesh.t[:, structure.body(body)]]
    at = np.asarray(marker.position)[:, None]
    low, high = points.min(axis=1) - 1e-9, points.max(axis=1) + 1e-9
    return bool(((at >= low) & (at <= high)).all(axis=0).any())
