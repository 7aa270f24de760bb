"""A slide on a guide: against the structure meshed at its position, and against closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from skfem import MeshHex

from fesim.axes.setup import set_up_axes
from fesim.case.schema import case_from_data
from meshes.box_grid import put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification import axis_chain
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.structures import (
    IRON,
    box_surfaces,
    facing_sides,
    marched,
    material_section,
)

#: Guide along x and slide on it: lengths, depth of the guide, height of the slide, width, m.
GUIDE, SLIDE, DEPTH, HEIGHT, WIDTH = 0.4, 0.08, 0.04, 0.04, 0.04
#: Mesh size, length of a contact element, and position of the slide in the mesh, m.
SIZE, ELEMENT, SHOWN = 0.02, 0.02, 0.12
#: Aligned positions of the slide; a position, and station lengths with the lower end of a stroke
#: for which the position lies halfway between two stations, m.
ALIGNED = (0.0, 0.08, 0.16, 0.24, 0.32)
OFF, BETWEEN = 0.2, ((0.08, 0.0), (0.04, 0.02))
PRELOAD, RUNNING, RISE = 2e6, 0.1, 20.0


def checks() -> Iterator[Check]:
    """Check slides on guides, and a machine with three axes."""
    with temporary_folder() as folder:
        yield from _position_checks(folder)
        yield from _expansion_checks(folder)
        yield from _energy_checks(folder)
        yield from _oscillation_checks(folder)
    yield from axis_chain.checks()


def slide_on_guide(lines: tuple[Array, Array, Array], slide: tuple[Array, Array]) -> Structure:
    """Return a guide with its surface at y = 0 and a slide above it.

    `lines` are the grid of the guide along x, y and z, m; `slide` that of the slide along x and y.
    Along z it equals the guide's.
    """
    mesh, bodies = put_side_by_side(
        [MeshHex.init_tensor(*lines), MeshHex.init_tensor(*slide, lines[2])]
    )
    facets = mesh.boundary_facets()
    x, y, _ = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    sides, outside = facing_sides(mesh, 1, 0.0), box_surfaces(mesh)
    of_guide = facets[y < 0.0]
    ends = {name: np.intersect1d(outside[name], of_guide) for name in ("x0", "x1")}
    tail = (y > 0.0) & (np.abs(x - slide[0][0]) < 1e-9)
    return Structure(
        mesh,
        dict(zip(("guide", "slide"), bodies, strict=True)),
        outside | ends | {"way": sides["joint.a"], "pads": sides["joint.b"], "tail": facets[tail]},
    )


def slide_data(folder: Path, shown: float) -> dict[str, Any]:
    """Return a case with the slide at its position in the mesh, without an axis."""
    lines = tuple(
        np.linspace(low, high, round((high - low) / SIZE) + 1)
        for low, high in ((0.0, GUIDE), (-DEPTH, 0.0), (0.0, WIDTH))
    )
    slide = (shown + np.linspace(0.0, SLIDE, 5), np.linspace(0.0, HEIGHT, 3))
    name = f"slide{1e3 * shown:g}.vtu"
    write_structure(slide_on_guide((lines[0], lines[1], lines[2]), slide), folder / name)
    joint = slide_joint(along=round(SLIDE / ELEMENT), across=2, conductance={"law": "cmy-1969"})
    return slide_case(name, {"joint": joint}) | {
        "convection_W_m2K": {"y0": 200.0},
        "probes": {
            "tool": {"position_mm": [1e3 * shown + 80.0, 40.0, 0.0], "body": "slide"},
            "below": {"position_mm": [200.0, -20.0, 0.0], "body": "guide"},
        },
        "displacement": {"point": "tool", "relative_to": "below"},
    }


def slide_case(mesh: str, joints: dict[str, Any]) -> dict[str, Any]:
    """Return a case of iron bodies, without convection, probes and displacement."""
    return {
        "title": "slide on a guide",
        "structure": {"kind": "mesh", "file": mesh},
        "materials": {"iron": material_section(IRON)},
        "bodies": {"guide": "iron", "slide": "iron"},
        "joints": joints,
        "supports": {
            "fixed": ["x0", "x1"],
            "symmetry": {"z0": "z"},
            "springs": {"tail": {"stiffness_N_um": [50.0, 0.0, 0.0]}},
        },
        "sources": {
            "heat": {"surface": "y1", "reference_power_W": 40.0, "reading": "total"},
        },
        "heat_input": {"kind": "step", "level": 1.0},
        "march": {"step_s": 20.0, "duration_min": 5.0},
    }


def slide_joint(**keys: object) -> dict[str, Any]:
    """Return the section of the joint between slide and guide, with additional keys."""
    surface = {"roughness_um": 1.25, "asperity_slope": 0.14, "hardness_GPa": 1.961}
    sides = {"side_a": "pads", "side_b": "way", "preload_MPa": 1e-6 * PRELOAD}
    return surface | sides | {"friction_coefficient": 0.0} | keys


def on_axis(data: dict[str, Any], stroke: tuple[float, float], **axis: object) -> dict[str, Any]:
    """Put the slide of a case on an axis; lengths in mm."""
    joint = data["joints"]["joint"] | {"axis": "x"}
    given = {
        "bodies": ["slide"],
        "direction": [1.0, 0.0, 0.0],
        "stroke_mm": list(stroke),
        "mesh_position_mm": 1e3 * SHOWN,
        "station_mm": 1e3 * ELEMENT,
        "asked_mm": list(stroke),
    }
    return data | {"joints": {"joint": joint}, "axes": {"x": given | axis}}


def write_course(folder: Path, times: Array, places: Array) -> str:
    """Write positions of an axis, s and m; return the file's name."""
    rows = (f"{t:.12g},{1e3 * p:.12g}\n" for t, p in zip(times, places, strict=True))
    (folder / "course.csv").write_text("time_s,position_mm\n" + "".join(rows))
    return "course.csv"


def _position_checks(folder: Path) -> Iterator[Check]:
    """The slide at positions of its axis against the structure meshed at them."""
    stroke = (0.0, 1e3 * (GUIDE - SLIDE))
    data = slide_data(folder, SHOWN)

    def there(**axis: object) -> xr.Dataset:
        return marched(folder, on_axis(data, stroke, **axis))

    for position in ALIGNED:
        riding = there(position_mm=1e3 * position)
        meshed = marched(folder, slide_data(folder, position))
        for name, unit, factor in (
            ("displacement", "µm", 1e6),
            ("temperature", "K", 1.0),
            ("pressure", "MPa", 1e-6),
        ):
            yield _field(f"at {1e3 * position:g} mm", name, unit, factor, (meshed, riding))
    yield _order(folder, data)


def _order(folder: Path, data: dict[str, Any]) -> Check:
    """Compliance of the joint half a station off, against stations aligned at the position."""

    def compliance(station: float, low: float) -> Array:
        stroke = (1e3 * low, 1e3 * (GUIDE - SLIDE - low))
        axis = on_axis(data, stroke, position_mm=1e3 * OFF, station_mm=1e3 * station)
        moving = set_up_axes(case_from_data(axis, "slide", folder)).moving
        return moving.standing((OFF,)).contact.elastic.compliance

    exact = compliance(ELEMENT, 0.0)
    coarse, finer = (float(np.abs(compliance(*between) - exact).max()) for between in BETWEEN)
    order = np.log(coarse / finer) / np.log(BETWEEN[0][0] / BETWEEN[1][0])
    quantity = Quantity("order of the compliance", "1", 0.25, "linear interpolation")
    return quantity.check("moving axis, between stations", 2.0, float(order))


def _field(
    where: str, name: str, unit: str, factor: float, both: tuple[xr.Dataset, xr.Dataset]
) -> Check:
    """Largest difference over time and places, relative to the largest value."""
    meshed, riding = (one[name].to_numpy() for one in both)
    at = np.unravel_index(np.abs(meshed).argmax(), meshed.shape)
    quantity = Quantity(name, unit, 1e-6, "structure meshed there")
    return quantity.check(
        f"moving axis, {where}",
        factor * float(meshed[at]),
        factor * float(riding[at]),
        relative_error=_error(*both, name),
    )


def _error(meshed: xr.Dataset, riding: xr.Dataset, name: str) -> float:
    apart = np.abs(riding[name].to_numpy() - meshed[name].to_numpy())
    return float(apart.max() / np.abs(meshed[name]).max())


def _expansion_checks(folder: Path) -> Iterator[Check]:
    """Uniformly warm bodies that expand freely: no pressure changes, wherever the slide moves."""
    times, places = np.array([0.0, 100.0, 160.0, 300.0]), np.array([0.0, 0.25, 0.25, 0.07])
    data = slide_data(folder, SHOWN)
    del data["sources"], data["heat_input"], data["convection_W_m2K"]
    data["supports"] |= {"fixed": [], "symmetry": {"x0": "x", "y0": "y", "z0": "z"}}
    data["initial_temperature"] = {"rise_K": RISE}
    course = write_course(folder, times, places)
    response = marched(folder, on_axis(data, (0.0, 320.0), file=course))
    change = np.abs(response["pressure"] - PRELOAD).max()
    yield Quantity("pressure", "MPa", 1e-6).check(
        "moving axis, free expansion",
        1e-6 * PRELOAD,
        1e-6 * float(response["pressure"][-1, 0]),
        relative_error=float(change) / PRELOAD,
    )
    strain = IRON.expansion * RISE
    # From the tail's spring and the guide's end; the surface of the guide lifts the slide.
    exact = strain * np.array([SLIDE - 0.2, HEIGHT + 0.02, 0.0])
    computed = response["displacement"].to_numpy()
    for axis, reference in zip("xy", exact, strict=False):
        yield Quantity("displacement", "µm", 1e-6).check(
            f"moving axis, free expansion along {axis}",
            1e6 * reference,
            1e6 * float(response["displacement"].sel(axis=axis)[-1]),
            relative_error=float(np.abs(computed - exact).max() / np.abs(exact).max()),
        )


def _energy_checks(folder: Path) -> Iterator[Check]:
    """Friction alone heats insulated bodies: final rise mu F times travel over heat capacity."""
    times = np.array([0.0, 250.0, 400.0, 700.0])
    places = np.array([0.0, 0.3, 0.03, 0.21])
    data = slide_data(folder, SHOWN)
    data["convection_W_m2K"] = {}
    data["heat_input"]["level"] = 0.0
    data["joints"]["joint"]["running_friction_coefficient"] = RUNNING
    data["march"] = {"step_s": 200.0, "duration_min": 600.0}
    response = marched(
        folder, on_axis(data, (0.0, 320.0), file=write_course(folder, times, places))
    )
    way = float(np.abs(np.diff(places)).sum())
    volume = WIDTH * (GUIDE * DEPTH + SLIDE * HEIGHT)
    heat = RUNNING * PRELOAD * SLIDE * WIDTH * way
    yield from axis_chain.friction_heat_checks(
        "moving axis", response, heat / volume, Quantity("temperature", "K", 1e-6)
    )
    change = (response["pressure"] - PRELOAD) * response["contact_area"]
    force = float(np.abs(change.sum("contact")).max() / np.abs(change).max())
    yield Quantity("sum of the pressures", "1", 1e-4, "equilibrium").check(
        "moving axis, forces on the slide", 0.0, force, scale=1.0
    )


def _oscillation_checks(folder: Path) -> Iterator[Check]:
    """Oscillation with a short period: steps that resolve it against steps of a whole period."""
    period, end = 0.5, 60.0
    turns = np.arange(0.0, end + 0.5 * period, 0.5 * period)
    places = np.where(np.arange(turns.size) % 2, 0.2, 0.12)
    data = on_axis(slide_data(folder, SHOWN), (0.12, 0.2), file=write_course(folder, turns, places))
    data["axes"]["x"] |= {"stroke_mm": [120.0, 200.0], "asked_mm": [120.0, 200.0]}
    means = []
    for step in (period / 10.0, period):
        data["march"] = {"step_s": step, "duration_min": end / 60.0}
        means.append(float(marched(folder, data)["temperature"].sel(probe="below")[-1]))
    yield Quantity("temperature", "K", 1e-2, "steps of a tenth of the period").check(
        "moving axis, oscillation, its time mean", *means
    )
