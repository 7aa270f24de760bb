"""Panels of temperature, deformation and contact pressure at one time, for pictures and films."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fesim.march.machine import Step
from fesim.setup.machine import Setup
from meshes.pairing import PairedJoint
from meshes.volume_cells import corner_mesh
from thermojoint.pictures.camera import Array, Camera, Vector, facing
from thermojoint.pictures.figures import LABELLED, places_along
from thermojoint.pictures.scenes import (
    Marker,
    Mirror,
    Panel,
    Surface,
    away_from,
    bodies,
    boundary_faces,
    whole,
)
from thermojoint.pictures.structure_scene import onto

#: Largest displacement in the picture of the deformed shape, relative to the structure's size.
_EXAGGERATED = 0.06


@dataclass(frozen=True)
class Fields:
    """Fields of one step."""

    #: Time, s.
    time: float
    #: Shape (sources,): power of the sources of the whole structure, W.
    heat: Array
    #: Shape (n,): temperature above the initial ambient at the nodes of `Stage.skin`, K.
    temperature: Array
    #: Shape (n, 3): displacement of the same nodes, m.
    displacement: Array
    #: Shape (m,): pressure of the contact elements, Pa.
    pressure: Array


@dataclass(frozen=True)
class Stage:
    """Constant part of a film: the machine, its outer surface, upward direction, symmetry plane."""

    setup: Setup
    skin: Surface
    nodes: NDArray[np.int64]
    up: Vector
    mirror: Mirror | None

    @property
    def size(self) -> float:
        """Longest edge of the structure's box, m."""
        return float(np.ptp(self.setup.structure.mesh.p, axis=1).max())

    @property
    def camera(self) -> Camera:
        """View of the whole structure."""
        return Camera(onto(self.setup.structure, self.up, self.mirror), self.up)


def make_stage(setup: Setup, up: Vector, mirror: Mirror | None) -> Stage:
    """Return the stage of a set-up structure."""
    mesh = corner_mesh(setup.structure.mesh)
    faces = boundary_faces(mesh, mesh.boundary_facets())
    nodes, own = np.unique(faces, return_inverse=True)
    skin = Surface(np.ascontiguousarray(mesh.p[:, nodes].T), own.reshape(faces.shape))
    return Stage(setup, skin, nodes, up, mirror)


def fields_at(stage: Stage, step: Step, sources: int) -> Fields:
    """Return the fields of a step of a case with `sources` sources; solves for the displacement."""
    setup = stage.setup
    temperature = setup.nodal_temperature(step.state)
    # Of heat alone there is none.
    displacement = np.zeros((stage.nodes.size, 3))
    if setup.case.displacement is not None:
        at = setup.spaces.displacement.nodal_dofs[0][stage.nodes]
        displacement = setup.displacement(step).reshape(-1, 3)[at]
    return Fields(
        time=setup.machine.thermal.step * step.state.index,
        heat=step.inputs[:sources],
        temperature=temperature[setup.spaces.heat.nodal_dofs[0][stage.nodes]],
        displacement=displacement,
        pressure=step.state.pressure,
    )


def exaggeration(stage: Stage, largest: float) -> float:
    """Round magnification that makes a displacement of `largest` (m) visible; 1 if it is zero."""
    if largest <= 0.0:
        return 1.0
    value = _EXAGGERATED * stage.size / largest
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(step - value / power)))


def largest_displacement(fields: Fields) -> float:
    """Length of the largest displacement, m."""
    return float(np.linalg.norm(fields.displacement, axis=1).max())


def outside_panel(stage: Stage, fields: Fields) -> Panel:
    """Temperature above the initial ambient on the whole structure."""
    surfaces = whole((replace(stage.skin, values=fields.temperature),), stage.mirror)
    return _temperature_panel(stage, "temperature, outside", surfaces)


def cut_panel(stage: Stage, fields: Fields) -> Panel:
    """Temperature above the initial ambient on the meshed part: a half model is cut open."""
    title = "temperature, outside" if stage.mirror is None else "temperature, cut open"
    return _temperature_panel(stage, title, (replace(stage.skin, values=fields.temperature),))


def _temperature_panel(stage: Stage, title: str, surfaces: tuple[Surface, ...]) -> Panel:
    return Panel(title, surfaces, stage.camera, shows="temperature rise (K)")


def deformed_panel(stage: Stage, fields: Fields, factor: float) -> Panel:
    """Deformed shape, drawn `factor` times too large, over the cold shape."""
    ghost = replace(stage.skin, opacity=0.0)
    warm = replace(
        stage.skin,
        points=stage.skin.points + factor * fields.displacement,
        values=1e6 * np.linalg.norm(fields.displacement, axis=1),
    )
    title = f"deformation drawn {factor:g} times too large"
    return Panel(title, (ghost, warm), stage.camera, shows="displacement (µm)")


def pressure_panel(stage: Stage, fields: Fields) -> Panel:
    """Contact pressure on every contact element; needs at least one joint.

    The numbers are those of the curves of Figure 7 (`figures.pressure_figure`).
    """
    structure, joints = stage.setup.structure, stage.setup.joints
    holder, normal = away_from(structure, structure.joints[joints[0].name][0])
    body = replace(bodies(structure)[holder], opacity=0.25)
    ends = np.cumsum([len(joint.area) for joint in joints])
    parts = np.split(fields.pressure / 1e6, ends[:-1])
    lift = 1e-3 * stage.size
    maps = whole(
        (_contact_map(joint, values, lift) for joint, values in zip(joints, parts, strict=True)),
        stage.mirror,
    )
    around = np.concatenate([surface.points for surface in maps])
    middle = 0.5 * (around.min(axis=0) + around.max(axis=0))
    return Panel(
        f"contact pressure on {', '.join(joint.name for joint in joints)}",
        (*whole((body,), stage.mirror), *maps),
        Camera(facing(normal, stage.up, side=-0.5, height=0.3), stage.up),
        _numbers(joints),
        shows="contact pressure (MPa)",
        close_to=middle + 1.15 * (around - middle),
    )


def _numbers(joints: Sequence[PairedJoint]) -> tuple[Marker, ...]:
    """Return a number for each place along the joints; none if there would be too many to read."""
    centres = np.concatenate([joint.centre for joint in joints])
    names = [joint.name for joint in joints for _ in joint.area]
    _, first = np.unique(places_along(centres, names), return_index=True)
    if len(first) > LABELLED:
        return ()
    points = centres[first].tolist()
    return tuple(Marker((x, y, z), str(k)) for k, (x, y, z) in enumerate(points, start=1))


def _contact_map(joint: PairedJoint, values: Array, lift: float) -> Surface:
    """Rectangles with the centroid and the second moments of the contact elements.

    They lie `lift` (m) above the body that they are drawn on.
    """
    sides = []
    for tangent in joint.tangents.transpose(1, 0, 2):
        along = np.einsum("qi,iq->q", tangent[joint.element], joint.points_a)
        mean = np.bincount(joint.element, joint.weights * along) / joint.area
        spread = joint.weights * (along - mean[joint.element]) ** 2
        # A rectangle of length l has the second moment l2/12 about its centre.
        sides.append(np.sqrt(12.0 * np.bincount(joint.element, spread) / joint.area))
    corners = [
        joint.centre
        + lift * joint.normal
        + 0.5
        * (
            i * sides[0][:, None] * joint.tangents[:, 0]
            + j * sides[1][:, None] * joint.tangents[:, 1]
        )
        for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    points = np.stack(corners, axis=1).reshape(-1, 3)
    return Surface(points, np.arange(len(points)).reshape(-1, 4), values=values)
