"""The joint-aware estimator on plants that are not its model, from temperatures alone.

The model stands on a 50/25 mm mesh with the case's own parameters. The plants stand on a 40/20 mm
mesh; one has the parameters of the case, the other has eight of them off. Each plant is calibrated
from its own steps of 0.5, 1 and 2, once more with a cool-down of 4 h added, and judged by what it
has not seen: steps of 1.5 and 3, the triangle with and without noise, a day of random heat and
ambient, a cool-down (where it is not calibrated with it), a start in the middle of the day.

    python benchmarks/joint_aware.py --out joint_aware.json       # about 10 minutes
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from importlib.resources import files
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from artefacts.files import write_text
from estimator.joint_aware.calibration import calibrate_machine, report
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.judging import judge
from estimator.joint_aware.readings import samples_in
from estimator.joint_aware.reduced_machine import ReducedMachine, reduce_machine
from estimator.noise import NOISE_PEAK_TO_PEAK_K, sensor_noise
from fesim.case.schema import Case, case_from_data
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate

#: Element sizes of the bodies and of the joint, mm.
MODEL, PLANT = (50.0, 25.0), (40.0, 20.0)
SENSORS = ("s", "b", "T1", "T2")
#: In mm: on the source, below it, and in the strips; not chosen by any error.
PLACES = {
    "s": (550.0, 650.0, 100.0),
    "b": (550.0, 450.0, 125.0),
    "T1": (625.0, 450.0, 87.5),
    "T2": (625.0, 700.0, 87.5),
}
DAY, COOL_DOWN, HEATED = 480.0, 240.0, 35.0
#: Seed of the day: levels 0 to 2 that last 5 to 40 min, ambient within 3 K.
SEED = 3
#: A warm start, this long after the start of the day, and when it is judged, s.
WARM, SETTLED = 4 * 3600.0, 1200.0


def machine_data(height: float, sizes: tuple[float, float]) -> dict:
    """Return the equal-heights case on a mesh, bracket and source top at a height (mm)."""
    text = files("thermojoint").joinpath("cases/equal_heights.toml").read_text("utf-8")
    data = tomllib.loads(text)
    data["structure"] |= {"element_size_mm": sizes[0], "joint_element_size_mm": sizes[1]}
    data["structure"]["dimensions_mm"] = {
        "bracket_bottom": height,
        "bracket_top": height + 50.0,
        "source_top": height,
    }
    data["candidates"] = []
    data["probes"] = {
        name: {"position_mm": list(place), "body": "column"} for name, place in PLACES.items()
    }
    return data


def with_eight_off(data: dict) -> dict:
    """Return the machine with eight parameters that the model does not know."""
    data["joints"]["knee"] |= {
        "friction_coefficient": 0.45,
        "preload_MPa": 4.0,
        "roughness_um": 1.5,
        "tangential_stiffness_ratio": 0.7,
    }
    for material in data["materials"].values():
        material |= {"conductivity_W_mK": 50.0, "heat_capacity_J_kgK": 480.0}
    data["materials"]["cast_iron"]["youngs_modulus_GPa"] = 110.0
    data["convection_W_m2K"] = {"exterior": 8.0}
    return data


def random_day(folder: Path) -> dict:
    """Write a day's heat and ambient; return what a case says of them."""
    rng = np.random.default_rng(SEED)
    end, now, times, levels = 60.0 * DAY, 0.0, [], []
    while now < end:
        level, lasts = rng.uniform(0.0, 2.0), 60.0 * rng.uniform(5.0, 40.0)
        times += [now + 1e-3 if now else 0.0, now + lasts]
        levels += [level, level]
        now += lasts
    every = np.arange(0.0, end + 1.0, 600.0)
    drift = np.cumsum(rng.normal(size=every.size))
    drift = 3.0 * (drift - drift[0]) / np.abs(drift - drift[0]).max()
    heat, ambient = folder / "heat.csv", folder / "ambient.csv"
    heat.write_text(_csv("heat_input", times, levels))
    ambient.write_text(_csv("ambient_degC", every, 20.0 + drift))
    return {
        "heat_input": {"kind": "sampled", "file": str(heat)},
        "ambient": {"file": str(ambient)},
    }


def runs(folder: Path) -> dict[str, tuple[dict, float]]:
    """Return what drives every run, and its length, min."""
    cooled = folder / "cooled.csv"
    off = 60.0 * HEATED
    cooled.write_text(_csv("heat_input", [0.0, off, off + 1e-3], [2.0, 2.0, 0.0]))
    steps = {
        f"step-{level}": ({"heat_input": {"kind": "step", "level": level}}, HEATED)
        for level in (0.5, 1.0, 2.0, 1.5, 3.0)
    }
    triangle = {"kind": "triangle", "peak": 2.0, "duration_min": 10.0}
    return steps | {
        "triangle": ({"heat_input": triangle}, HEATED),
        "cool-down": ({"heat_input": {"kind": "sampled", "file": str(cooled)}}, COOL_DOWN),
        "day": (random_day(folder), DAY),
    }


def responses_of(data: dict, folder: Path) -> dict[str, xr.Dataset]:
    """Simulate a plant in every run."""
    setup: Setup | None = None
    found = {}
    for name, (drive, minutes) in runs(folder).items():
        case = _case(deepcopy(data) | drive, minutes)
        setup = setup or set_up(case)
        found[name] = simulate(case, setup=setup).response
    return found


def judged(
    estimator: JointAware, responses: Mapping[str, xr.Dataset], cases: list[str]
) -> list[dict[str, str | float]]:
    """Judge an estimator in some runs, in the noisy triangle and from a warm start."""
    rows = []
    for name in cases:
        rows += judge(name, responses[name], estimator)[0]
    triangle = responses["triangle"]
    noise = sensor_noise(
        triangle["time"].to_numpy(), NOISE_PEAK_TO_PEAK_K, SEED, len(estimator.model.sensors)
    )
    rows += judge("triangle-noise", triangle, estimator, noise)[0]
    day = responses["day"]
    late = day.isel(time=day["time"].to_numpy() >= WARM)
    _, estimates = judge("warm-start", late, estimator, state=estimator.warm_state())
    settled = late["time"].to_numpy() >= WARM + SETTLED
    actual = late["displacement"].sel(axis=list(estimator.axes)).to_numpy()[settled]
    claimed = np.array([one.displacement for one in estimates])[settled]
    bands = np.array([one.band for one in estimates])[settled]
    for k, axis in enumerate(estimator.axes):
        error = np.abs(claimed - actual)[:, k]
        rows.append(
            {
                "case": "warm-start",
                "estimator": estimator.kind,
                "axis": axis,
                "max_abs_error_um": 1e6 * float(error.max()),
                "rms_error_um": 1e6 * float(np.sqrt(np.mean(error**2))),
                "peak_total_um": 1e6 * float(np.abs(actual[:, k]).max()),
                "band_cover": float(np.mean(error <= bands[:, k])),
                "mean_band_um": 1e6 * float(bands[:, k].mean()),
            }
        )
    return rows


def cost(estimator: JointAware, response: xr.Dataset) -> dict[str, float]:
    """Return what a sample takes, ms."""
    state, taken = estimator.initial_state(), []
    worked = time.process_time()
    for moment, *values in samples_in(response, estimator.model.sensors):
        begun = time.perf_counter()
        state, _ = estimator.sample(state, moment, values)
        taken.append(1e3 * (time.perf_counter() - begun))
    # On a machine that has other work to do, the processor's own time is what can be compared.
    worked = 1e3 * (time.process_time() - worked) / len(taken)
    return {
        "mean_processor_ms": worked,
        "mean_ms": float(np.mean(taken)),
        "median_ms": float(np.median(taken)),
        "p99.9_ms": float(np.quantile(taken, 0.999)),
        "modes": int(estimator.model.modes.rates.size),
        "contacts": int(estimator.model.held.size),
    }


def study(height: float, wanted: list[str]) -> dict:
    """Return all figures."""
    case = _case(machine_data(height, MODEL) | {"heat_input": {"kind": "step", "level": 1.0}}, 35.0)
    machine = reduce_machine(case, set_up(case), SENSORS)
    plants = {
        "other mesh": machine_data(height, PLANT),
        "other mesh, eight off": with_eight_off(machine_data(height, PLANT)),
    }
    found: dict = {"height_mm": height, "seed": SEED, "rows": [], "fits": []}
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1):
        for plant in wanted or plants:
            responses = responses_of(plants[plant], Path(folder))
            for label, more, fitted in (
                ("reference step, nothing fitted", ["step-1.0"], []),
                ("steps", ["step-0.5", "step-1.0", "step-2.0"], None),
                ("steps and cool-down", ["step-0.5", "step-1.0", "step-2.0", "cool-down"], None),
            ):
                rows, fit = _one(machine, responses, more, fitted)
                found["rows"] += [{"plant": plant, "calibration": label} | row for row in rows]
                found["fits"].append({"plant": plant, "calibration": label} | fit)
                show(found["rows"], plant, label)
    return found


def _one(
    machine: ReducedMachine,
    responses: Mapping[str, xr.Dataset],
    calibration: list[str],
    fitted: list[str] | None,
) -> tuple[list[dict[str, str | float]], dict]:
    begun = time.perf_counter()
    calibrated = calibrate_machine(
        machine, {name: responses[name] for name in calibration}, fitted=fitted
    )
    taken = time.perf_counter() - begun
    estimator = JointAware(calibrated.model)
    cases = ["step-1.5", "step-3.0", "triangle", "day", "cool-down"]
    rows = judged(estimator, responses, [name for name in cases if name not in calibration])
    sample = cost(estimator, responses["step-1.5"])
    return rows, {"calibration_s": taken, "sample": sample} | report(calibrated.fit)


def show(rows: list[dict], plant: str, label: str) -> None:
    """Print the rows of one plant and one calibration."""
    table = Table(title=f"{plant}; calibrated with: {label}")
    for name in ("case", "axis", "max error, µm", "rms", "peak", "band", "inside"):
        table.add_column(name)
    for row in rows:
        if (row["plant"], row["calibration"]) == (plant, label):
            figures = [row[f"{name}_um"] for name in ("max_abs_error", "rms_error")]
            figures += [row["peak_total_um"], row["mean_band_um"]]
            inside = f"{100 * row['band_cover']:.0f} %"
            table.add_row(row["case"], row["axis"], *(f"{one:.3g}" for one in figures), inside)
    Console(width=100).print(table)


def _case(data: dict, minutes: float) -> Case:
    data = deepcopy(data)
    data["march"]["duration_min"] = minutes
    return case_from_data(data, "benchmark", Path())


def _csv(name: str, times: list[float] | np.ndarray, values: list[float] | np.ndarray) -> str:
    rows = (
        f"{time!r},{value!r}"
        for time, value in zip(map(float, times), map(float, values), strict=True)
    )
    return "\n".join([f"time_s,{name}", *rows]) + "\n"


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("joint_aware.json"))
    parser.add_argument("--plant", action="append", default=[], help="default: both")
    parser.add_argument("--height-mm", type=float, default=690.0, help="bracket and source top")
    options = parser.parse_args()
    found = study(options.height_mm, options.plant)
    write_text(options.out, json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
