"""A beam under a moving load: a slide that grows against a spring above it presses on its guide.

The guide is a slender beam, clamped at both ends. With rotations theta and shear, its deflection
under forces P_i at a_i is that of Timoshenko,

    theta' = M/(E I),    w' = -theta + Q/(kappa G A),    M = M_0 + Q_0 x - sum_i P_i <x - a_i>,

with M_0 and Q_0 from theta = w = 0 at the far end and kappa = 5/6 for a rectangle. The forces are
those of the contact elements, because the slide distributes its load. Poisson's ratio of the guide
is 0: otherwise a guide as wide as deep does not behave as a beam near its clamps (1 % stiffer).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from meshes.exchange import write_structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.moving_axis import (
    PRELOAD,
    on_axis,
    slide_case,
    slide_joint,
    slide_on_guide,
    write_course,
)
from thermojoint.verification.structures import IRON, marched, material_section

#: Beam, slide and their width, m; mesh and contact elements along them, layers of the beam.
LENGTH, DEPTH, SLIDE, HEIGHT, WIDTH = 0.6, 0.02, 0.06, 0.04, 0.02
SIZE, LAYERS = 0.02, 2
#: Temperature rise of the bodies, K; only the slide expands. Spring above it, N/um.
RISE, SPRING = 20.0, 0.5
#: Shear coefficient kappa.
SHEAR = 5.0 / 6.0
#: Point of measurement of the deflection, m, at half depth; ends of the stroke, m.
AT, STROKE = 0.3, (0.06, 0.48)
#: Motion of the slide, s and m: it rests, turns back and passes the middle.
WAY = ((0.0, 0.06), (420.0, 0.48), (480.0, 0.48), (760.0, 0.2))


def checks() -> Iterator[Check]:
    """Check the deflection at a point of the beam while the load moves along it."""
    with temporary_folder() as folder:
        response = marched(folder, _data(folder))
    pressure = response["pressure"].to_numpy() - PRELOAD
    forces = pressure * response["contact_area"].to_numpy()
    moved = response["axis_position"].to_numpy()[:, 0]
    pads = SIZE * (0.5 + np.arange(round(SLIDE / SIZE)))
    down = -response["displacement"].sel(axis="y").to_numpy()
    known = np.array(
        [
            sum(p * deflection(AT, at + place) for p, at in zip(own, pads, strict=True))
            for own, place in zip(forces, moved, strict=True)
        ]
    )
    k = int(np.abs(known).argmax())
    yield Quantity("displacement", "µm", 5e-3, "Timoshenko's beam, closed form").check(
        "beam under a moving load, deflection in its middle",
        1e6 * float(known[k]),
        1e6 * float(down[k]),
        relative_error=float(np.abs(down - known).max() / np.abs(known).max()),
    )


def _data(folder: Path) -> dict[str, Any]:
    lines = (
        np.linspace(0.0, LENGTH, round(LENGTH / SIZE) + 1),
        np.linspace(-DEPTH, 0.0, LAYERS + 1),
        np.array([0.0, WIDTH]),
    )
    pads = round(SLIDE / SIZE)
    slide = (STROKE[0] + np.linspace(0.0, SLIDE, pads + 1), np.linspace(0.0, HEIGHT, 3))
    write_structure(slide_on_guide(lines, slide), folder / "beam.vtu")
    joint = slide_joint(along=pads, across=1, conductance={"law": "none"})
    data = slide_case("beam.vtu", {"joint": joint})
    del data["sources"], data["heat_input"]
    data["materials"]["cold"] = material_section(IRON) | {
        "expansion_1_K": 0.0,
        "poisson_ratio": 0.0,
    }
    data["bodies"]["guide"] = "cold"
    data["initial_temperature"] = {"rise_K": RISE}
    data["supports"]["springs"]["y1"] = {"stiffness_N_um": [0.0, SPRING, 0.0]}
    data["probes"] = {"middle": {"position_mm": [1e3 * AT, -500.0 * DEPTH, 0.0], "body": "guide"}}
    data["displacement"] = {"point": "middle"}
    data["march"] = {"step_s": 20.0, "duration_min": WAY[-1][0] / 60.0}
    times, places = np.array(WAY).T
    stroke = (1e3 * STROKE[0], 1e3 * STROKE[1])
    course = write_course(folder, times, places)
    return on_axis(data, stroke, file=course, mesh_position_mm=stroke[0], station_mm=1e3 * SIZE)


def deflection(x: float, load_at: float) -> float:
    """Deflection at x of the clamped beam per force at a place (m), m/N."""
    second = WIDTH * DEPTH**3 / 12.0
    bending = IRON.youngs_modulus * second
    shearing = SHEAR * WIDTH * DEPTH * IRON.youngs_modulus / 2.0

    def rows(at: float) -> tuple[Array, Array]:
        """Rotation and deflection at a place due to M_0, Q_0 and a unit load."""
        past = max(at - load_at, 0.0)
        theta = np.array([at, at**2 / 2.0, -(past**2) / 2.0]) / bending
        bent = np.array([at**2 / 2.0, at**3 / 6.0, -(past**3) / 6.0]) / bending
        return theta, np.array([0.0, at, -past]) / shearing - bent

    ends = np.array(rows(LENGTH))
    redundant = np.linalg.solve(ends[:, :2], -ends[:, 2])
    return float(rows(x)[1] @ np.append(redundant, 1.0))
