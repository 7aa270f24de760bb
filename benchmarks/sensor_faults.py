"""One sensor of the joint-aware estimator lies: when it is named, and what it costs.

On what `thermojoint reproduce` leaves in its folder: the estimator, which has another mesh than the
plant, and the plant's responses. In every run each sensor in turn is stuck, off by 5 K, broken
(-200 degC), in another unit, spiking or away, from some moment on.

    python -m benchmarks.sensor_faults results --out sensor_faults.json      # about 5 minutes
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from benchmarks.study import options_of, write_json
from estimator.interface import Estimate, follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer
from estimator.joint_aware.readings import samples_in
from estimator.noise import NOISE_PEAK_TO_PEAK_K, sensor_noise
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import columns_of, read_response
from thermojoint.artefacts.units import MEGA

#: Case to when the fault begins, s.
CASES = {"step-1.5": (0.0, 600.0), "step-3.0": (60.0, 600.0), "day": (9000.0, 20000.0)}
#: Some faults end after this, s.
AWAY = 600.0
#: The ambient at which the machine was cold, degC.
COLD = 20.0
FAULTS: dict[str, Callable[[Array], Array]] = {
    "stuck": lambda values: np.full_like(values, values[0]),
    "5 K more": lambda values: values + 5.0,
    "5 K less": lambda values: values - 5.0,
    "-200 degC": lambda values: np.full_like(values, -200.0 - COLD),
    "kelvin": lambda values: values + 273.15,
    "fahrenheit": lambda values: 1.8 * values + 32.0 + 0.8 * COLD,
    "a spike in 30 s": lambda values: values + 30.0 * (np.arange(values.size) % 15 == 0),
    "away for 10 min": lambda values: np.where(np.arange(values.size) * 2.0 < AWAY, np.nan, values),
}
SEED = 4


def run(estimator: JointAware, samples: Array) -> list[Estimate]:
    """Return every estimate of some samples (k, 1 + channels)."""
    start = estimator.initial_state()
    return [found for _, found in follow(estimator, samples.tolist(), start)]


def rows_of(name: str, response: xr.Dataset, estimator: JointAware) -> list[dict]:
    """Return a row for every fault of every sensor in a run."""
    sensors = estimator.model.sensors
    samples = np.array(list(samples_in(response, sensors)))
    noise = sensor_noise(samples[:, 0], NOISE_PEAK_TO_PEAK_K, SEED, len(sensors))
    samples[:, 1:-1] += noise
    actual = columns_of(response, "displacement", estimator.axes)
    healthy = np.abs([one.displacement for one in run(estimator, samples)] - actual)
    found = []
    for onset in CASES[name]:
        for k, sensor in enumerate(track(sensors, f"{name} from {onset:g} s on")):
            for fault, change in FAULTS.items():
                part = samples[:, 0] >= onset
                changed = samples.copy()
                changed[part, 1 + k] = change(samples[part, 1 + k])
                estimates = run(estimator, changed)
                error = np.abs([one.displacement for one in estimates] - actual)
                band = np.array([one.band for one in estimates])
                named = [
                    one.time - onset
                    for one in estimates
                    if one.time >= onset and sensor in (*one.distrusted, *one.missing)
                ]
                others = {
                    other
                    for one in estimates
                    for other in (*one.distrusted, *one.missing)
                    if other != sensor
                }
                excess = error - np.maximum(healthy + 1e-6, band)
                found.append(
                    {
                        "case": name,
                        "onset_s": onset,
                        "sensor": sensor,
                        "fault": fault,
                        "named_after_s": min(named) if named else None,
                        "others_named": sorted(others),
                        "more_um": (MEGA * (error - healthy).max(axis=0)).tolist(),
                        "max_abs_error_um": (MEGA * error.max(axis=0)).tolist(),
                        "largest_band_um": (MEGA * band.max(axis=0)).tolist(),
                        "holds": bool(named and min(named) <= 60.0 and excess.max() <= 0.0),
                    }
                )
    return found


def show(rows: list[dict]) -> None:
    """Print the worst of every fault and sensor."""
    table = Table(title="One sensor lies: the worst of all runs and moments")
    for name in (
        "fault",
        "sensor",
        "named after, s",
        "more error x/y, µm",
        "band x/y, µm",
        "holds",
    ):
        table.add_column(name)
    for fault in FAULTS:
        for sensor in dict.fromkeys(row["sensor"] for row in rows):
            every = [row for row in rows if (row["fault"], row["sensor"]) == (fault, sensor)]
            after = [row["named_after_s"] for row in every]
            more = np.max([row["more_um"] for row in every], axis=0)
            band = np.max([row["largest_band_um"] for row in every], axis=0)
            table.add_row(
                fault,
                sensor,
                "never" if None in after else f"{max(after):g}",
                "/".join(f"{one:.2f}" for one in more),
                "/".join(f"{one:.1f}" for one in band),
                f"{sum(row['holds'] for row in every)} of {len(every)}",
            )
    Console(width=100).print(table)


def main() -> None:
    """Run every fault."""
    parser = options_of(__doc__, "sensor_faults.json")
    parser.add_argument("results", type=Path, help="folder of thermojoint reproduce")
    parser.add_argument("--case", action="append", choices=list(CASES), default=[])
    options = parser.parse_args()
    estimator = JointAware(read_observer(options.results / "joint_aware.h5"))
    rows = []
    with threadpool_limits(limits=1):
        for name in options.case or CASES:
            response = read_response(options.results / "responses" / f"{name}.nc")
            rows += rows_of(name, response, estimator)
    show(rows)
    write_json(options.out, {"seed": SEED, "rows": rows})


if __name__ == "__main__":
    main()
