"""The cases that are compared: two bars, two rods in transient, a coarse milling machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.study import case_data, coarse_machine_data
from fesim.batch.paths import with_values
from fesim.case.schema import Case, case_from_data
from meshes.box_grid import Box, box_mesh, put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Probe, Structure
from thermojoint.verification.structures import IRON, STEEL, material_section

WIDTH, DEPTH = 0.06, 0.04
LEFT, RIGHT = 0.10, 0.15


def bar_structure(size: float) -> Structure:
    """Two bars end to end along x, elements of `size` (m) along them; they share no node."""
    left = Box((0.0, 0.0, 0.0), (LEFT, WIDTH, DEPTH))
    right = Box((LEFT, 0.0, 0.0), (LEFT + RIGHT, WIDTH, DEPTH))

    def grid(box: Box) -> list[float]:
        start, end = box.low[0], box.high[0]
        return np.linspace(start, end, 1 + round((end - start) / size)).tolist()

    mesh, (left_cells, right_cells) = put_side_by_side(
        [box_mesh([box], [], (grid(box), (), ()), WIDTH / 2) for box in (left, right)]
    )
    facets = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    of_left = np.isin(mesh.f2t[0, facets], left_cells)
    at_joint = np.abs(x - LEFT) < 1e-9
    chosen = {
        "left_end": x < 1e-9,
        "right_end": x > LEFT + RIGHT - 1e-9,
        "joint.a": at_joint & of_left,
        "joint.b": at_joint & ~of_left,
        "bottom": y < 1e-9,
        "top": y > WIDTH - 1e-9,
        "back": z < 1e-9,
        "front": z > DEPTH - 1e-9,
    }
    middle = (WIDTH / 2, DEPTH / 2)
    return Structure(
        mesh=mesh,
        bodies={"left": left_cells, "right": right_cells},
        surfaces={name: facets[mask] for name, mask in chosen.items()},
        joints={"joint": ("joint.a", "joint.b")},
        probes={
            "left_face": Probe((LEFT, *middle), "left"),
            "right_face": Probe((LEFT, *middle), "right"),
        },
    )


def bars(folder: Path, size: float = 0.025, **changes: Any) -> Case:
    """Two bars between held temperatures, on rollers at both ends: the joint closes as they warm.

    `folder`: where the mesh is written. `size`: element edge along the bars, m. `changes`: dotted
    keys with "__" for the dot, e.g. ``march__step_s=10.0``.
    """
    file = folder / "bars.vtu"
    write_structure(bar_structure(size), file)
    data: dict[str, Any] = {
        "title": "Two bars",
        "structure": {"kind": "mesh", "file": str(file)},
        "materials": {"iron": material_section(IRON), "steel": material_section(STEEL)},
        "bodies": {"left": "iron", "right": "steel"},
        "joints": {
            "joint": {
                "preload_MPa": 4.41,
                "along": 3,
                "across": 2,
                "roughness_um": 1.25,
                "asperity_slope": 0.14,
                "hardness_GPa": 1.961,
                "friction_coefficient": 0.6,
            }
        },
        "supports": {
            "symmetry": {
                **{"left_end": "x", "right_end": "x"},
                **{"bottom": "y", "top": "y", "back": "z", "front": "z"},
            },
        },
        "held_temperatures": {"left_end": {"rise_K": 5.0}, "right_end": {"rise_K": 0.0}},
        "march": {
            "step_s": 2.0,
            "duration_min": 2.0,
            "coupling": "iterated",
            "thermal": "full",
        },
        "displacement": {"point": "left_face", "relative_to": "right_face"},
        "probes": {
            "left_face": {"position_mm": _mm(LEFT, WIDTH / 2, DEPTH / 2), "body": "left"},
            "right_face": {"position_mm": _mm(LEFT, WIDTH / 2, DEPTH / 2), "body": "right"},
        },
    }
    return case_from_data(with_changes(data, changes), "two bars", folder)


def machine(size: float = 100.0, **changes: Any) -> Case:
    """The equal-heights machine with elements of `size` (mm), heat input 3, 30 steps of 2 s."""
    data = coarse_machine_data(size)
    data["probes"] = {
        "source": {"position_mm": [575.0, 700.0, 100.0], "body": "column"},
        "joint_top": {"position_mm": [650.0, 750.0, 87.5], "body": "column"},
    }
    data["heat_input"] = {"kind": "step", "level": 3.0}
    data["march"] = {
        "step_s": 2.0,
        "duration_min": 1.0,
        "coupling": "iterated",
        "thermal": "full",
    }
    return case_from_data(with_changes(data, changes), "coarse machine", Path())


def knee(size: float, position: float) -> tuple[Case, Case]:
    """The machine with a moving knee: on its axis at a position, mm, and meshed there.

    A rigid nut holds the knee along the axis, where the shipped case has a spring, and the source
    is 10 mm lower, so that strips and pads have the same elements.

    `size`: of the elements, mm; half as much at the joint. `position`: where the knee stands, mm.
    """
    changes: dict[str, Any] = {
        "structure__element_size_mm": size,
        "structure__joint_element_size_mm": size / 2.0,
        "structure__dimensions_mm__source_top": 700.0,
        "supports__symmetry__screw_foot": "y",
        "heat_input__level": 0.2,
        "march__coupling": "iterated",
        "march__step_s": 1e8,
        "march__duration_min": 40e8 / 60.0,
    }
    riding, meshed = (with_changes(case_data("moving_knee"), changes) for _ in range(2))
    for data in (riding, meshed):
        del data["supports"]["springs"], data["joints"]["knee"]["running_friction_coefficient"]
        del data["axes"]["y"]["file"], data["axes"]["y"]["rotation_within_mm"]
    riding["axes"]["y"]["position_mm"] = position
    del meshed["axes"], meshed["joints"]["knee"]["axis"]
    dimensions = meshed["structure"]["dimensions_mm"]
    for name, height in {"table_bottom": 350.0, "table_top": 750.0, "screw_bottom": 250.0}.items():
        dimensions[name] = height + position
    meshed["probes"]["table"]["position_mm"][1] += position
    return tuple(case_from_data(data, "knee", Path()) for data in (riding, meshed))  # type: ignore[return-value]


def with_changes(data: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Return a copy with other values of keys given as "section__key"."""
    return with_values(data, {key.replace("__", "."): value for key, value in changes.items()})


def _mm(*metres: float) -> list[float]:
    return [1e3 * value for value in metres]
