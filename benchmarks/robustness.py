"""Does the simulator always find an equilibrium? Random machines, joints, heat and steps.

Run: ``python -m benchmarks.robustness [--count 2000] [--markdown docs/robustness.md]``. A structure
is condensed once for `LAWS` marches: neither heat nor joint law enters the condensation. Every
march follows from the seed and its number alone, so ``--first N --count 1`` marches number N again.
With ``--loaded`` machine and flange stand on springs, carry gravity and a force that comes and
goes, and half of their joints start open by 1 um to 0.5 mm, with friction of 0 to 2; half of the
structures have bolts, tightened to a force of their own in each march, some of which settle.
In one of three structures steps are of 0.1 to 600 s, and half of its machines have 120 elements in
a strip. Exit code 1 if one fails or alternates.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.study import ROOT, coarse_machine_data, options_of
from fesim.batch.summary import OPEN_BELOW, is_open, preloads
from fesim.case.schema import Case, case_from_data
from fesim.march.alternation import STUBBORN
from fesim.setup.machine import Setup, set_up, with_laws
from fesim.simulate import simulate
from thermojoint.artefacts.errors import ThermojointError
from thermojoint.artefacts.files import write_text

Data = dict[str, Any]
Point = tuple[float, float, float]

SEED = 9
COUNT = 2000
#: Marches of one condensed structure.
LAWS = 40
#: Of this many structures one is the bolted flange: three bodies, three joints.
FLANGES = 5
STEPS = 200
STEP_SECONDS = (1.0, 2.0, 5.0, 10.0)
#: Of this many structures one has a wide range of steps, s; every other machine among them has so
#: many contact elements along and across each strip.
WIDE, WIDE_STEPS, MANY = 3, (0.1, 600.0), (20, 6)
#: Initial openings, um, and friction of the marches under load; the stiffness, N/um, of springs
#: under a body that an open joint does not hold; forces, N.
OPENINGS, FRICTIONS = (1.0, 500.0), (0.0, 0.2, 0.6, 1.0, 2.0)
SPRINGS, FORCES = (20.0, 200.0), (100.0, 20000.0)
#: Surface under which the springs stand, surface of the force, joint that may start open: of the
#: flange, and of the machine.
CARRIED = {True: ("bore", "bore", "faces"), False: ("knee.b", "bearings", "knee")}
#: Times, s, and factors of the force: it comes at once, swells, and changes its sign.
HISTORIES = ("0,0\n50,0\n50.1,1\n300,1\n300.1,0", "0,0\n400,1\n800,0", "0,1\n200,-1\n400,1")
#: Ends of the bolts, mm: head and thread, with their bodies; their diameters, mm, and forces, kN;
#: times, s, and factors of one that keeps its force, settles, or is tightened further.
BOLTS: dict[bool, tuple[tuple[str, str], list[tuple[Point, Point]]]] = {
    True: (("upper", "lower"), [((54.5, 19.8, 20.0), (54.5, 19.8, -20.0))]),
    False: (
        ("column", "table"),
        [((550.0, y, 87.5), (675.0, y, 87.5)) for y in (390.0, 500.0, 600.0, 710.0)],
    ),
}
DIAMETERS, TIGHTENING = (8.0, 24.0), (10.0, 100.0)
TURNS = (None, "0,1\n100,1\n101,0.6", "0,1\n100,1\n101,1.5")
#: How a march ends in which nothing holds a body any more, or a bolt, or whose surfaces yield:
#: results, and no failures.
LOOSE, YIELDS = "has come loose", "yield as a whole"
#: How one ends that turns to and fro between steps as it does in much shorter ones: a result, too.
OSCILLATES = "oscillates by itself, faster than its steps resolve"
#: Parts of a step in which it is marched once more.
FINER = (10, 100)
#: Upper ends of the bands of friction that the table tells apart.
BANDS = (0.3, 1.0, 3.0, 10.0)
FLANGE = ROOT / "examples" / "bolted_flange"


@dataclass(frozen=True)
class Drawn:
    """One march: its number, whose structure it is, its highest friction, and the case."""

    number: int
    structure: str
    friction: float
    case: Case


@dataclass(frozen=True)
class Figures:
    """Outcome of one march."""

    steps: int
    iterations: int
    most_iterations: int
    cuts: int
    residual: float
    balance: float
    most_open: float


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two, even in its logarithm."""
    return float(low * (high / low) ** rng.uniform())


def widened(rng: np.random.Generator, data: Data, flange: bool) -> None:
    """Draw a step of 0.1 to 600 s, and more than 96 contact elements for half of the machines."""
    step = spread(rng, *WIDE_STEPS)
    data["march"] |= {"step_s": step, "duration_min": STEPS * step / 60.0}
    if not flange and rng.uniform() < 0.5:
        for joint in data["joints"].values():
            joint |= {"along": MANY[0], "across": MANY[1]}


def drawn_structure(rng: np.random.Generator, flange: bool) -> Data:
    """Return a case with materials, films, place of the source and step drawn at random.

    One body is a hundred times softer to a million times stiffer than usual.
    """
    if flange:
        data: Data = tomllib.loads((FLANGE / "case.toml").read_text("utf-8"))
    else:
        data = coarse_machine_data()
        top = float(rng.uniform(400.0, 750.0))
        data["structure"]["dimensions_mm"] = {"source_top": top, "bracket_bottom": 750.0}
    data["materials"] = {body: _material(rng) for body in data["bodies"]}
    data["bodies"] = {body: body for body in data["bodies"]}
    odd = str(rng.choice(list(data["bodies"])))
    data["materials"][odd]["youngs_modulus_GPa"] *= spread(rng, 1e-2, 1e6)
    for surface in data["convection_W_m2K"]:
        data["convection_W_m2K"][surface] = spread(rng, 2.0, 50.0)
    step = float(rng.choice(STEP_SECONDS))
    data["march"] |= {"step_s": step, "duration_min": STEPS * step / 60.0}
    return data


def _material(rng: np.random.Generator) -> Data:
    return {
        "conductivity_W_mK": spread(rng, 10.0, 400.0),
        "density_kg_m3": 7200.0,
        "heat_capacity_J_kgK": spread(rng, 31.0, 1000.0),
        "youngs_modulus_GPa": spread(rng, 50.0, 250.0),
        "poisson_ratio": float(rng.uniform(0.2, 0.35)),
        "expansion_1_K": float(rng.uniform(5e-6, 25e-6)),
    }


def draw_march(rng: np.random.Generator, data: Data, flange: bool) -> float:
    """Put joint laws, heat and coupling at random into a case; return the highest friction."""
    highest = 0.0
    for joint in data["joints"].values():
        # Without friction nothing holds the bolt of the flange in its hole.
        friction = 0.0 if not flange and rng.uniform() < 0.1 else spread(rng, 0.05, BANDS[-1])
        highest = max(highest, friction)
        joint |= {
            "friction_coefficient": friction,
            "preload_MPa": spread(rng, 0.1, 20.0),
            "normal_law": str(rng.choice(["surface", "back-burdekin"])),
            "back_burdekin": {"coefficient_um": 0.6, "exponent": 0.5},
            "roughness_um": spread(rng, 0.2, 5.0),
            "tangential_stiffness_ratio": float(rng.uniform(0.2, 1.0)),
        }
    level = spread(rng, 0.1, 6.0) * float(rng.choice([-1.0, 1.0, 1.0, 1.0]))
    minutes = data["march"]["duration_min"]
    heat: Data = [
        {"kind": "step", "level": level},
        {"kind": "ramp", "level": level, "duration_min": minutes / 2.0},
        {"kind": "triangle", "peak": level, "duration_min": minutes / 3.0},
    ][int(rng.integers(3))]
    data["heat_input"] = heat
    for source in data["sources"].values():
        source.pop("heat_input", None)
    data["march"]["coupling"] = "iterated" if rng.uniform() < 0.2 else "staggered"
    return highest


def load_structure(rng: np.random.Generator, data: Data, flange: bool) -> None:
    """Put springs, gravity and a force at random under and on a structure."""
    under, on, _ = CARRIED[flange]
    stiffness = [spread(rng, *SPRINGS) for _ in range(3)]
    data["supports"].setdefault("springs", {})[under] = {"stiffness_N_um": stiffness}
    direction = rng.standard_normal(3)
    force = spread(rng, *FORCES) * direction / np.linalg.norm(direction)
    data["loads"] = {
        "gravity": {"acceleration_m_s2": [0.0, -9.81, 0.0]},
        "force": {"surface": on, "force_N": force.tolist()},
    }
    if rng.uniform() < 0.5:
        (head, thread), places = BOLTS[flange]
        data["materials"]["bolts"] = _material(rng)
        data["bolts"] = {
            f"bolt {number}": {
                "head": {"position_mm": ends[0], "diameter_mm": 2.0 * diameter, "body": head},
                "thread": {"position_mm": ends[1], "diameter_mm": diameter, "body": thread},
                "diameter_mm": diameter,
                "material": "bolts",
            }
            for number, ends in enumerate(places)
            for diameter in [spread(rng, *DIAMETERS)]
        }


def load_march(rng: np.random.Generator, data: Data, flange: bool, folder: Path) -> float:
    """Put a history, openings and friction at random into a case; return the highest friction."""
    number = int(rng.integers(len(HISTORIES)))
    data["loads"]["force"]["file"] = str(folder / f"{number}.csv")
    for bolt in data.get("bolts", {}).values():
        bolt["force_kN"] = spread(rng, *TIGHTENING)
        turn = int(rng.integers(len(TURNS)))
        bolt.pop("file", None)
        if TURNS[turn] is not None:
            bolt["file"] = str(folder / f"turn{turn}.csv")
    for name, joint in data["joints"].items():
        joint["friction_coefficient"] = float(rng.choice(FRICTIONS[1 if flange else 0 :]))
        joint.pop("initial_opening_um", None)
        joint.pop("reference_pressure_MPa", None)
        if name == CARRIED[flange][2] and rng.uniform() < 0.5:
            joint |= {
                "preload_MPa": 0.0,
                "initial_opening_um": spread(rng, *OPENINGS),
                "reference_pressure_MPa": spread(rng, 0.1, 10.0),
            }
    return max(joint["friction_coefficient"] for joint in data["joints"].values())


def write_histories(folder: Path) -> None:
    """Write the histories of the force."""
    files = {f"{number}.csv": rows for number, rows in enumerate(HISTORIES)}
    files |= {f"turn{number}.csv": rows for number, rows in enumerate(TURNS) if rows}
    for name, rows in files.items():
        (folder / name).write_text(f"time_s,factor\n{rows}\n", "utf-8")


def marches(first: int, count: int, loads: Path | None = None) -> Iterator[Drawn]:
    """Yield the marches from number `first` on; under load with a folder of its histories."""
    group, data, flange, wide = -1, {}, False, False
    for number in range(first, first + count):
        if number // LAWS != group:
            group = number // LAWS
            flange, wide = group % FLANGES == FLANGES - 1, group % WIDE == WIDE - 1
            data = drawn_structure(np.random.default_rng([SEED, 0, group]), flange)
            if wide:
                widened(np.random.default_rng([SEED, 4, group]), data, flange)
            if loads is not None:
                load_structure(np.random.default_rng([SEED, 2, group]), data, flange)
        friction = draw_march(np.random.default_rng([SEED, 1, number]), data, flange)
        if loads is not None:
            own = np.random.default_rng([SEED, 3, number])
            friction = load_march(own, data, flange, loads)
        name = ("bolted flange" if flange else "milling machine") + wide * ", wide steps"
        yield Drawn(number, name, friction, case_from_data(data, f"march {number}", FLANGE))


def figures(response: xr.Dataset) -> Figures:
    """Sum up one march."""
    return Figures(
        steps=response.sizes["time"] - 1,
        iterations=int(response["iterations"].sum()),
        most_iterations=int(response["iterations"].max()),
        cuts=int(response["cuts"].sum()),
        residual=float(response["gap_residual"].max()),
        balance=float(np.abs(response["heat_balance"]).max()),
        most_open=float(
            is_open(response["pressure"].to_numpy(), preloads(response)).mean(axis=1).max()
        ),
    )


def alternates(case: Case, response: xr.Dataset) -> bool:
    """Return whether pressures alternate that do not in shorter steps.

    Where heat and pressure drive each other, a machine oscillates by itself. Steps that are too
    long for it show that as alternation, much shorter ones as an oscillation of the same size.
    """
    begin = response.attrs["unresolved_from_s"]
    end = begin + 3 * STUBBORN * case.march.step_s
    swing = _to_and_fro(response, begin, end)
    for parts in FINER:
        march = {"step_s": case.march.step_s / parts, "duration_min": end / 60.0}
        fine = simulate(case.replace(march=march), accuracy=False).response
        if "unresolved_steps" not in fine.attrs:
            return _to_and_fro(fine, begin, end) < 0.5 * swing
    return True


def _to_and_fro(response: xr.Dataset, begin: float, end: float) -> float:
    """Way of a pressure, in preloads, beyond that from its first to its last value (s)."""
    within = (response["time"] >= begin) & (response["time"] <= end)
    pressure = response["pressure"].to_numpy()[within.to_numpy()] / preloads(response)
    way = np.abs(np.diff(pressure, axis=0)).sum(axis=0)
    return float((way - np.abs(pressure[-1] - pressure[0])).max())


def sweep(first: int, count: int, loads: Path | None = None) -> list[tuple[Drawn, Figures | str]]:
    """March; return the figures of each, or why it failed."""
    found: list[tuple[Drawn, Figures | str]] = []
    setup: Setup | None = None
    console = Console(stderr=True, markup=False)
    for one in track(marches(first, count, loads), "simulations", total=count, console=console):
        if one.number % LAWS == 0:
            setup = None
        try:
            # Bolts are tightened in it: it may fail as a march may.
            setup = setup or set_up(one.case)
            response = simulate(one.case, setup=with_laws(setup, one.case), accuracy=False).response
        except ThermojointError as error:
            console.print(f"{one.number} failed, friction {one.friction:.2g}: {error}")
            found.append((one, str(error)))
        else:
            end: Figures | str = figures(response)
            if "unresolved_steps" in response.attrs:
                end = "alternates" if alternates(one.case, response) else OSCILLATES
                console.print(f"{one.number} {end}, friction {one.friction:.2g}")
            found.append((one, end))
    return found


HEADER = (
    "structure",
    "highest friction",
    "simulations",
    "a body or bolt comes loose, surfaces yield, or the structure oscillates",
    "failed",
    "steps",
    "iterations per step",
    "most",
    "simulations with snap-through",
    "viscous steps",
    "largest gap residual, m",
    "largest heat balance error",
    "largest open share of the joints",
)


def is_result(end: str) -> bool:
    """Return whether the end of a march is a result."""
    return LOOSE in end or YIELDS in end or end == OSCILLATES


def rows(found: list[tuple[Drawn, Figures | str]]) -> list[tuple[str, ...]]:
    """Return the table's rows as text: one for each structure and band of friction."""
    lines = list[tuple[str, ...]]()
    for structure in sorted({one.structure for one, _ in found}, reverse=True):
        for low, high in zip((-1.0, *BANDS), BANDS, strict=False):
            group = [
                end
                for one, end in found
                if one.structure == structure and low < one.friction <= high
            ]
            done = [end for end in group if isinstance(end, Figures)]
            ended = sum(isinstance(end, str) and is_result(end) for end in group)
            if not done:
                continue
            steps = sum(one.steps for one in done)
            lines.append(
                (
                    structure,
                    f"{max(low, 0.0):g} to {high:g}",
                    f"{len(group)}",
                    f"{ended}",
                    f"{len(group) - len(done) - ended}",
                    f"{steps}",
                    f"{sum(one.iterations for one in done) / steps:.2f}",
                    f"{max(one.most_iterations for one in done)}",
                    f"{sum(one.cuts > 0 for one in done)}",
                    f"{sum(one.cuts for one in done)}",
                    f"{max(one.residual for one in done):.1e}",
                    f"{max(one.balance for one in done):.1e}",
                    f"{100.0 * max(one.most_open for one in done):.0f} %",
                )
            )
    return lines


def ends(found: list[tuple[Drawn, Figures | str]]) -> list[str]:
    """Return one line of Markdown for each march that ended before its time."""
    return [
        f"- {one.number}, {one.structure}, {one.case.march.coupling}, friction {one.friction:.2g}: "
        f"{end}"
        for one, end in found
        if isinstance(end, str)
    ]


def page(lines: list[tuple[str, ...]], ended: list[str], first: int, count: int) -> str:
    """Return docs/robustness.md."""
    table = ["| " + " | ".join(line) + " |" for line in (HEADER, ("---",) * len(HEADER), *lines)]
    return "\n".join(
        [
            "# Does the simulator always find an equilibrium?",
            "",
            f"{count} random simulations of {STEPS} steps (seed {SEED}): four in five on the "
            "equal-heights machine with elements of 100 mm, the rest on the bolted flange of the "
            "examples, with three bodies and three joints. Random for each structure:",
            "",
            "- for each body: conductivity 10 to 400 W/(m K), heat capacity 31 to 1000 J/(kg K), "
            "modulus 50 to 250 GPa, expansion 5 to 25e-6 1/K;",
            "- one body made a hundred times softer to a million times stiffer;",
            "- convection 2 to 50 W/(m² K), and the height of the source;",
            f"- a step of {STEP_SECONDS[0]:g} to {STEP_SECONDS[-1]:g} s, in one of {WIDE} "
            f"structures of {WIDE_STEPS[0]:g} to {WIDE_STEPS[1]:g} s (wide steps; half of these "
            f"machines have {MANY[0] * MANY[1]} contact elements).",
            "",
            "Random for each simulation:",
            "",
            "- for each joint: friction 0.05 to 10 (on the machine one in ten without), preload "
            "0.1 to 20 MPa, both normal laws, roughness 0.2 to 5 µm, tangential stiffness 0.2 to 1 "
            "of the normal one;",
            "- heat input 0.1 to 6, one in four cooling; step, ramp or triangle;",
            "- coupling, iterated in one in five.",
            "",
            "A joint may open completely, which is a valid result. A "
            f"contact element counts as open below {OPEN_BELOW:g} of its preload. Command:",
            "",
            "```sh",
            f"python -m benchmarks.robustness --first {first} --count {count} "
            "--markdown docs/robustness.md",
            "```",
            "",
            *table,
            "",
            "Iterations are Newton iterations of the gap equations, including all sweeps of "
            "iterated coupling. After snap-through, viscous steps lead to the next equilibrium "
            "([march.md](march.md)).",
            "",
            "- A failed simulation is printed with its number; `--first NUMBER --count 1` repeats "
            "it.",
            "- A simulation whose pressures alternate from step to step counts as failed, unless "
            "steps of a tenth or a hundredth resolve an oscillation of the same size. Heat and "
            "pressure then drive each other, and the structure oscillates by itself; the summary "
            "reports that the steps are too long.",
            "- A body comes loose where heat opens all of its constraints, and surfaces yield "
            "where a pressure exceeds half of their hardness; the simulation then ends with a "
            "message.",
            "",
            "[loads.md](loads.md#subdivided-steps) has simulations under loads, with bolts and "
            "joints that start open. Ended early or oscillating:",
            "",
            *(ended or ["- none"]),
            "",
        ]
    )


def main() -> int:
    """March, print, write."""
    parser = options_of(__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--loaded", action="store_true")
    asked = parser.parse_args()
    if asked.loaded and asked.markdown:
        parser.error("the page is that of the marches without --loaded")
    with TemporaryDirectory() as folder:
        write_histories(Path(folder))
        found = sweep(asked.first, asked.count, Path(folder) if asked.loaded else None)
    lines = rows(found)
    table = Table(*HEADER)
    for line in lines:
        table.add_row(*line)
    Console(width=170).print(table)
    if asked.markdown:
        write_text(asked.markdown, page(lines, ends(found), asked.first, asked.count))
    return int(any(isinstance(end, str) and not is_result(end) for _, end in found))


if __name__ == "__main__":
    raise SystemExit(main())
