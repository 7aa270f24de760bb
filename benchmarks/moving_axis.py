"""A joint-aware model of a machine with a moving axis on plants that are not its model: a day.

    python -m benchmarks.moving_axis --out moving-axis.json [--first 0] [--count 3] [--seed 2]

The plants are the shipped machine with a moving knee on a finer mesh, with other parameters from
the second one on, noise of 0.12 K peak to peak on every thermometer. The table moves at random for
two fifths of the time. Calibrated from steps of 0.5, 1 and 2 for 35 min and a cool-down of 4 h;
judged, free-running, at step 3.0 and in a day of 8 h with random heat. Beside it, on the plant with
the parameters of its case, FCHS, calibrated from steps of 0.5, 1 and 2 with the table at each of
three positions, and interpolated. ``--elements-mm 40 32`` sets element sizes of model and plants;
twice the same gives both one mesh. With ``--turning 0.5`` the table turns between samples, too,
at every half of a second; ``--odometer`` tells the model how far it has gone. Tables in
docs/moving-axes.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from benchmarks.study import case_file, options_of, write_json
from calibrate.chain import calibrate_responses
from calibrate.joint_aware.calibration import calibrate_joint_aware
from calibrate.joint_aware.misfit import physics_with
from calibrate.joint_aware.random_heat import random_levels
from calibrate.joint_aware.readings import run_in
from estimator.fchs.estimator import Fchs
from estimator.interface import Estimate, Estimator, follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.lines import channels_at, here, lines_of
from estimator.measured import response_samples
from fesim.axes.setup import aligned_positions
from fesim.case.schema import Case, read_case
from fesim.simulate import simulate
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA, MILLI
from thermojoint.models.assembly import assemble
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.parameters import factors_of
from thermojoint.reduced.physics import simulate_known

#: Element sizes of model (those of its case) and plants, mm; the steps of plants, s.
ELEMENTS, STEP = (50.0, 40.0), 5.0
#: Speed of the table, m/s, and the share of the time that it moves.
SPEED, MOVES = 0.02, 0.4
#: Rectangular noise of a thermometer, K, to both sides.
NOISE = 0.06
#: Minutes of the runs; levels of those with a step.
LEVELS = {"0.5": 0.5, "1": 1.0, "2": 2.0, "3": 3.0}
STEPS, COOLING, DAY = 35.0, 240.0, 480.0
#: Positions at which FCHS is calibrated, mm.
AT = (-100.0, 50.0, 200.0)


def course(
    rng: np.random.Generator, minutes: float, stroke: tuple[float, float], turning: float
) -> str:
    """Return a history of positions: stands for 1 to 15 min, then goes to and fro.

    It turns at multiples of `turning`, s. Where these are no samples, positions do not show what it
    goes between them, there and back.
    """
    step, place, rows = 0, 0.0, ["time_s,position_mm", "0,0"]
    while step * turning < 60.0 * minutes:
        stands = rng.uniform(60.0, 900.0)
        step += math.ceil(stands / turning)
        rows.append(f"{step * turning:g},{place:.1f}")
        until = step + stands / turning * MOVES / (1.0 - MOVES)
        while step < until:
            there = float(rng.uniform(*stroke))
            step += max(1, math.ceil(1e-3 * abs(there - place) / SPEED / turning))
            place = there
            rows.append(f"{step * turning:g},{place:.1f}")
    return "\n".join(rows) + "\n"


def heats(rng: np.random.Generator) -> dict[str, tuple[float, Any]]:
    """Return minutes and heat input of every run."""
    found: dict[str, tuple[float, Any]] = {
        name: (STEPS, {"kind": "step", "level": level}) for name, level in LEVELS.items()
    }
    times = STEP * np.arange(60.0 * DAY / STEP)
    levels = random_levels(rng, 60.0 * DAY, STEP, 2.5, 1)[:, 0]
    cooling = np.where(times < 60.0 * STEPS, 2.0, 0.0)[: round(60.0 * COOLING / STEP)]
    for name, minutes, values in (("cool-down", COOLING, cooling), ("day", DAY, levels)):
        lines = [f"{at:g},{value:.4f}" for at, value in zip(times, values, strict=False)]
        found[name] = minutes, "\n".join(["time_s,heat_input", *lines]) + "\n"
    return found


def plant_of(case: Case, rng: np.random.Generator, number: int) -> Case:
    """Return a plant: from number 1 on with other parameters than its case."""
    plant = case.replace(march={"step_s": STEP})
    if number == 0:
        return plant
    joint, (body,) = case.joints["knee"], case.materials
    material, source = case.materials[body], case.sources["bearings"]
    conductivity = float(material.conductivity_W_mK)
    return plant.replace(
        convection_W_m2K={"exterior": rng.uniform(4.0, 10.0)},
        joints={
            "knee": {
                "preload_MPa": joint.preload_MPa * rng.uniform(0.8, 1.2),
                "roughness_um": joint.roughness_um * rng.uniform(0.7, 1.3),
            }
        },
        materials={body: {"conductivity_W_mK": conductivity * rng.uniform(0.92, 1.08)}},
        sources={
            "bearings": {"reference_power_W": source.reference_power_W * rng.uniform(0.9, 1.1)}
        },
    )


def responses_of(
    plant: Case, rng: np.random.Generator, folder: Path, turning: float
) -> dict[str, xr.Dataset]:
    """Return the noisy responses of a plant to all runs; for `turning` see `course`."""
    (axis,) = plant.axes
    found = {}
    for name, (minutes, heat) in heats(rng).items():
        moves = folder / f"{name}-course.csv"
        moves.write_text(course(rng, minutes, plant.axes[axis].stroke_mm, turning))
        if isinstance(heat, str):
            (folder / f"{name}-heat.csv").write_text(heat)
            heat = {"kind": "sampled", "file": str(folder / f"{name}-heat.csv")}
        given = plant.replace(axes={axis: {"file": str(moves)}}, march={"duration_min": minutes})
        found[name] = read_by(given.replace(heat_input=heat), rng)
    return found


def read_by(plant: Case, rng: np.random.Generator) -> xr.Dataset:
    """The response of a plant with noise on its thermometers; its power is not known."""
    response = simulate(plant, accuracy=False).response.drop_vars("source_power")
    read = response["temperature"]
    return response.assign(temperature=read + rng.uniform(-NOISE, NOISE, read.shape))


def fchs_along(plant: Case, rng: np.random.Generator) -> list[Fchs]:
    """Return FCHS of a plant at every position of `AT`."""
    (axis,) = plant.axes
    found = []
    for place in AT:
        still = plant.replace(
            axes={axis: {"file": None, "position_mm": place}}, march={"duration_min": STEPS}
        )
        runs = {
            level: read_by(still.replace(heat_input={"kind": "step", "level": level}), rng)
            for level in (0.5, 1.0, 2.0)
        }
        model = calibrate_responses(runs.pop(1.0), runs).model
        found.append(Fchs(assemble(model, STEP, 60.0 * DAY)))
    return found


def told(machine: ReducedMachine, factors: dict[str, float], response: xr.Dataset) -> list[float]:
    """Return the largest errors of a machine that is told the heat, along its axes, um."""
    run = run_in(response, machine, "run")
    _, moved = simulate_known(physics_with(machine, factors), run.inputs, run.length, run.gone)
    grid = run.length * np.arange(1.0, len(moved) + 1.0)
    at = np.array([np.interp(run.times, grid, column) for column in moved.T]).T
    return _um(np.abs(at - run.displacement)[1:].max(axis=0))


def fchs_figures(estimators: Sequence[Fchs], response: xr.Dataset) -> dict[str, Any]:
    """Return errors of FCHS interpolated between the positions of its calibration."""
    axes = tuple(a for a in estimators[0].axes if all(a in one.axes for one in estimators))
    actual = columns_of(response, "displacement", axes)
    each = []
    for one in estimators:
        samples = response_samples(response, one.model)
        made = np.array([estimate.displacement for estimate in estimates_of(one, samples)])
        each.append(made[:, [one.axes.index(axis) for axis in axes]])
    place, knots = response["axis_position"].to_numpy().ravel() / MILLI, np.array(AT)
    shares = np.array([np.interp(place, knots, own) for own in np.eye(knots.size)])
    error = np.abs(np.einsum("kn,knc->nc", shares, np.array(each)) - actual)
    return {"max_um": _um(error.max(axis=0)), "rms_um": _um(np.sqrt(np.mean(error**2, axis=0)))}


def figures(estimator: JointAware, response: xr.Dataset) -> dict[str, Any]:
    """Return errors at the present position, of the line there, and of a model that stands."""
    (axis,) = estimator.model.moving_axes
    samples = np.array(list(KIND.response(estimator.model, response)))
    actual = columns_of(response, "displacement", estimator.axes)
    made = estimates_of(estimator, samples.tolist())
    moved, band = here(estimator.axes, estimator.details, made)
    place = response["axis_position"].to_numpy()
    lines = [lines_of(estimator.axes, estimator.details, one.details) for one in made]
    slope = np.array([one.slope for one in lines if one is not None])
    line = np.array([one.displacement for one in made]) + slope * (place - axis.reference)
    asked = asked_by(estimator, made)
    table = np.empty_like(moved)
    for k, at in enumerate(place.ravel()):
        table[k] = [np.interp(at, axis.asked, column) for column in asked[k].T]
    wanted = response["asked_displacement"][:, 0].sel(axis=list(estimator.axes)).to_numpy()
    anywhere = np.abs(asked - wanted)
    still = samples.copy()
    at = len(estimator.model.sensors) + 2
    still[:, at], still[:, at + 1 :] = axis.reference, 0.0
    middle, _ = here(estimator.axes, estimator.details, estimates_of(estimator, still.tolist()))
    return errors_of(moved, band, actual) | {
        "anywhere_max_um": _um(anywhere.max(axis=(0, 1))),
        "anywhere_inside_percent": _percent(anywhere <= band[:, None], (0, 1)),
        "line_max_um": _um(np.abs(line - actual).max(axis=0)),
        "table_max_um": _um(np.abs(table - actual).max(axis=0)),
        "table_off_map_um": _um(np.abs(table - moved).max(axis=0)),
        "one_position_max_um": _um(np.abs(middle - actual).max(axis=0)),
    }


def errors_of(moved: Array, band: Array, actual: Array) -> dict[str, Any]:
    """Return errors of estimates (n, axes) with their half-bands, m, beside what they should be."""
    error = np.abs(moved - actual)
    return {
        "size_um": _um(np.abs(actual).max(axis=0)),
        "max_um": _um(error.max(axis=0)),
        "rms_um": _um(np.sqrt(np.mean(error**2, axis=0))),
        "inside_percent": _percent(error <= band, 0),
        "half_band_um": _um(band.mean(axis=0)),
    }


def asked_by(estimator: JointAware, made: Sequence[Estimate]) -> Array:
    """Return displacements (n, k, axes), m, in estimates at the positions asked about."""
    (axis,) = estimator.model.moving_axes
    at = {channel: k for k, channel in enumerate(estimator.details)}
    own = [[at[one] for one in channels_at(name, axis.asked)] for name in estimator.axes]
    return np.array([one.details[np.array(own)].T for one in made])


def estimates_of(estimator: Estimator, samples: Iterable[Sequence[float]]) -> list[Estimate]:
    """Return what an estimator makes of samples, from a cold start."""
    return [one for _, one in follow(estimator, samples, estimator.initial_state())]


def _percent(holds: NDArray[np.bool_], axis: int | tuple[int, ...]) -> list[float]:
    share: list[float] = (100.0 * np.mean(holds, axis=axis)).round(1).tolist()
    return share


def _um(values: Array) -> list[float]:
    return [round(float(value), 2) for value in MEGA * values]


def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its rows."""
    parser = options_of(__doc__, "moving-axis.json")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=3)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--elements-mm", type=float, nargs=2, default=ELEMENTS)
    parser.add_argument("--turning", type=float, default=STEP)
    parser.add_argument("--odometer", action="store_true")
    options = parser.parse_args(arguments)
    case = read_case(case_file("moving_knee"))
    ((axis, section),) = case.axes.items()
    # The points of a table.
    stations = (aligned_positions(section) / MILLI).round(9).tolist()
    reads = {"asked_mm": stations, "odometer": options.odometer}
    of_model, of_plant = ({"element_size_mm": size} for size in options.elements_mm)
    case = case.replace(march={"step_s": STEP}, axes={axis: reads}, structure=of_model)
    rows: list[dict[str, Any]] = []
    for number in range(options.first, options.first + options.count):
        rng = np.random.default_rng((options.seed, number))
        plant = plant_of(case, rng, number).replace(structure=of_plant)
        with TemporaryDirectory() as folder:
            responses = responses_of(plant, rng, Path(folder), options.turning)
            if not options.odometer:
                responses = {name: one.drop_vars("axis_way") for name, one in responses.items()}
        along = fchs_along(plant, rng) if number == 0 else []
        began = process_time()
        runs = {name: responses[name] for name in ("0.5", "1", "2", "cool-down")}
        found = calibrate_joint_aware(case, runs)
        spent = process_time() - began
        fitted = factors_of(found.fit.parameters, found.fit.coordinates)
        for name in ("3", "day"):
            row = {"plant": number, "run": name} | figures(JointAware(found.model), responses[name])
            row["told_as_in_case_um"] = told(found.machine, {}, responses[name])
            row["told_um"] = told(found.machine, fitted, responses[name])
            row["doubt"], row["calibration_s"] = found.fit.doubt, round(spent, 1)
            rows.append(row | ({"fchs": fchs_figures(along, responses[name])} if along else {}))
            print(json.dumps(rows[-1]), flush=True)
        write_json(options.out, rows)
    for name in ("3", "day"):
        worst = [max(row["max_um"]) for row in rows if row["run"] == name]
        print(f"{name}: 90th percentile of the larger error {np.percentile(worst, 90.0):.2f} um")


if __name__ == "__main__":
    main()
