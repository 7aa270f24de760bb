"""What a 3-D picture shows, as plain arrays: surfaces, markers and a view, for any renderer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh

from artefacts.errors import unknown_name
from fesim.march import Step
from fesim.setup import Setup
from meshes.pairing import PairedJoint
from meshes.structure import Structure
from meshes.volume_cells import corner_mesh

Array = NDArray[np.float64]

#: Largest displacement in the picture of the deformed shape, relative to the structure's size.
_EXAGGERATED = 0.06
_BODY_COLOURS = ("#c9ccd1", "#9db7d5", "#8f8f8f", "#d9c39a", "#a9c9a4")
_SIDE_COLOUR, _SOURCE_COLOUR = "#e0a100", "#c8301a"
_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Surface:
    """Faces to be drawn.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        m.
    faces : ndarray of int, shape (m, 3 or 4)
        Corners in order around each face.
    colour : str
        Used where there are no values.
    opacity : float
        0 to 1.
    values : ndarray, shape (n,) or (m,), optional
        What the colour map shows, at the points or on the faces.
    """

    points: Array
    faces: NDArray[np.int64]
    colour: str = _BODY_COLOURS[0]
    opacity: float = 1.0
    values: Array | None = None


@dataclass(frozen=True)
class Marker:
    """A labelled point, m; its label stands to the right of it or to the left."""

    position: tuple[float, float, float]
    label: str
    left: bool = False


@dataclass(frozen=True)
class Panel:
    """One view: from where the camera looks (`view`, any length), and what it sees."""

    title: str
    surfaces: tuple[Surface, ...]
    markers: tuple[Marker, ...] = ()
    view: tuple[float, float, float] = (-1.0, 0.5, 1.6)


@dataclass(frozen=True)
class Scene:
    """A picture: panels side by side and what their colours mean (empty: no colour map)."""

    panels: tuple[Panel, ...]
    bar: str = ""


@dataclass(frozen=True)
class Mirror:
    """A symmetry plane: the axis (0, 1, 2) it is normal to, and where it lies, m."""

    axis: int
    plane: float

    def points(self, points: Array) -> Array:
        """Return the mirror images of points (n, 3)."""
        image = points.copy()
        image[:, self.axis] = 2.0 * self.plane - image[:, self.axis]
        return image


def mirror_of(structure: Structure, symmetry: Mapping[str, str]) -> Mirror | None:
    """Return the first symmetry plane of a case ({surface: axis}), or None."""
    for name, axis in symmetry.items():
        nodes = structure.mesh.facets[:, structure.surface(name, "supports.symmetry")]
        k = _AXES[axis]
        return Mirror(k, float(structure.mesh.p[k, nodes].mean()))
    return None


def boundary_faces(mesh: Mesh, facets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices of boundary `facets` in order around each, shape (m, 3 or 4)."""
    cells = mesh.f2t[0, facets]
    local = np.argmax(mesh.t2f[:, cells] == facets, axis=0)
    corners = np.array(mesh.elem.refdom.facets)
    return np.asarray(mesh.t[corners[local].T, cells].T, dtype=np.int64)


def structure_scene(
    structure: Structure,
    sources: Sequence[str],
    points: Sequence[Marker],
    mirror: Mirror | None = None,
) -> Scene:
    """Structure as in the paper's Figure 6: a cross-section, and the joint with one side apart.

    Parameters
    ----------
    structure : Structure
        The structure.
    sources : sequence of str
        Surfaces where heat enters.
    points : sequence of Marker
        Points and sensors to name.
    mirror : Mirror, optional
        Symmetry plane of a half model: the first view looks onto it.
    """
    named = dict.fromkeys(sources, _SOURCE_COLOUR) | {
        side: _SIDE_COLOUR for sides in structure.joints.values() for side in sides
    }
    plain = _bodies(structure, named)
    heated = [_part(structure, structure.surface(name), _SOURCE_COLOUR) for name in sources]
    named_points = (*points, *(Marker(_centre(part), "Q", left=True) for part in heated))
    marked = tuple(
        _part(structure, structure.surface(name), colour) for name, colour in named.items()
    )
    section = Panel(
        "cross-section (heat source Q red, joint yellow)" if mirror else "structure",
        (*plain.values(), *marked),
        named_points,
        _onto(structure, mirror),
    )
    side_a = next(iter(structure.joints.values()))[0] if structure.joints else None
    if side_a is None:
        return Scene((section,))
    holder, shift = _away_from(structure, side_a)
    apart = tuple(
        surface if name == holder else _ghost(surface, shift) for name, surface in plain.items()
    )
    side = _part(structure, structure.surface(side_a), _SIDE_COLOUR)
    here = tuple(marker for marker in named_points if _in_body(structure, marker, holder))
    joint = Panel(
        f"{holder} with its contact strips, the rest drawn apart",
        _whole((*apart, side), mirror),
        here,
        (1.6, 0.9, 1.3),
    )
    return Scene((section, joint))


def temperature_scene(setup: Setup, step: Step, mirror: Mirror | None = None) -> Scene:
    """Temperature on the structure's surface, K above the initial ambient, whole and cut open."""
    at_nodes = setup.nodal_temperature(step.state)[setup.spaces.heat.nodal_dofs[0]]
    surface = _skin(setup.structure, values=at_nodes)
    panels = [Panel("outside", _whole((surface,), mirror))]
    if mirror is not None:
        panels.append(Panel("cut open", (surface,), view=_onto(setup.structure, mirror)))
    return Scene(tuple(panels), "temperature (K)")


def deformed_scene(setup: Setup, step: Step, mirror: Mirror | None = None) -> Scene:
    """Exaggerated deformed shape, coloured by the size of the displacement, over the cold shape."""
    mesh = setup.structure.mesh
    field = setup.field.solve(setup.nodal_temperature(step.state), step.remainder)
    at_nodes = field.reshape(-1, 3)[setup.spaces.elastic.nodal_dofs[0]]
    size = np.linalg.norm(at_nodes, axis=1)
    extent = float(np.ptp(mesh.p, axis=1).max())
    largest = float(size.max())
    factor = _round(_EXAGGERATED * extent / largest) if largest > 0.0 else 1.0
    cold = _skin(setup.structure)
    ghost = replace(cold, opacity=0.1)
    warm = replace(cold, points=cold.points + factor * at_nodes, values=1e6 * size)
    view = _onto(setup.structure, mirror)
    title = f"displacement drawn {factor:g} times too large"
    return Scene((Panel(title, (ghost, warm), view=view),), "displacement (µm)")


def pressure_scene(setup: Setup, pressure: Array, mirror: Mirror | None = None) -> Scene:
    """Contact pressure (Pa, shape (m,)) on every contact element; there is a joint or more."""
    structure = setup.structure
    sides = structure.joints[setup.joints[0].name]
    holder, _ = _away_from(structure, sides[0])
    body = replace(_bodies(structure, {})[holder], opacity=0.35)
    maps = []
    start = 0
    for joint in setup.joints:
        count = len(joint.area)
        maps.append(_contact_map(joint, pressure[start : start + count] / 1e6))
        start += count
    title = f"contact pressure on {', '.join(joint.name for joint in setup.joints)}"
    panel = Panel(title, _whole((body, *maps), mirror), view=(1.6, 0.7, 1.1))
    return Scene((panel,), "pressure (MPa)")


def _contact_map(joint: PairedJoint, values: Array) -> Surface:
    """Rectangles with the centroid and the second moments of the contact elements."""
    sides = []
    for tangent in joint.tangents.transpose(1, 0, 2):
        along = np.einsum("qi,iq->q", tangent[joint.element], joint.points_a)
        mean = np.bincount(joint.element, joint.weights * along) / joint.area
        spread = joint.weights * (along - mean[joint.element]) ** 2
        # A rectangle of length l has the second moment l2/12 about its centre.
        sides.append(np.sqrt(12.0 * np.bincount(joint.element, spread) / joint.area))
    lift = 1e-3 * joint.normal
    corners = [
        joint.centre
        + lift
        + 0.5
        * (
            i * sides[0][:, None] * joint.tangents[:, 0]
            + j * sides[1][:, None] * joint.tangents[:, 1]
        )
        for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    points = np.stack(corners, axis=1).reshape(-1, 3)
    return Surface(points, np.arange(len(points)).reshape(-1, 4), values=values)


def _bodies(structure: Structure, named: Mapping[str, str]) -> dict[str, Surface]:
    """Outer surface of every body, without the facets of the `named` surfaces."""
    mesh = structure.mesh
    taken = [structure.surface(name) for name in named]
    facets = np.setdiff1d(mesh.boundary_facets(), np.concatenate(taken) if taken else [])
    owner = mesh.f2t[0, facets]
    return {
        name: _part(structure, facets[np.isin(owner, cells)], _BODY_COLOURS[k % len(_BODY_COLOURS)])
        for k, (name, cells) in enumerate(structure.bodies.items())
    }


def _skin(structure: Structure, values: Array | None = None) -> Surface:
    """Whole boundary with values at the mesh's nodes; its points are all of them."""
    mesh = corner_mesh(structure.mesh)
    faces = boundary_faces(mesh, mesh.boundary_facets())
    return Surface(np.ascontiguousarray(mesh.p.T), faces, values=values)


def _part(structure: Structure, facets: NDArray[np.int64], colour: str) -> Surface:
    mesh = structure.mesh
    used, faces = np.unique(boundary_faces(mesh, facets), return_inverse=True)
    corners = len(mesh.elem.refdom.facets[0])
    return Surface(np.ascontiguousarray(mesh.p[:, used].T), faces.reshape(-1, corners), colour)


def _centre(surface: Surface) -> tuple[float, float, float]:
    x, y, z = surface.points[surface.faces].mean(axis=(0, 1))
    return float(x), float(y), float(z)


def _whole(surfaces: tuple[Surface, ...], mirror: Mirror | None) -> tuple[Surface, ...]:
    """The surfaces and, for a half model, their mirror images, without the cut between them."""
    if mirror is None:
        return surfaces
    both = []
    for surface in surfaces:
        height = surface.points[surface.faces, mirror.axis] - mirror.plane
        outside = np.abs(height).max(axis=1) > 1e-9
        values = surface.values
        if values is not None and len(values) == len(surface.faces) != len(surface.points):
            values = values[outside]
        half = replace(surface, faces=surface.faces[outside], values=values)
        both += [half, replace(half, points=mirror.points(half.points))]
    return tuple(both)


def _ghost(surface: Surface, shift: Array) -> Surface:
    return replace(surface, points=surface.points + shift, opacity=0.25)


def _away_from(structure: Structure, side: str) -> tuple[str, Array]:
    """Body that carries a joint's side, and how far to move the others so that it is seen, m."""
    mesh = structure.mesh
    facets = structure.surface(side)
    cells = mesh.f2t[0, facets]
    holder = next(name for name, own in structure.bodies.items() if cells[0] in own)
    face = mesh.p[:, mesh.facets[:, facets[0]]]
    normal = np.cross(face[:, 1] - face[:, 0], face[:, 2] - face[:, 0])
    normal /= np.linalg.norm(normal)
    inward = mesh.p[:, mesh.t[:, cells[0]]].mean(axis=1) - face.mean(axis=1)
    size = float(np.ptp(mesh.p, axis=1).max())
    return holder, -0.35 * size * normal * np.sign(normal @ inward)


def _in_body(structure: Structure, marker: Marker, body: str) -> bool:
    mesh = structure.mesh
    cells = structure.body(body)
    points = mesh.p[:, mesh.t[:, cells]]
    at = np.asarray(marker.position)[:, None]
    low, high = points.min(axis=1) - 1e-9, points.max(axis=1) + 1e-9
    return bool(((at >= low) & (at <= high)).all(axis=0).any())


def _onto(structure: Structure, mirror: Mirror | None) -> tuple[float, float, float]:
    """View onto the cut of a half model, a little from above and from the side."""
    view = np.array([-0.9, 0.5, 1.4])
    if mirror is not None:
        centre = 0.5 * (structure.mesh.p.min(axis=1) + structure.mesh.p.max(axis=1))
        view[mirror.axis] = 1.4 if mirror.plane > centre[mirror.axis] else -1.4
    return float(view[0]), float(view[1]), float(view[2])


def _round(value: float) -> float:
    """Round to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(step - value / power)))


def probe_position(structure: Structure, name: str) -> tuple[float, float, float]:
    """Return where a named probe is, m; InputError if there is none."""
    if name not in structure.probes:
        raise unknown_name("probe", name, structure.probes, "picture")
    return structure.probes[name].position


def markers(points: Mapping[str, tuple[float, float, float]]) -> list[Marker]:
    """Markers at named points (m); labels of points that lie close go to different sides."""
    middle = float(np.median([x for x, _, _ in points.values()])) if points else 0.0
    return [Marker(at, name, at[0] < middle) for name, at in points.items()]
