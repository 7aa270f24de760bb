"""A column that carries a ram, and a table: against the machine meshed at the axis positions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fesim.axes.occupation import weights_at
from fesim.axes.setup import operators_of
from fesim.case.schema import case_from_data
from fesim.setup.discretised import discretised
from fesim.setup.parts import make_parts
from meshes.exchange import write_structure
from meshes.three_axes import three_axis_machine
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.structures import IRON, marched, material_section

#: Mesh size, and length of a contact element, m.
SIZE = 0.1
#: Axis positions in the mesh; compared positions, the last one between stations, m.
SHOWN = (0.0, 0.0, 0.0)
STANDS = ((0.2, 0.3, -0.1), (-0.3, -0.2, 0.2))
BETWEEN = (0.13, -0.07, 0.11)
#: Motions of the axes in the expansion, s and mm: they rest, move alone and together.
WAYS = {
    "x": [(0, -300), (300, 250), (600, 250)],
    "y": [(0, 150), (200, 150), (500, -220)],
    "z": [(0, -100), (400, 130), (700, 130)],
}
PRELOAD, RUNNING, RISE = 2e6, 0.1, 20.0
#: Joint, its pads and its guide; bodies that its axis moves, stroke, mm.
AXES: dict[str, tuple[str, str, list[str], list[float]]] = {
    "x": ("column_foot", "bed_top", ["column", "ram"], [-300.0, 300.0]),
    "y": ("ram_back", "column_front", ["ram"], [-300.0, 300.0]),
    "z": ("table_foot", "bed_top", ["table"], [-100.0, 200.0]),
}
#: Area of a joint's pads, m2, and volume of all bodies, m3.
AREA, VOLUME = 0.04, 0.048 + 0.032 + 0.008 + 0.004
#: Faces held by springs along their normals in the expansion.
HELD = {
    "column_side": 0,
    "column_back": 2,
    "ram_side": 0,
    "ram_top": 1,
    "table_side": 0,
    "table_back": 2,
}
FIELDS = (("displacement", "µm", 1e6), ("temperature", "K", 1.0), ("pressure", "MPa", 1e-6))


def checks() -> Iterator[Check]:
    """Check the machine on its axes."""
    with temporary_folder() as folder:
        for at in STANDS:
            yield from _position_checks(folder, at)
        yield _rigid_check(folder)
        yield from _expansion_checks(folder)
        yield from _energy_checks(folder)


def chain_data(folder: Path, shown: tuple[float, float, float]) -> dict[str, Any]:
    """Return a case with the machine meshed at the given axis positions, m; without axes.

    Springs hold the bodies along and across their guides, which are frictionless.
    """
    name = f"chain{'_'.join(f'{1e3 * at:g}' for at in shown)}.vtu"
    write_structure(three_axis_machine(SIZE, shown), folder / name)
    x, y, z = (1e3 * at for at in shown)
    surface = {"roughness_um": 1.25, "asperity_slope": 0.14, "hardness_GPa": 1.961}
    return {
        "title": "machine with three axes",
        "structure": {"kind": "mesh", "file": name},
        "materials": {"iron": material_section(IRON)},
        "bodies": dict.fromkeys(("bed", "column", "ram", "table"), "iron"),
        "joints": {
            f"guide_{axis}": surface
            | {
                "side_a": pads,
                "side_b": guide,
                "preload_MPa": 1e-6 * PRELOAD,
                "along": 2,
                "across": 2,
                "friction_coefficient": 0.0,
                "conductance": {"law": "cmy-1969"},
            }
            for axis, (pads, guide, _, _) in AXES.items()
        },
        "supports": {
            "fixed": ["bed_foot"],
            "springs": {
                "column_back": {"stiffness_N_um": [100.0, 0.0, 100.0]},
                "ram_top": {"stiffness_N_um": [100.0, 100.0, 0.0]},
                "table_back": {"stiffness_N_um": [100.0, 0.0, 100.0]},
            },
        },
        "sources": {"heat": {"surface": "spindle", "reference_power_W": 200.0, "reading": "total"}},
        "heat_input": {"kind": "step", "level": 1.0},
        "convection_W_m2K": {"bed_foot": 200.0, "column_back": 20.0},
        "march": {"step_s": 60.0, "duration_min": 30.0},
        "displacement": {"point": "tool", "relative_to": "work"},
        "probes": {
            "tool": {"position_mm": [400.0 + x, 400.0 + y, 500.0], "body": "ram"},
            "work": {"position_mm": [400.0, 100.0, 600.0 + z], "body": "table"},
            "guide": {"position_mm": [400.0 + x, 100.0, 300.0], "body": "column"},
        },
    }


def on_axes(data: dict[str, Any], courses: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Put the machine of a case, meshed at zero, on its axes: a position or a file for each."""
    axes = {
        name: courses[name]
        | {
            "bodies": bodies,
            "direction": np.eye(3)["xyz".index(name)].tolist(),
            "stroke_mm": stroke,
            "station_mm": 1e3 * SIZE,
            "asked_mm": stroke,
        }
        for name, (_, _, bodies, stroke) in AXES.items()
    }
    joints = {f"guide_{axis}": data["joints"][f"guide_{axis}"] | {"axis": axis} for axis in AXES}
    return data | {"axes": axes, "joints": joints}


def _position_checks(folder: Path, at: tuple[float, float, float]) -> Iterator[Check]:
    """The chain at axis positions against the machine meshed at them."""
    standing = {name: {"position_mm": 1e3 * one} for name, one in zip(AXES, at, strict=True)}
    riding = marched(folder, on_axes(chain_data(folder, SHOWN), standing))
    meshed = marched(folder, chain_data(folder, at))
    where = ", ".join(f"{name} {1e3 * one:g}" for name, one in zip(AXES, at, strict=True))
    for name, unit, factor in FIELDS:
        reference, found = (factor * one[name].to_numpy() for one in (meshed, riding))
        k = np.unravel_index(np.abs(reference).argmax(), reference.shape)
        yield Quantity(name, unit, 1e-6, "machine meshed there").check(
            f"three axes at {where} mm",
            float(reference[k]),
            float(found[k]),
            relative_error=float(np.abs(found - reference).max() / np.abs(reference[k])),
        )


def _rigid_check(folder: Path) -> Check:
    """Largest gap due to a rigid motion of the whole machine, aligned or between stations.

    Each body is displaced by a + w x (x + s), where s is its travel by the axes.
    """
    standing = {name: {"position_mm": 0.0} for name in AXES}
    case = case_from_data(on_axes(chain_data(folder, SHOWN), standing), "chain", folder)
    whole = discretised(case, make_parts(case))
    positions, operators = operators_of(whole)
    basis, bodies = whole.spaces.displacement, whole.parts.structure.bodies
    worst = 0.0
    for at in (*STANDS, BETWEEN):
        places = basis.doflocs.T.copy()
        for moved, (_, _, names, _), way in zip(np.eye(3), AXES.values(), at, strict=True):
            cells = np.concatenate([bodies[name] for name in names])
            places[np.unique(basis.element_dofs[:, cells])] += way * moved
        for motion in np.eye(6):
            moved = (motion[:3] + np.cross(motion[3:], places)).ravel()
            gap = (operators.pads.gap @ moved).reshape(3, -1)
            below = (operators.gap @ moved).reshape(3, -1)
            for aligned, one, of_axis in zip(positions, at, operators.place, strict=True):
                for weight, station in zip(weights_at(aligned, one), of_axis, strict=True):
                    gap += weight * np.where(station >= 0, below[:, station], 0.0)
            worst = max(worst, float(np.abs(gap).max() / np.abs(moved).max()))
    return Quantity("gap", "1", 1e-12, "compatibility").check(
        "three axes, rigid motions, relative to the motion", 0.0, worst, scale=1.0
    )


def _expansion_checks(folder: Path) -> Iterator[Check]:
    """Uniformly warm bodies that expand freely: no pressure changes, wherever the axes move."""
    data = chain_data(folder, SHOWN)
    del data["sources"], data["heat_input"], data["convection_W_m2K"]
    data["supports"] = {
        "symmetry": {"bed_foot": "y", "bed_left": "x", "bed_back": "z"},
        # Faces that stay plane: held only along their normals.
        "springs": {
            face: {"stiffness_N_um": [100.0 * (k == normal) for k in range(3)]}
            for face, normal in HELD.items()
        },
    }
    data["initial_temperature"] = {"rise_K": RISE}
    response = marched(folder, on_axes(data, _courses(folder)))
    change = float(np.abs(response["pressure"] - PRELOAD).max()) / PRELOAD
    yield Quantity("pressure", "MPa", 1e-6).check(
        "three axes, free expansion",
        1e-6 * PRELOAD,
        1e-6 * float(response["pressure"][-1, 0]),
        relative_error=change,
    )
    # Tool: from the ram's side, from its top, from the column's back. Work: from the table's side,
    # from the foot of the bed, from the table's back.
    exact = IRON.expansion * RISE * np.array([0.1 - 0.1, -0.1 - 0.2, 0.4 - 0.1])
    found = response["displacement"].to_numpy()
    yield Quantity("displacement", "µm", 1e-6).check(
        "three axes, free expansion along y",
        1e6 * exact[1],
        1e6 * float(found[-1, 1]),
        relative_error=float(np.abs(found - exact).max() / np.abs(exact).max()),
    )


def _energy_checks(folder: Path) -> Iterator[Check]:
    """Friction alone heats insulated bodies: the heat, mu F times the travel, is conserved."""
    data = chain_data(folder, SHOWN)
    data["convection_W_m2K"] = {}
    data["heat_input"]["level"] = 0.0
    data["march"] = {"step_s": 600.0, "duration_min": 2400.0}
    for joint in data["joints"].values():
        joint["running_friction_coefficient"] = RUNNING
    response = marched(folder, on_axes(data, _courses(folder)))
    way = sum(1e-3 * float(np.abs(np.diff(rows, axis=0)[:, 1]).sum()) for rows in WAYS.values())
    heat = RUNNING * PRELOAD * AREA * way
    compared = Quantity("temperature", "K", 1e-2, "mu F way, the pressures as at the start")
    yield from friction_heat_checks("three axes", response, heat / VOLUME, compared)


def friction_heat_checks(
    name: str, response: xr.Dataset, heat: float, compared: Quantity
) -> Iterator[Check]:
    """Insulated bodies of iron heated by friction with `heat`, J/m3, and their energy balance."""
    reference = heat / (IRON.density * IRON.heat_capacity)
    last = response["temperature"][-1]
    yield compared.check(
        f"{name}, friction heat in insulated bodies",
        reference,
        float(last[0]),
        relative_error=float(np.abs(last - reference).max()) / reference,
    )
    left = float(np.abs(response["heat_balance"]).max())
    yield Quantity("heat balance", "1", 1e-8).check(
        f"{name}, energy in every step", 0.0, left, scale=1.0
    )


def _courses(folder: Path) -> dict[str, dict[str, Any]]:
    for name, rows in WAYS.items():
        text = "".join(f"{time:g},{place:g}\n" for time, place in rows)
        (folder / f"{name}.csv").write_text("time_s,position_mm\n" + text)
    return {name: {"file": f"{name}.csv"} for name in WAYS}
