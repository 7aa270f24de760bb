"""Contents of a 3-D picture as plain arrays, for any renderer: surfaces, markers, a camera."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.faces import boundary_faces
from meshes.pairing import outward_areas
from meshes.structure import Structure
from thermojoint.artefacts.errors import unknown_name
from thermojoint.artefacts.response import columns_of
from thermojoint.pictures.camera import Array, Camera, Vector, Window, window_around
from thermojoint.pictures.colour_scale import ColourScale, colour_scale

if TYPE_CHECKING:
    import xarray as xr

BODY_COLOURS = ("#c9ccd1", "#9db7d5", "#8f8f8f", "#d9c39a", "#a9c9a4")
_AXES = {"x": 0, "y": 1, "z": 2}
#: Supports whose normals cancel to less than this fraction of their area define no upward
#: direction.
_AGREE = 0.5
_UP_WITHOUT_SUPPORTS: Vector = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Surface:
    """Faces to be drawn."""

    #: Shape (n, 3): points, m.
    points: Array
    #: Shape (m, 3 or 4): corners in order around each face.
    faces: NDArray[np.int64]
    #: Colour of faces without values.
    colour: str = BODY_COLOURS[0]
    #: Opacity, 0 to 1; at 0 only the edges are drawn.
    opacity: float = 1.0
    #: Shape (n,) or (m,): values for the colour map, at the points or on the faces.
    values: Array | None = None


@dataclass(frozen=True)
class Marker:
    """A labelled point, m."""

    position: Vector
    label: str


@dataclass(frozen=True)
class Panel:
    """One view."""

    #: Title above the panel.
    title: str
    #: Surfaces of the panel.
    surfaces: tuple[Surface, ...]
    #: Projection.
    camera: Camera
    #: Labelled points.
    markers: tuple[Marker, ...] = ()
    #: Quantity and unit of the values on its surfaces; empty if there are none.
    shows: str = ""
    #: Shape (n, 3): points that must be visible, m; default all.
    close_to: Array | None = None
    #: Visible window in the plane of projection; set by `finished`.
    window: Window | None = None
    #: Colour scale; set by `finished` if there are values.
    scale: ColourScale | None = None

    @property
    def frame(self) -> Window:
        """Window of a `finished` panel."""
        if self.window is None:
            raise ValueError("a scene is to be finished before it is drawn")
        return self.window


@dataclass(frozen=True)
class Curve:
    """Displacement over the whole run, beside the fields at one time."""

    #: Displaced point.
    title: str
    #: Axes of the displacement.
    axes: tuple[str, ...]
    #: Shape (k,): times, s.
    times: Array
    #: Shape (k, axes): displacement, m.
    displacement: Array
    #: Time of the fields, s.
    now: float


def curves_of(response: xr.Dataset, times: Iterable[float]) -> Iterator[Curve]:
    """Yield the displacement of a response, for the fields of each of some times (s)."""
    axes = tuple(map(str, response["axis"].to_numpy()))
    title = f"displacement of {response.attrs['displacement_of']}"
    moved = columns_of(response, "displacement", axes)
    return (Curve(title, axes, response["time"].to_numpy(), moved, time) for time in times)


@dataclass(frozen=True)
class Scene:
    """A picture: panels side by side, a line above them with time and heat input, a curve."""

    panels: tuple[Panel, ...]
    caption: str = ""
    curve: Curve | None = None


@dataclass(frozen=True)
class Mirror:
    """A symmetry plane: the axis (0, 1, 2) normal to it, and its coordinate, m."""

    axis: int
    plane: float

    def points(self, points: Array) -> Array:
        """Return the mirror images of points (n, 3)."""
        image = points.copy()
        image[:, self.axis] = 2.0 * self.plane - image[:, self.axis]
        return image


def in_minutes(seconds: float) -> str:
    """Return a time of a picture in min: three digits, and all digits of whole minutes."""
    minutes = seconds / 60.0
    return f"{minutes:.3g} min" if minutes < 999.5 else f"{minutes:.0f} min"


def finished(scenes: Sequence[Scene]) -> list[Scene]:
    """Give every panel a window and a colour scale that all scenes of a film share.

    Panels with the same quantity share one scale.
    """
    values: dict[str, list[Array]] = {}
    for panel in (panel for scene in scenes for panel in scene.panels):
        drawn = _drawn(panel)
        if drawn:
            values.setdefault(panel.shows, []).append(np.concatenate(drawn))
    scales = {shows: colour_scale(shows, shown) for shows, shown in values.items()}
    windows = [
        window_around(np.concatenate([_held(panel) for panel in panels]))
        for panels in zip(*(scene.panels for scene in scenes), strict=True)
    ]
    return [
        replace(
            scene,
            panels=tuple(
                replace(panel, window=window, scale=scales.get(panel.shows))
                for panel, window in zip(scene.panels, windows, strict=True)
            ),
        )
        for scene in scenes
    ]


def _drawn(panel: Panel) -> list[Array]:
    """Values shown in a panel, without those of unused points."""
    return [
        surface.values[np.unique(surface.faces)]
        if len(surface.values) == len(surface.points)
        else surface.values
        for surface in panel.surfaces
        if surface.values is not None
    ]


def _held(panel: Panel) -> Array:
    """Projected points that a panel's window must contain."""
    if panel.close_to is not None:
        return panel.camera.project(panel.close_to)
    points = [surface.points[np.unique(surface.faces)] for surface in panel.surfaces]
    points += [np.array([marker.position]) for marker in panel.markers]
    return panel.camera.project(np.concatenate(points))


def mirror_of(structure: Structure, symmetry: Mapping[str, str]) -> Mirror | None:
    """Return the first symmetry plane of a case ({surface: axis}), or None."""
    for name, axis in symmetry.items():
        nodes = structure.mesh.facets[:, structure.surface(name, "supports.symmetry")]
        k = _AXES[axis]
        return Mirror(k, float(structure.mesh.p[k, nodes].mean()))
    return None


def up_direction(structure: Structure, supports: Iterable[str]) -> Vector:
    """Return the upward axis of a structure, away from its supports.

    It is y or z, as in CAD, up or down: whichever is closest to the opposite of the area-weighted
    outward normal of the supports. If that normal lies along x (a beam clamped at its end), if the
    normals cancel (held at both ends), or without supports, it is z.
    """
    facets = [structure.surface(name, "supports") for name in supports]
    if not facets:
        return _UP_WITHOUT_SUPPORTS
    areas = outward_areas(structure.mesh, np.unique(np.concatenate(facets)))
    down = areas.sum(axis=0)
    axis = int(np.abs(down).argmax())
    cancels = np.linalg.norm(down) < _AGREE * np.linalg.norm(areas, axis=1).sum()
    if cancels or axis == _AXES["x"]:
        return _UP_WITHOUT_SUPPORTS
    up = -np.sign(down[axis]) * np.eye(3)[axis]
    return float(up[0]), float(up[1]), float(up[2])


def bodies(structure: Structure, named: Iterable[str] = ()) -> dict[str, Surface]:
    """Outer surface of every body, without the facets of the `named` surfaces."""
    mesh = structure.mesh
    taken = [structure.surface(name) for name in named]
    facets = np.setdiff1d(mesh.boundary_facets(), np.concatenate(taken) if taken else [])
    owner = mesh.f2t[0, facets]
    return {
        name: part(structure, facets[np.isin(owner, cells)], BODY_COLOURS[k % len(BODY_COLOURS)])
        for k, (name, cells) in enumerate(structure.bodies.items())
    }


def part(structure: Structure, facets: NDArray[np.int64], colour: str) -> Surface:
    """Boundary `facets` as a surface."""
    mesh = structure.mesh
    used, faces = np.unique(boundary_faces(mesh, facets), return_inverse=True)
    corners = len(mesh.elem.refdom.facets[0])
    return Surface(np.ascontiguousarray(mesh.p[:, used].T), faces.reshape(-1, corners), colour)


def whole(surfaces: Iterable[Surface], mirror: Mirror | None) -> tuple[Surface, ...]:
    """The surfaces and, for a half model, their mirror images, without the cut between them."""
    if mirror is None:
        return tuple(surfaces)
    return tuple(_both_halves(surface, mirror) for surface in surfaces)


def _both_halves(surface: Surface, mirror: Mirror) -> Surface:
    height = surface.points[:, mirror.axis] - mirror.plane
    count = len(height)
    on_plane = np.abs(height) <= 1e-9
    outside = ~on_plane[surface.faces].all(axis=1)
    # A node on the plane is its own image, so that no seam remains.
    image = np.where(on_plane, np.arange(count), count + np.arange(count))
    half = surface.faces[outside]
    values = surface.values
    if values is not None:
        own = values if len(values) == count else values[outside]
        values = np.concatenate([own, own])
    return replace(
        surface,
        points=np.concatenate([surface.points, mirror.points(surface.points)]),
        faces=np.concatenate([half, image[half]]),
        values=values,
    )


def away_from(structure: Structure, side: str) -> tuple[str, Array]:
    """Return the body that carries a joint's side, and the outward unit normal of that side."""
    facets = structure.surface(side)
    cell = structure.mesh.f2t[0, facets[0]]
    holder = next(name for name, own in structure.bodies.items() if cell in own)
    area = outward_areas(structure.mesh, facets)
    # A closed side (a bush in its bore) has no mean normal.
    mean = area.sum(axis=0)
    if np.linalg.norm(mean) < 1e-6 * np.linalg.norm(area, axis=1).sum():
        mean = area[0]
    return holder, np.asarray(mean / np.linalg.norm(mean))


def probe_position(structure: Structure, name: str) -> Vector:
    """Return the position of a named probe, m; InputError if there is none."""
    if name not in structure.probes:
        raise unknown_name("probe", name, structure.probes, "picture")
    return structure.probes[name].position
