"""How honest the estimated error of a displacement is, on cases with a known answer.

Each case is simulated once. Its true error (closed form, or the same case with contact elements,
mesh or steps many times finer) is compared with the estimate in the attributes of its response.

    python -m benchmarks.error_estimate            # about three minutes
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from benchmarks.study import case_file, options_of
from fesim.case.schema import Case, ProbeSection, case_from_data, read_case
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from meshes.box_grid import put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Structure
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.structures import box_grid, box_surfaces, facing_sides
from thermojoint.verification.thermal_bar import (
    CAPACITY,
    CONDUCTIVITY,
    DENSITY,
    EXPANSION,
    FOREVER,
    LENGTH,
    METAL,
    WIDTH,
    bar_case,
)

#: True error by estimated one between these counts as honest.
HONEST = 0.3, 3.0
#: Smaller errors are rounding and tolerances of the equations, um.
LEAST = 1e-7

Data = dict[str, Any]


@dataclass(frozen=True)
class Judged:
    """A case with its error."""

    #: The case, and what its error comes from.
    name: str
    what: str
    #: um.
    true: float
    estimated: float
    #: Largest, um.
    displacement: float

    @property
    def ratio(self) -> float:
        """True error by the estimate; one where both are nothing."""
        if max(self.true, self.estimated) < LEAST:
            return 1.0
        return self.true / self.estimated if self.estimated else np.inf


def judged(name: str, what: str, response: xr.Dataset, truth: np.ndarray) -> Judged:
    """Compare a response with true displacements (n, 3) at its times, or (3,) at its end, m.

    A truth by other contact elements or steps shares all the rest, so that only their part counts.
    """
    part = what if what in ("joint", "time") else "total"
    moved = response["displacement"].to_numpy()
    last = moved if truth.ndim == 2 else moved[-1]
    return Judged(
        name,
        what,
        1e6 * float(np.abs(last - truth).max()),
        float(response.attrs.get(f"error_{part}_um", np.nan)),
        1e6 * float(np.abs(moved).max()),
    )


def run(data: Data, folder: Path, accuracy: bool = True) -> xr.Dataset:
    """Simulate the case of some data."""
    return simulate(case_from_data(data, "case", folder), accuracy=accuracy).response


def rods(folder: Path) -> Iterator[Judged]:
    """One-dimensional rods: heat inside, a fin, a transient, weight."""
    heat = {"hot": {"body": "block", "reference_power_W": 20.0}}
    # Held all around, a rod without lateral contraction is one-dimensional.
    sides = {"y0": "y", "y1": "y", "z0": "z", "z1": "z"}
    held_around = {"supports": {"symmetry": {"x0": "x"} | sides}}
    given = 20.0 / (LENGTH * WIDTH**2)
    grown = EXPANSION * given * LENGTH**3 / (12.0 * CONDUCTIVITY)
    held = {"held_temperatures": {"x0": {"rise_K": 0.0}, "x1": {"rise_K": 0.0}}}
    steady = {"heat_input": {"kind": "step", "level": 1.0}}
    for count in (3, 4, 8, 16):
        data = bar_case(folder, {"sources": heat} | held | steady | held_around, (count, 1, 1))
        truth = np.array([grown, 0.0, 0.0])
        response = run(data, folder)
        yield judged(f"rod with heat inside, {count} elements", "mesh", response, truth)
    film = 400.0
    changes = {
        "held_temperatures": {"x0": {"rise_K": 50.0}},
        "convection_W_m2K": dict.fromkeys(("y0", "y1", "z0", "z1"), film),
    } | held_around
    # Its temperature varies across, too: a formula for fins is 1.4 % off.
    fin = run(bar_case(folder, changes, (64, 6, 6)), folder, accuracy=False)
    truth = fin["displacement"].to_numpy()[-1]
    for count in (4, 8, 16):
        data = bar_case(folder, changes, (count, 1, 1))
        yield judged(f"fin, {count} elements", "mesh", run(data, folder), truth)
    for steps in (10, 40, 200, 1000):
        yield heated_end(folder, 40, steps, held_around)
    for count in (3, 6):
        yield heated_end(folder, count, 1000, held_around)


def heated_end(folder: Path, count: int, steps: int, held: Data) -> Judged:
    """A rod that is heated at one end and held at the other, from rest."""
    end, flux = 400.0, 1e5
    changes = {
        "sources": {"hot": {"surface": "x1", "reference_power_W": flux * WIDTH**2}},
        "held_temperatures": {"x0": {"rise_K": 0.0}},
        "heat_input": {"kind": "step", "level": 1.0},
        "march": {"step_s": end / steps, "duration_min": end / 60.0},
    }
    response = run(bar_case(folder, changes | held, (count, 1, 1)), folder)
    times = response["time"].to_numpy()
    diffusivity = CONDUCTIVITY / (DENSITY * CAPACITY)
    waves = (np.arange(400) + 0.5) * np.pi / LENGTH
    still = flux / CONDUCTIVITY * LENGTH**2 / 2.0
    signs = (-1.0) ** np.arange(400)
    parts = 2.0 * flux / (CONDUCTIVITY * LENGTH) * signs / waves**3
    left = (parts * np.exp(-diffusivity * waves**2 * times[:, None])).sum(axis=1)
    truth = response["displacement"].to_numpy().copy()
    truth[:, 0] = EXPANSION * (still - left)
    what = "time" if count > 10 else "mesh"
    return judged(f"rod heated from rest, {count} elements, {steps} steps", what, response, truth)


def block_case(structure: Structure, folder: Path, name: str, changes: Data) -> Data:
    """Write a structure; return a case of its bodies, all of one metal, with some changes."""
    write_structure(structure, folder / f"{name}.vtu")
    data: Data = {
        "title": name,
        "structure": {"kind": "mesh", "file": f"{name}.vtu"},
        "materials": {"metal": METAL | {"poisson_ratio": 0.3}},
        "bodies": dict.fromkeys(structure.bodies, "metal"),
        "march": {"step_s": 1.0, "duration_min": 2.0 / 60.0},
    }
    return data | changes


def beams(folder: Path) -> Iterator[Judged]:
    """Cantilevers under a force, a moment and heat from one side, against a finer mesh."""
    length, height = 0.2, 0.02
    loads: dict[str, dict[str, object]] = {
        "force": {"loads": {"f": {"surface": "x1", "force_N": [0.0, 200.0, 0.0]}}},
        "heat": {
            "sources": {"hot": {"surface": "y1", "reference_power_W": 40.0}},
            "heat_input": {"kind": "step", "level": 1.0},
            "held_temperatures": {"y0": {"rise_K": 0.0}, "x0": {"rise_K": 0.0}},
            "march": {"step_s": FOREVER, "duration_min": FOREVER / 60.0, "thermal": "full"},
        },
    }

    def beam(kind: str, counts: tuple[int, int, int], load: str) -> xr.Dataset:
        mesh = box_grid(kind, counts, (length, height, height))
        structure = Structure(mesh, {"beam": np.arange(mesh.nelements)}, box_surfaces(mesh))
        changes = {
            "supports": {"fixed": ["x0"]},
            "probes": {"tip": {"position_mm": [1e3 * length, 0.0, 0.0]}},
            "displacement": {"point": "tip"},
        }
        name = "-".join(map(str, (kind, *counts)))
        return run(block_case(structure, folder, name, changes | loads[load]), folder)

    for load in loads:
        fine = beam("hexahedra", (32, 6, 6), load)["displacement"].to_numpy()[-1]
        for kind in ("hexahedra", "tetrahedra"):
            for counts in ((4, 1, 1), (8, 2, 2)):
                name = f"cantilever, {load}, {'x'.join(map(str, counts))} {kind}"
                yield judged(name, "mesh", beam(kind, counts, load), fine)


def on_wall(folder: Path, grid: tuple[int, int], changes: Data, name: str) -> xr.Dataset:
    """A block on a joint with a firm plate, with contact elements along x and y."""
    low = box_grid("hexahedra", (8, 8, 1), (0.1, 0.1, 0.02), (0.0, 0.0, -0.02))
    high = box_grid("hexahedra", (8, 8, 2), (0.1, 0.1, 0.04))
    mesh, bodies = put_side_by_side([low, high])
    sides = box_surfaces(mesh)
    lower = mesh.f2t[0, sides["x1"]]
    structure = Structure(
        mesh,
        dict(zip(("plate", "block"), bodies, strict=True)),
        {
            **facing_sides(mesh, 2, 0.0),
            "foot": sides["z0"],
            "top": sides["z1"],
            "right": sides["x1"][np.isin(lower, bodies[1])],
            "left": sides["x0"][np.isin(mesh.f2t[0, sides["x0"]], bodies[1])],
            "spot": sides["z1"][
                (mesh.p[:2, mesh.facets[:, sides["z1"]]].mean(axis=1) < 0.03).all(axis=0)
            ],
        },
        joints={"joint": ("joint.a", "joint.b")},
    )
    joint = {
        "preload_MPa": 1.0,
        "along": grid[0],
        "across": grid[1],
        "roughness_um": 1.25,
        "asperity_slope": 0.14,
        "hardness_GPa": 2.0,
        "friction_coefficient": 0.3,
    } | changes.pop("joint", {})
    given = {
        "joints": {"joint": joint},
        "supports": {"fixed": ["foot"]},
        "probes": {"tip": {"position_mm": [100.0, 100.0, 40.0], "body": "block"}},
        "displacement": {"point": "tip"},
    }
    return run(block_case(structure, folder, name, given | changes), folder, grid[0] < FINE)


#: Contact elements along each side of a block.
COUNTS, FINE = (3, 4, 6, 9), 18
#: Loads of the block: what tilts it little and much, pushes it, heats it at a spot.
BLOCKS: dict[str, Data] = {
    "rocking": {"loads": {"f": {"surface": "top", "force_N": [300.0, 0.0, 0.0]}}},
    "rocking, much": {"loads": {"f": {"surface": "top", "force_N": [2600.0, 0.0, 0.0]}}},
    "rocking, soft joint": {
        "loads": {"f": {"surface": "top", "force_N": [300.0, 0.0, 0.0]}},
        "joint": {
            "normal_law": "back-burdekin",
            "back_burdekin": {"coefficient_um": 8.0, "exponent": 0.5},
        },
    },
    "pulled at a side": {"loads": {"f": {"surface": "right", "force_N": [0.0, 0.0, 3000.0]}}},
    "sliding": {"loads": {"f": {"surface": "left", "force_N": [2800.0, 0.0, 0.0]}}},
    "spot source": {
        "sources": {"hot": {"surface": "spot", "reference_power_W": 60.0}},
        "heat_input": {"kind": "step", "level": 1.0},
        "held_temperatures": {"foot": {"rise_K": 0.0}},
        "march": {"step_s": 1000.0, "duration_min": 100.0},
    },
}


def joints(folder: Path) -> Iterator[Judged]:
    """A block on a joint: 3 to 9 contact elements along a side, against `FINE`."""
    for name, changes in BLOCKS.items():
        fine = on_wall(folder, (FINE, FINE), dict(changes), "fine")["displacement"].to_numpy()[-1]
        for count in COUNTS:
            found = on_wall(folder, (count, count), dict(changes), "block")
            what = f"block, {name}, {count}x{count} contact elements"
            yield judged(what, "joint", found, fine)


def cylinders(folder: Path) -> Iterator[Judged]:
    """A quarter of a thick cylinder under inner pressure (Lamé), its cells with straight edges."""
    inner, outer, height, pressure, modulus, ratio = 0.05, 0.1, 0.01, 50e6, 104e9, 0.3
    share = pressure * inner**2 / (outer**2 - inner**2)
    # In plane strain, at the outer radius.
    grown = 2.0 * share * outer * (1.0 - ratio**2) / modulus
    for counts in ((2, 4), (4, 8), (8, 16)):
        mesh = box_grid("hexahedra", (*counts, 1), (outer - inner, 0.5 * np.pi, height))
        radius, angle = inner + mesh.p[0], mesh.p[1].copy()
        sides = box_surfaces(mesh)
        mesh.p[:2] = radius * np.cos(angle), radius * np.sin(angle)
        structure = Structure(mesh, {"ring": np.arange(mesh.nelements)}, sides)
        changes = {
            "supports": {"symmetry": {"y0": "y", "y1": "x", "z0": "z", "z1": "z"}},
            "loads": {"p": {"surface": "x0", "pressure_MPa": 1e-6 * pressure}},
            "probes": {"P": {"position_mm": [1e3 * outer, 0.0, 0.0]}},
            "displacement": {"point": "P"},
        }
        name = f"Lamé's cylinder, {counts[0]}x{counts[1]}"
        response = run(block_case(structure, folder, f"ring{counts[0]}", changes), folder)
        yield judged(name, "mesh", response, np.array([grown, 0.0, 0.0]))


def machines(folder: Path) -> Iterator[Judged]:
    """The milling machine of the docs' mesh convergence, and the steps of the reference machine."""
    del folder
    nose = {"nose": ProbeSection(position_mm=(600.0, 1050.0, 250.0), body="column")}
    heat = StepInput(kind="step", level=3.0)

    def machine(name: str, size: float, **march: float | str) -> Case:
        case = read_case(case_file(name))
        mesh = {"element_size_mm": size, "joint_element_size_mm": 0.5 * size}
        update = {
            "structure": case.structure.model_copy(update=mesh),
            "march": case.march.model_copy(update=march),
        }
        return case.model_copy(
            update=update | {"candidates": [], "probes": nose, "heat_input": heat}
        )

    limit = 1e-6 * np.array([-253.98, 198.93, 0.0])
    for size in (200.0, 100.0):
        response = simulate(machine("equal_heights", size)).response
        yield judged(f"equal-heights machine, {size:g} mm", "all", response, limit)
    setup = set_up(machine("reference", 100.0))
    best = simulate(
        machine("reference", 100.0, method="adaptive", tolerance_um=1e-3, tolerance_K=1e-3),
        setup=setup,
        accuracy=False,
    )
    truth = best.response["displacement"]
    for step in (2.0, 10.0, 60.0):
        case = machine("reference", 100.0, step_s=step)
        response = simulate(case).response
        there = truth.sel(time=response["time"], method="nearest").to_numpy()
        yield judged(f"reference machine, steps of {step:g} s", "time", response, there)


PARTS = {
    "rods": rods,
    "beams": beams,
    "cylinders": cylinders,
    "joints": joints,
    "machines": machines,
}


def main() -> None:
    """Run all cases and print the table."""
    parser = options_of(__doc__)
    parser.add_argument("--only", choices=PARTS, help="one part of the cases")
    only = parser.parse_args().only
    began, rows = perf_counter(), list[Judged]()
    with temporary_folder() as folder:
        for part in [only] if only else PARTS:
            rows += PARTS[part](folder)
    table = Table("case", "error of", "δ, µm", "true, µm", "estimated, µm", "true/estimated")
    for row in rows:
        mark = "" if HONEST[0] <= row.ratio <= HONEST[1] else " !"
        table.add_row(
            row.name,
            row.what,
            f"{row.displacement:.4g}",
            f"{row.true:.2g}",
            f"{row.estimated:.2g}",
            f"{row.ratio:.2g}{mark}",
        )
    console = Console(width=130)
    console.print(table)
    honest = sum(HONEST[0] <= row.ratio <= HONEST[1] for row in rows)
    share = honest / len(rows)
    console.print(
        f"{honest} of {len(rows)} ({share:.0%}) between {HONEST[0]:g} and {HONEST[1]:g}; "
        f"{perf_counter() - began:.0f} s"
    )


if __name__ == "__main__":
    main()
