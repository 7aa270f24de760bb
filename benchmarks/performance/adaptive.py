"""Adaptive steps against steps of 2 s: how many, how long, how far off, and one march among many.

The truth is the adaptive march with a tenth of the tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
import xarray as xr

from benchmarks.performance.cases import with_two_sensors
from benchmarks.performance.marching import driven as inputs_of
from benchmarks.performance.marching import ensemble
from benchmarks.performance.timing import Row, paired
from benchmarks.study import case_file
from fesim.case.schema import Case, read_case, step_count
from fesim.march.ensemble import march_many
from fesim.setup.machine import Setup, set_up, with_laws
from fesim.simulate import simulate
from thermojoint.paper.long_runs import LongRuns, driven, random_day

#: Error of the displacement that is asked for, um; interval of the responses, s.
TOLERANCE_UM, EVERY = 0.01, 60.0


def rows() -> Iterator[Row]:
    """Yield adaptive-35min, adaptive-day and adaptive-among-many on the reference machine."""
    case = with_two_sensors(read_case(case_file("reference")), 3.0)
    setup = set_up(case)
    yield compared("adaptive-35min", case, setup)
    runs = LongRuns()
    with TemporaryDirectory() as folder:
        day = random_day(runs.day, runs.seed)
        yield compared("adaptive-day", driven(case, day, runs.day, "day", Path(folder)), setup)
    yield among_many(case, setup)


def compared(name: str, case: Case, setup: Setup) -> Row:
    """Return the row of one case: steps of both ways, and the errors of both in the note."""
    seldom = case.replace(march={"step_s": EVERY})
    adaptive = adaptive_case(case)
    exact = seldom.replace(march={"method": "adaptive", "tolerance_um": 0.1 * TOLERANCE_UM})
    coarse = set_up(seldom)
    truth, _ = timed(exact, coarse)
    ours, mine = timed(adaptive, coarse)
    fixed, theirs = timed(case, setup)
    steps, other = int(ours.attrs["march_steps"]), step_count(case.march)
    return Row(
        name,
        float(steps),
        float(other),
        other / steps,
        "steps",
        f"tolerance_um = {TOLERANCE_UM:g}: off by {off(ours, truth):.2g} um, estimated "
        f"{ours.attrs['estimated_error_um']:.2g} um, {mine:.2g} s of processor time for the steps "
        f"and a response every {EVERY:g} s; {other} steps of {case.march.step_s:g} s: off by "
        f"{off(fixed, truth):.2g} um, {theirs:.2g} s; set up before; measured once",
    )


def among_many(case: Case, setup: Setup) -> Row:
    """Return the row of one march for its displacement, of many on one condensation."""
    cases = ensemble(case)
    adaptive = adaptive_case(case)
    coarse = set_up(adaptive)
    changed = [
        one.replace(march=adaptive.march.model_dump(include={"step_s", "method", "tolerance_um"}))
        for one in cases
    ]

    def ours() -> None:
        for one in changed:
            simulate(one, setup=with_laws(coarse, one), accuracy=False)

    def fixed() -> None:
        laws = [with_laws(setup, one).machine.contact.laws for one in cases]
        march_many(setup.machine, laws, np.array([inputs_of(one) for one in cases]))

    mine, theirs, ratio = paired(ours, fixed, 3, process_time)
    return Row(
        "adaptive-among-many",
        1e3 / len(cases) * mine,
        1e3 / len(cases) * theirs,
        ratio,
        "ms",
        f"{len(cases)} marches of 35 min on one condensation, heat, friction and roughness all "
        f"different, tolerance_um = {TOLERANCE_UM:g}, a response every {EVERY:g} s without its "
        "error estimate included, for each; other: steps of 2 s, displacements only; processor "
        "time, one core, median of 3",
    )


def adaptive_case(case: Case) -> Case:
    """Return a case with adaptive steps and seldom a row."""
    changed = {"step_s": EVERY, "method": "adaptive", "tolerance_um": TOLERANCE_UM}
    return case.replace(march=changed)


def timed(case: Case, setup: Setup) -> tuple[xr.Dataset, float]:
    """Return a response and the processor time that it took, s; machine code is made before."""
    short = case.replace(march={"duration_min": 2.0})
    simulate(short, setup=setup)
    begun = process_time()
    response = simulate(case, setup=setup).response
    return response, process_time() - begun


def off(response: xr.Dataset, truth: xr.Dataset) -> float:
    """Largest difference of a displacement at the times of the truth, um."""
    moved = response["displacement"].sel(time=truth["time"], method="nearest", tolerance=1e-6)
    return 1e6 * float(np.abs(moved.to_numpy() - truth["displacement"].to_numpy()).max())
