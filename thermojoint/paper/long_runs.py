"""Validation cases beyond the paper: a working day, a cool-down, a warm start.

A day has levels of heat that last for minutes and an ambient that drifts; both are drawn from a
seed. The cases are used for validation only, never for calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibrate.chain import MOST_SAMPLES
from calibrate.joint_aware.calibration import USUAL, Effort
from calibrate.placement.fchs import RULE, Rule
from estimator.fchs.judging import Validated
from estimator.rows import Row
from fesim.case.schema import Case, step_count
from fesim.case.thermal_sections import AmbientSection, SampledInput
from fesim.setup.machine import Setup
from fesim.simulate import simulate
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.response import probes_of
from thermojoint.console import Report
from thermojoint.paper.inputs import CALIBRATION, COOL_DOWN, DAY, simulate_inputs

if TYPE_CHECKING:
    import xarray as xr

#: Ranges of the heat levels of a day, relative to the reference, and of their durations, s.
LEVELS, LASTS = (0.0, 2.0), (300.0, 2400.0)
#: Initial ambient, degC, and its largest change, K.
COLD, DRIFT = 20.0, 3.0
#: Interval between two values of the ambient, s.
AMBIENT_EVERY = 600.0
#: Duration of a change of level, s.
EDGE = 1e-3
#: Heat of the cool-down before it is switched off.
COOLED_FROM = 2.0
#: Tolerated error of the displacement due to the time steps, um.
TOLERANCE_UM = 0.01


@dataclass(frozen=True)
class LongRuns:
    """Durations of the cases, min, and computing effort."""

    #: Length of the day.
    day: float = 480.0
    #: Time from its start to the warm start.
    warm: float = 240.0
    #: Time from the warm start until errors count.
    settled: float = 20.0
    #: Length of the cool-down, and of the heating at its beginning.
    cool_down: float = 240.0
    heated: float = 35.0
    #: Seed of the day's heat and ambient.
    seed: int = 10
    #: Length of the steps of the calibration until the machine is steady.
    steady: float = 480.0
    #: Effort of the calibration of the observers.
    effort: Effort = USUAL
    #: Rule of the placement for FCHS.
    rule: Rule = RULE
    #: Number of processes for calibrations and the validation.
    processes: int = 2


def random_day(minutes: float, seed: int) -> dict[str, tuple[Array, Array]]:
    """Return times (s) and values of a day's ``heat_input`` and ``ambient_degC``."""
    rng = np.random.default_rng(seed)
    end, now = 60.0 * minutes, 0.0
    times: list[float] = []
    levels: list[float] = []
    while now < end:
        level, lasts = rng.uniform(*LEVELS), rng.uniform(*LASTS)
        times += [now + EDGE if now else 0.0, now + lasts]
        levels += [level, level]
        now += lasts
    every = np.arange(0.0, end + 1.0, AMBIENT_EVERY)
    drift = np.cumsum(rng.normal(size=every.size))
    drift = DRIFT * (drift - drift[0]) / max(float(np.abs(drift - drift[0]).max()), 1e-9)
    return {
        "heat_input": (np.array(times), np.array(levels)),
        "ambient_degC": (every, COLD + drift),
    }


def cool_down(heated: float) -> dict[str, tuple[Array, Array]]:
    """Return times (s) and values of the ``heat_input`` that is switched off after `heated` min."""
    off = 60.0 * heated
    heat = np.array([COOLED_FROM, COOLED_FROM, 0.0])
    return {"heat_input": (np.array([0.0, off, off + EDGE]), heat)}


def driven(
    case: Case,
    histories: Mapping[str, tuple[Array, Array]],
    minutes: float,
    name: str,
    folder: Path,
) -> Case:
    """Write histories to ``folder/NAME-COLUMN.csv`` and return the case that uses them.

    `histories` maps ``heat_input``, and ``ambient_degC`` if it changes, to times (s) and values;
    the length of the run is in min. Steps are adaptive where the case permits; the response keeps
    its times.
    """
    files = {column: folder / f"{name}-{column}.csv" for column in histories}
    for column, (times, values) in histories.items():
        rows = (f"{float(t)!r},{float(v)!r}" for t, v in zip(times, values, strict=True))
        write_text(files[column], "\n".join([f"time_s,{column}", *rows]) + "\n")
    ambient = files.get("ambient_degC")
    long = case.model_copy(
        update={
            "title": f"{case.title}, {name}",
            "heat_input": SampledInput(kind="sampled", file=files["heat_input"]),
            "ambient": None if ambient is None else AmbientSection(file=ambient),
            "march": case.march.model_copy(update={"duration_min": minutes}),
        }
    )
    return adaptively(long)


def adaptively(case: Case, every: int = 1) -> Case:
    """Return a case with adaptive steps, where it permits them.

    Its response has a row at the end of `every` steps of the case.
    """
    march = {"method": "adaptive", "coupling": "staggered", "tolerance_um": TOLERANCE_UM}
    with suppress(InputError):
        return case.replace(march=march | {"step_s": every * case.march.step_s})
    return case


def simulate_long(
    case: Case, runs: LongRuns, folder: Path, setup: Setup, progress: Report
) -> dict[str, xr.Dataset]:
    """Return the responses ``day`` and ``cool-down`` of a set-up machine.

    Their histories are written to `folder`.
    """
    cases = {
        DAY: driven(case, random_day(runs.day, runs.seed), runs.day, DAY, folder),
        COOL_DOWN: driven(case, cool_down(runs.heated), runs.cool_down, COOL_DOWN, folder),
    }
    return {
        name: simulate(long, setup=setup, progress=partial(progress, name)).response
        for name, long in cases.items()
    }


def simulate_steady(
    case: Case, runs: LongRuns, setup: Setup, progress: Report
) -> dict[str, xr.Dataset]:
    """Return the responses to the calibration's steps until the machine is steady, by name."""
    lasting = case.replace(march={"duration_min": runs.steady})
    # Number of rows that a calibration uses.
    every = max(1, -(-step_count(lasting.march) // MOST_SAMPLES))
    lasting = adaptively(lasting, every)
    steps = {f"{name}-steady": heat for name, heat in CALIBRATION.items()}
    own = setup.at_step(lasting.march.step_s)
    made = simulate_inputs(lasting, steps, setup=own, progress=progress)
    return {name.removesuffix("-steady"): response for name, response in made.items()}


def at_sensors(response: xr.Dataset, roles: Mapping[str, str]) -> xr.Dataset:
    """Return a response with only the sensors as probes, named by their roles.

    A run of hours with all candidates would need a hundred times the space.
    """
    kept = [probes_of(response).index(name) for name in roles.values()]
    return response.isel(probe=kept).assign_coords(probe=list(roles))


def without_nonlinear(validated: Validated) -> Validated:
    """Return a validation without the peaks of the nonlinear part.

    They are unknown for the long runs: no reference response is as long or has a changing ambient,
    and δ_L calibrated on minutes is not valid for hours.
    """
    rows: list[Row] = [{**row, "peak_nonlinear_um": None} for row in validated.rows]
    return replace(validated, rows=rows)


def warm_part(day: xr.Dataset, runs: LongRuns) -> xr.Dataset:
    """Return the part of the day after the warm start."""
    return day.isel(time=day["time"].to_numpy() >= 60.0 * runs.warm)
