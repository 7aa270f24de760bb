"""Does a machine that moves always march? Random strokes, speeds, pads, drives and heat.

Run: ``python -m benchmarks.moving_robustness [--first 0] [--count 1000]``. Every march follows from
the seed and its number alone, so ``--first N --count 1`` marches number N again. One in ten has a
position outside its stroke, one in ten a stroke on which pads leave their guide: both must be
refused in one line. Exit code 1 if one fails, or is not refused.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.progress import track

from benchmarks.robustness import LOOSE, spread
from benchmarks.study import options_of
from fesim.batch.summary import preloads
from fesim.case.schema import case_from_data
from fesim.march.alternation import alternating
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError, ThermojointError
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification import axis_chain, moving_axis

Data = dict[str, Any]

SEED, COUNT = 25, 1000
#: Of this many marches one has a position outside its stroke, and another one too long a stroke.
WRONG = 10
STEPS = 60
#: Largest speed, m/s; step, s; stations, mm: whole parts of the contact elements, and others.
SPEED, STEP, STATIONS = 2.0, (1.0, 300.0), (20.0, 50.0, 100.0, 33.0)
#: Ends of the longest strokes, mm, on which the pads stay on their guides.
STROKES = {name: stroke for name, (_, _, _, stroke) in axis_chain.AXES.items()}
SLIDE = (0.0, 1e3 * (moving_axis.GUIDE - moving_axis.SLIDE))
#: Points of the volume, at the end.
POINTS = 30
OUTSIDE, LEAVES, WELL = "outside its stroke", "leaves its guide", "marches"
#: What ends a march that was to be refused, by why.
REFUSED = {OUTSIDE: "outside stroke_mm", LEAVES: "guide"}


def drawn(number: int, folder: Path) -> tuple[str, Data]:
    """Return what is expected of a march, and its case."""
    rng = np.random.default_rng([SEED, number])
    expected = {0: OUTSIDE, 1: LEAVES}.get(number % WRONG, WELL)
    step = spread(rng, *STEP)
    chain = rng.uniform() < 0.6
    if chain:
        data, strokes = axis_chain.chain_data(folder, axis_chain.SHOWN), STROKES
        own = {name: _stroke(rng, stroke) for name, stroke in strokes.items()}
        data = axis_chain.on_axes(data, {name: {"position_mm": 0.0} for name in own})
    else:
        data, strokes = moving_axis.slide_data(folder, moving_axis.SHOWN), {"x": [*SLIDE]}
        own = {"x": _stroke(rng, SLIDE)}
        data = moving_axis.on_axis(data, own["x"], position_mm=0.0)
    wrong = str(rng.choice(list(own)))
    if expected == LEAVES:
        far = float(rng.uniform(30.0, 200.0))
        low, high = strokes[wrong]
        # The bed goes on below the lower end of z.
        beyond = wrong == "z" or rng.uniform() < 0.5
        own[wrong] = (low, high + far) if beyond else (low - far, high)
    for name, axis in data["axes"].items():
        low, high = own[name]
        station = float(rng.choice(STATIONS if chain else STATIONS[:2]))
        axis |= {
            "stroke_mm": [low, high],
            "station_mm": station,
            "asked_mm": sorted(rng.uniform(low, high, 3).tolist()),
            "file": _course(rng, (low, high), step, folder / f"{name}.csv"),
        }
        axis.pop("position_mm")
        _drive(rng, axis)
    if expected == OUTSIDE:
        _leave(rng, own[wrong], folder / f"{wrong}.csv")
    for joint in data["joints"].values():
        joint |= {
            "friction_coefficient": float(rng.choice([0.0, 0.1, 0.5, 1.0])),
            "preload_MPa": spread(rng, 0.1, 20.0),
            "normal_law": str(rng.choice(["surface", "back-burdekin"])),
            "back_burdekin": {"coefficient_um": 0.6, "exponent": 0.5},
            "running_friction_coefficient": float(rng.choice([0.0, 0.003, 0.1])),
        }
    data["heat_input"] = {"kind": "step", "level": float(rng.uniform(-2.0, 6.0))}
    data["march"] = {
        "step_s": step,
        "duration_min": STEPS * step / 60.0,
        "coupling": "iterated" if rng.uniform() < 0.2 else "staggered",
    }
    low, high = np.transpose(list(own.values()))
    points = rng.uniform(low, high, (POINTS, len(own)))
    data["volume"] = {
        "points_mm": [dict(zip(own, point.tolist(), strict=True)) for point in points]
    }
    return expected, data


def _stroke(rng: np.random.Generator, longest: Any) -> tuple[float, float]:
    """A part of the longest stroke, with zero in it where that is, at least a fifth of it."""
    low, high = longest
    first, last = rng.uniform(0.0, 0.4, 2) * (high - low)
    return float(low + first), float(high - last)


def _course(rng: np.random.Generator, stroke: tuple[float, float], step: float, path: Path) -> str:
    """Stands, ways at some speed, and to and fro within steps."""
    time, place, rows = 0.0, float(rng.uniform(*stroke)), list[tuple[float, float]]()
    while time < STEPS * step and len(rows) < 2000:
        rows.append((time, place))
        if rng.uniform() < 0.3:
            time += spread(rng, 0.1, 20.0) * step
        else:
            to, speed = float(rng.uniform(*stroke)), 1e3 * spread(rng, 1e-5, SPEED)
            time, place = time + max(1e-3, abs(to - place) / speed), to
    path.write_text("time_s,position_mm\n" + "".join(f"{t:.9g},{p:.9g}\n" for t, p in rows))
    return path.name


def _leave(rng: np.random.Generator, stroke: tuple[float, float], path: Path) -> None:
    """Put one position of a course outside the stroke."""
    header, *rows = path.read_text().splitlines()
    at = int(rng.integers(len(rows)))
    low, high = stroke
    away = spread(rng, 0.01, 1e3)
    time, _, _ = rows[at].partition(",")
    rows[at] = f"{time},{high + away if rng.uniform() < 0.5 else low - away:.9g}"
    path.write_text("\n".join([header, *rows]) + "\n")


def _drive(rng: np.random.Generator, axis: Data) -> None:
    """A ball screw, a scale, both or neither."""
    low, high = axis["stroke_mm"]
    if rng.uniform() < 0.4:
        bearings = str(rng.choice(["fixed-free", "fixed-supported", "fixed-fixed"]))
        ends = [low - 100.0, high + 100.0]
        axis["ball_screw"] = {
            "bearings": bearings,
            "fixed_bearing_mm": ends[0],
            "far_end_mm": ends[1],
            "nut_length_mm": 80.0,
            "diameter_mm": 32.0,
            "lead_mm": 10.0,
            "material": "iron",
            "film_W_m2K": spread(rng, 2.0, 50.0),
            "nut_torque_Nm": spread(rng, 0.01, 2.0),
        } | ({"stretch_um": float(rng.uniform(0.0, 80.0))} if bearings == "fixed-fixed" else {})
    if rng.uniform() < 0.3:
        axis["scale"] = {"expansion_1_K": 8e-6, "fixed_mm": float(rng.uniform(low, high))}
    if ("ball_screw" in axis or "scale" in axis) and rng.uniform() < 0.5:
        axis["zero_mm"] = float(rng.uniform(low, high))


def outcome(expected: str, data: Data, folder: Path) -> str:
    """March; return how it ends: as expected, loose, or what is wrong."""
    try:
        response = simulate(case_from_data(data, "march", folder), accuracy=False).response
    except InputError as error:
        said = str(error)
        if REFUSED.get(expected, "\n") in said and "\n" not in said:
            return f"{expected}: refused"
        return f"refused: {said}"
    except ThermojointError as error:
        return "a body comes loose" if LOOSE in str(error) else f"failed: {error}"
    return f"{expected}: not refused" if expected != WELL else judged(response)


def judged(response: xr.Dataset) -> str:
    """Say whether a march is sound."""
    sizes = {
        "gap residual": (float(response["gap_residual"].max()), 1e-11),
        "gap residual in the volume": (float(response["volume_gap_residual"].max()), 1e-11),
        "heat balance": (float(np.abs(response["heat_balance"]).max()), 1e-8),
    }
    for name, (size, limit) in sizes.items():
        if not size <= limit:
            return f"failed: {name} {size:.1e}"
    if not all(np.isfinite(one).all() for one in response.values() if one.dtype.kind == "f"):
        return "failed: not finite"
    pressure = response["pressure"].to_numpy() / preloads(response)
    # What moves to and fro has pressures that do as well: only while all axes stand is it telling.
    moves = (np.diff(response["axis_position"], axis=0) != 0.0).any(axis=1)
    standing = np.split(pressure, 1 + np.flatnonzero(moves))
    if any(alternating(part) for part in standing if len(part) > 2):
        return "failed: alternates"
    return WELL


def main() -> int:
    """March and print."""
    parser = options_of(__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=COUNT)
    asked = parser.parse_args()
    console, ends = Console(stderr=True, markup=False), Counter[str]()
    with temporary_folder() as folder:
        numbers = range(asked.first, asked.first + asked.count)
        for number in track(numbers, "marches", console=console):
            end = outcome(*drawn(number, folder), folder)
            ends[end if end.partition(":")[0] != "failed" else "failed"] += 1
            if end.startswith(("failed", "refused")) or "not refused" in end:
                console.print(f"{number} {end}")
    right = {WELL, "a body comes loose", *(f"{why}: refused" for why in REFUSED)}
    for end, count in ends.most_common():
        print(f"{count:6d}  {end}")
    return int(not right.issuperset(ends))


if __name__ == "__main__":
    raise SystemExit(main())
