"""Estimators calibrated on 35 minutes, run for 8 hours and for a week at steps of the heat input.

python -m benchmarks.long_runs --out long_runs.json
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from benchmarks.study import case_file, options_of, write_json
from calibrate import chain
from calibrate.baselines import baselines_of
from calibrate.placement.fchs import with_roles
from estimator.baselines.kind import regressions
from estimator.fchs.estimator import Fchs
from estimator.interface import Estimator, follow
from fesim.case.schema import Case, read_case
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.response import columns_of
from thermojoint.models.assembly import assemble
from thermojoint.models.sensors import readings, rises
from thermojoint.paper import inputs

#: Hours to report.
HOURS = (35.0 / 60.0, 1.0, 2.0, 4.0, 8.0, 24.0, 168.0)
#: Intervals of the march: while calibrating, and over hours.
FINE, COARSE = 2.0, 30.0
#: Assembled for runs as the command line does.
RUN_LENGTH = 7200.0


def samples(estimator: Estimator, response: xr.Dataset) -> list[list[float]]:
    """Return time and the estimator's channels of a response whose probes have their roles."""
    seen, hot = readings(response), rises(response)
    table = {"delta_T": seen.delta_T}
    table |= dict(zip(("a", "b"), hot.T[:2], strict=True))
    table |= dict(zip(("T1", "T2"), seen.temperatures.T, strict=True))
    columns = [table[channel.name] for channel in estimator.channels]
    return np.column_stack((seen.times, *columns)).tolist()


def rows(level: float, response: xr.Dataset, estimators: list[Estimator]) -> Iterator[dict]:
    """Yield what every estimator says at `HOURS`, and its largest displacement."""
    times = response["time"].to_numpy()
    for one in estimators:
        actual = 1e6 * columns_of(response, "displacement", one.axes)
        found = [e for _, e in follow(one, samples(one, response), one.initial_state())]
        told = 1e6 * np.array([each.displacement for each in found])
        for hours in HOURS:
            at = int(np.argmin(np.abs(times - 3600.0 * hours)))
            yield {
                "heat_input": level,
                "hours": hours,
                "estimator": one.kind,
                "displacement_um": told[at].tolist(),
                "actual_um": actual[at].tolist(),
                "max_abs_so_far_um": np.abs(told[: at + 1]).max(axis=0).tolist(),
                "max_error_so_far_um": np.abs(told - actual)[: at + 1].max(axis=0).tolist(),
                "status": found[at].status.words,
            }


def stepped(case: Case, step_s: float, minutes: float) -> Case:
    """Return the case with another march."""
    march = case.march.model_copy(update={"step_s": step_s, "duration_min": minutes})
    return case.model_copy(update={"march": march})


def main() -> None:
    """Calibrate the reference machine, run it for a week, print and write the rows."""
    parser = options_of(__doc__, "long_runs.json")
    parser.add_argument("--levels", type=float, nargs="+", default=[1.0, 2.0])
    given = parser.parse_args()
    case = read_case(case_file("reference"))
    calibration = inputs.simulate_inputs(stepped(case, FINE, 35.0), inputs.CALIBRATION)
    base = calibration["step-1.0"]
    others = {level: calibration[f"step-{level}"] for level in (0.5, 2.0)}
    calibrated = chain.calibrate_responses(base, others)
    assembly = assemble(calibrated.model, FINE, RUN_LENGTH)
    estimators: list[Estimator] = [
        *regressions(baselines_of(calibrated, [base, *others.values()]), FINE),
        Fchs(assembly),
    ]
    roles = calibrated.placement.roles if calibrated.placement else {}
    largest = max(float(np.abs(one["displacement"]).max()) for one in others.values())
    print(f"largest displacement calibrated: {1e6 * largest:.1f} µm")
    slow = stepped(case, COARSE, 60.0 * HOURS[-1])
    setup = set_up(slow)
    found: list[dict] = []
    for level in given.levels:
        heat = StepInput(kind="step", level=level)
        response = simulate(slow.model_copy(update={"heat_input": heat}), setup=setup).response
        found += rows(level, with_roles(response, roles), estimators)
    for row in found:
        told, actual = (
            " / ".join(f"{value:.1f}" for value in row[key])
            for key in ("displacement_um", "actual_um")
        )
        print(
            f"{row['heat_input']:g} {row['hours']:6.2f} h {row['estimator']:7s} {told:18s} "
            f"actual {actual:18s} {row['status']}"
        )
    write_json(given.out, {"rows": found})


if __name__ == "__main__":
    main()
