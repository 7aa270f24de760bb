"""A day of samples in an exported estimator and in Python: how far apart, how long a sample takes.

On what `thermojoint reproduce` leaves in its folder. The sensors read what the machine's own model
says of a heat input of 2 that is on for 72 of every 120 min, with 0.03 K of noise (joint-aware), or
rise to the highest calibrated temperatures and fall as often (FCHS); or they are those of the
measured machine (learned). Needs gcc, and is run from the root of a clone.

    python -m benchmarks.exported_day results              # about a minute
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from benchmarks.study import options_of
from calibrate.learning.learn import learn
from estimator.columns import samples_of
from estimator.export.c_source import c_files
from estimator.export.program import Precision, Program
from estimator.exporting import export_program
from estimator.fchs.estimator import Fchs
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer
from estimator.kind import OpenedEstimator
from estimator.learned.estimator import Learned
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log_file import read_log
from thermojoint.models.assembly import assemble
from thermojoint.models.model_file import read_model
from thermojoint.reduced.discrepancy import relaxed
from thermojoint.reduced.physics import simulate_known

DAY, INTERVAL, PERIOD, ON, FOLLOWS = 86400.0, 2.0, 7200.0, 4320.0, 1800.0
HEAT, NOISE = 2.0, 0.03
MACHINE = Path("examples/measured_machine")


def fchs_samples(estimator: Fchs) -> Array:
    """Return time, s, and readings, K, of a day."""
    times = INTERVAL * np.arange(1, round(DAY / INTERVAL) + 1)
    kept = np.exp(-INTERVAL / FOLLOWS)
    level = lfilter([1.0 - kept], [1.0, -kept], (times % PERIOD < ON).astype(float))
    known = estimator.assembly.model.span.temperatures
    highest = [known[channel.name][1] for channel in estimator.channels]
    return np.column_stack([times, *(high * level for high in highest)])


def joint_aware_samples(estimator: JointAware) -> Array:
    """Return time, s, and readings, K, of a day."""
    model = estimator.model
    times = model.step * np.arange(1, round(DAY / model.step) + 1)
    heat = np.repeat(HEAT * (times % PERIOD < ON)[:, None], model.power.size, axis=1)
    ambient = 2.0 * np.sin(2.0 * np.pi * times / DAY)
    inputs = np.column_stack([heat * model.power, ambient])
    read, _ = simulate_known(estimator.observer.physics, inputs, model.step)
    read += relaxed(heat, model.discrepancy.rates, model.step) @ model.discrepancy.temperature.T
    rows = np.column_stack([read + model.offset, ambient])
    return np.column_stack(
        [times, rows + NOISE * np.random.default_rng(0).standard_normal(rows.shape)]
    )


def in_c(
    found: Program,
    folder: Path,
    number: type[ctypes.c_double] | type[ctypes.c_float],
    samples: Array,
    axes: int,
    timed: bool,
) -> tuple[Array, float]:
    """Return the displacements (n, axes), m, and the processor time of a sample, s."""
    for name, text in c_files(found).items():
        (folder / name).write_text(text, encoding="utf-8")
    command = ["gcc", "-std=c99", "-O3", "-shared", "-fPIC", "day.c", "-lm", "-o", "day.so"]
    subprocess.run(command, cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "day.so"))
    # The displacement stands first; no estimate is longer than this.
    state, estimate = ctypes.create_string_buffer(found.state), (number * 256)()
    library.day_init(state)
    readings, rows = number * (samples.shape[1] - 1), samples[:, 1:].tolist()
    intervals = np.diff(samples[:, 0], prepend=0.0).tolist()
    displacement, begun = np.empty((len(samples), axes)), time.process_time()
    for k, (row, interval) in enumerate(zip(rows, intervals, strict=True)):
        passed = (number(interval),) if timed else ()
        library.day_step(state, *passed, readings(*row), estimate)
        displacement[k] = estimate[:axes]
    return displacement, (time.process_time() - begun) / len(rows)


def learned() -> tuple[Learned, Array]:
    """Return a model of the measured machine, and time, s, and readings of all that is known."""
    logs = [read_log([MACHINE / f"{name}.csv"]) for name in ("learned", "unseen")]
    model = replace(learn(logs[:1], ["disp1_um", "disp2_um"], 4), log_end=None)
    samples = [row for log in logs for row in samples_of(model.columns, [log])]
    return Learned(model), np.array(samples)


def compared(
    name: str, estimator: OpenedEstimator, samples: Array, timed: bool, interval: float = INTERVAL
) -> None:
    """Print a line for each precision."""
    begun = time.process_time()
    results = follow(estimator, samples.tolist(), estimator.initial_state())
    python = np.array([found.displacement for _, found in results])
    spent = (time.process_time() - begun) / len(samples)
    largest = np.abs(python).max()
    print(f"{name}: {len(samples)} samples, {1e6 * largest:.0f} um; Python {1e6 * spent:.1f} us")
    for precision, number in (
        (Precision.DOUBLE, ctypes.c_double),
        (Precision.SINGLE, ctypes.c_float),
    ):
        found = export_program(estimator, precision, "day", interval=interval)
        with tempfile.TemporaryDirectory() as folder:
            here, spent = in_c(found, Path(folder), number, samples, len(estimator.axes), timed)
        worst = np.abs(here - python).max()
        print(
            f"  {precision}: off by {worst:.2e} m, {worst / largest:.1e} of the largest; "
            f"{1e6 * spent:.1f} us with the call"
        )


def main() -> None:
    """Compare every kind."""
    parser = options_of(__doc__)
    parser.add_argument("results", type=Path)
    given = parser.parse_args()
    fchs = Fchs(assemble(read_model(given.results / "model.json"), INTERVAL, 7200.0))
    samples = fchs_samples(fchs)
    compared("fchs", fchs, samples, timed=True)
    compared("learned", *learned(), timed=True, interval=60.0)
    observer = JointAware(read_observer(given.results / "joint_aware.h5"))
    compared("joint-aware", observer, joint_aware_samples(observer), timed=False)


if __name__ == "__main__":
    main()
