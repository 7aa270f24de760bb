"""Machines that move: arrows over the working volume, and a film in which the bodies move."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fesim.axes.axis import place_of
from fesim.axes.setup import axis_inputs, set_up_axes
from fesim.case.schema import Case, first_step_at, step_count
from fesim.march.machine import Step
from fesim.setup.parts import unit_direction
from fesim.simulate import at_rest, simulate
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI
from thermojoint.console import Report
from thermojoint.pictures.camera import Vector
from thermojoint.pictures.field_scenes import make_stage
from thermojoint.pictures.scenes import (
    Panel,
    Scene,
    Surface,
    curves_of,
    in_minutes,
    mirror_of,
    whole,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

#: Longest arrow, relative to the largest edge of the volume.
LONGEST = 0.3
#: Smallest edge of the drawn volume, relative to the largest.
FLAT = 0.2


def volume_figure(response: xr.Dataset, case: Case) -> Figure:
    """Displacement at the points of the working volume at the last survey, as arrows.

    Rotations, if the response has them, are drawn as arrows along their axes of rotation.

    Raises
    ------
    InputError
        The response ends before the first survey of the volume.
    """
    from matplotlib.figure import Figure

    if "volume_displacement" not in response:
        raise InputError(
            "--show volume: the response says nothing of the volume; simulate to volume.at_s"
        )
    last = response.isel(survey=-1)
    directions = np.array([unit_direction(axis) for axis in case.axes.values()])
    places = 1e3 * response["volume_position"].to_numpy() @ directions
    when = f"{response.attrs['displacement_of']}\n"
    when += f"where the axes stand, after {in_minutes(float(last['survey']))},\n"
    shown = {"displacement": ("µm", "drawn {:g} times too large")}
    if "volume_rotation" in response:
        shown["rotation"] = ("µrad", "drawn along its axis, {:g} mm per mrad")
    figure = Figure(figsize=(7.0 * len(shown), 6.0))
    for k, (name, (unit, scale)) in enumerate(shown.items(), start=1):
        axes = figure.add_subplot(1, len(shown), k, projection="3d")
        vectors = 1e3 * last[f"volume_{name}"].to_numpy()
        arrows, factor = _arrows(axes, places, vectors)
        figure.colorbar(arrows, ax=axes, shrink=0.7, pad=0.12, label=f"{name} ({unit})")
        axes.set_title(f"{name} of {when}{scale.format(factor)}", fontsize=11)
    figure.subplots_adjust(left=0.02, right=0.95, bottom=0.02, top=0.9, wspace=0.05)
    return figure


def _arrows(axes: Axes3D, places: Array, vectors: Array) -> tuple[Line3DCollection, float]:
    """Draw vectors (n, 3) at places (n, 3), mm, coloured by a thousand times their length.

    The scale factor of the arrows is returned as well.
    """
    size, span = np.linalg.norm(vectors, axis=1), np.ptp(places, axis=0)
    factor = _round(LONGEST * span.max() / size.max()) if size.max() > 0.0 else 1.0
    # y is up; with z towards the eye the axes are right-handed.
    order = [0, 2, 1]
    arrows = axes.quiver(*places.T[order], *(factor * vectors).T[order], linewidth=1.6)
    # Order: the shafts, one side of all heads, the other side.
    arrows.set_array(np.tile(1e3 * size, 3))
    axes.scatter(*places.T[order], color="black", s=6)
    axes.set_box_aspect(np.maximum(span, FLAT * span.max())[order])
    axes.invert_yaxis()
    for setter, k in zip((axes.set_xlabel, axes.set_ylabel, axes.set_zlabel), order, strict=True):
        setter(f"{'xyz'[k]} (mm)")
    return arrows, factor


def _round(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten below a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value))


def moving_scenes(case: Case, report: Report, count: int, up: Vector) -> list[Scene]:
    """Simulate a case with axes; return scenes of its temperature at `count` times from rest.

    The bodies are shown at the positions of their axes. There are fewer scenes if the simulation
    has fewer steps.
    """
    report("setting up", 0, 1)
    ready = set_up_axes(case)
    report("setting up", 1, 1)
    setup, step_s = ready.setup, case.march.step_s
    mirror = mirror_of(setup.structure, case.supports.symmetry)
    stage = make_stage(setup, up, mirror)
    camera = stage.camera
    carried = carried_nodes(case, setup.structure, stage.nodes)
    shown = np.array([MILLI * axis.mesh_position_mm for axis in case.axes.values()])
    times = np.linspace(0.0, step_count(case.march) * step_s, count)[1:]
    due = {0} | {first_step_at(float(time), step_s) for time in times}
    own = setup.spaces.heat.nodal_dofs[0][stage.nodes]
    moments: list[tuple[float, Panel]] = []

    def keep(step: Step) -> None:
        if step.state.index not in due:
            return
        time = step_s * step.state.index
        way = np.array(place_of(ready.axes, time)) - shown
        points = stage.skin.points + np.einsum("a,anj->nj", way, carried)
        skin = Surface(points, stage.skin.faces, values=setup.nodal_temperature(step.state)[own])
        panel = Panel("temperature", whole((skin,), mirror), camera, shows="temperature rise (K)")
        moments.append((time, panel))

    keep(at_rest(setup.machine, axis_inputs(case).at(np.zeros(1))[0]))
    response = simulate(
        case, setup=ready, on_step=keep, progress=partial(report, "marching")
    ).response
    curves = curves_of(response, (time for time, _ in moments))
    return [
        Scene((panel,), in_minutes(time), curve)
        for (time, panel), curve in zip(moments, curves, strict=True)
    ]


def carried_nodes(case: Case, structure: Structure, nodes: NDArray[np.int64]) -> Array:
    """Return the displacement of nodes per m of travel of each axis, shape (axes, n, 3)."""
    ways = []
    for axis in case.axes.values():
        cells = np.concatenate([structure.bodies[name] for name in axis.bodies])
        moves = np.isin(nodes, structure.mesh.t[:, cells])
        ways.append(moves[:, None] * unit_direction(axis))
    return np.array(ways)
