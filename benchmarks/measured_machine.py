"""How well a model learned from one part of a measured log holds on the rest, free-running.

    python -m benchmarks.measured_machine LOG.csv [--year]

Splits: the first 40, 50, 60 and 70 % learn and the rest judges, then the same reversed. Against
each model with four sensors stand the baselines with all. Then the ladder: number of sensors,
with and without speed, with a displacement read every 4, 2 and 1 h. Tables in
docs/measured-machines.md.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.learning.learn import KINDS, learn
from estimator.learned.estimator import Learned
from estimator.learned.judging import run
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.log_file import read_log
from thermojoint.models.learned import LearnedModel

SHARES = (0.4, 0.5, 0.6, 0.7)
SENSORS = (1, 2, 4, 8, 16)
#: Between readings of the displacement, h.
READ = (4.0, 2.0, 1.0)
#: Every so many samples of the log are judged (a minute at 15 s).
STRIDE = 4


def splits(log: Log) -> dict[str, tuple[Log, Log]]:
    """Return name to (log to learn from, log to judge by)."""
    rows = len(log.times)
    found = {}
    for share in SHARES:
        cut = int(share * rows)
        found[f"first {100 * share:.0f} %"] = log.part(slice(0, cut)), log.part(slice(cut, rows))
    for share in SHARES:
        cut = rows - int(share * rows)
        found[f"last {100 * share:.0f} %"] = log.part(slice(cut, rows)), log.part(slice(0, cut))
    return found


def errors(model: LearnedModel, log: Log, every: float | None = None) -> tuple[Array, Array]:
    """Return rms error of each displacement, um, and the share within the band."""
    part = replace(log, times=log.times[::STRIDE], values=log.values[::STRIDE], starts=(0,))
    estimator = Learned(model)
    estimate, band, _ = run(estimator, part, every)
    error = estimate - np.stack([part.at(name) for name in estimator.axes], axis=1)
    return 1e6 * np.sqrt((error**2).mean(axis=0)), (np.abs(error) <= band).mean(axis=0)


def uncompensated(log: Log, axes: tuple[str, ...]) -> Array:
    """Return rms of each displacement, um."""
    return 1e6 * np.sqrt(np.mean([log.at(name) ** 2 for name in axes], axis=1))


def row(*cells: object) -> None:
    """Print one row of a table."""
    print("|", " | ".join(str(cell) for cell in cells), "|", flush=True)


def numbers(values: Array) -> str:
    """Return values of all displacements in one cell."""
    return " / ".join(f"{value:.1f}" for value in values)


def rolling(log: Log, axes: tuple[str, ...]) -> None:
    """Print the splits: learned with four sensors, the baselines with all."""
    row("learned from", "sensors", "uncompensated", *KINDS, "worst ratio to best", "in the band")
    row(*["---"] * (5 + len(KINDS)))
    every = []
    for name, (own, rest) in splits(log).items():
        models = {kind: learn([own], axes, 4, kind) for kind in KINDS}
        found = {kind: errors(model, rest) for kind, model in models.items()}
        rms = np.array([found[kind][0] for kind in KINDS])
        ratio = rms[0] / rms[1:].min(axis=0)
        every.append(rms)
        sensors = " ".join(one.removesuffix("_degC") for one in models["learned"].sensors)
        row(
            name,
            sensors,
            numbers(uncompensated(rest, axes)),
            *(numbers(one) for one in rms),
            f"{ratio.max():.2f}",
            numbers(100.0 * found["learned"][1]),
        )
    mean = np.exp(np.log(np.array(every)).mean(axis=0))
    row("geometric mean", "", "", *(numbers(one) for one in mean), "", "")


def ladder(log: Log, axes: tuple[str, ...], share: float) -> None:
    """Print what sensors, speed and readings are worth at one split."""
    own, rest = splits(log)[f"first {100 * share:.0f} %"]
    row("sensors", "speed", "never read", *(f"read every {hours:g} h" for hours in READ))
    row(*["---"] * (3 + len(READ)))
    whole = uncompensated(rest, axes)
    for speed in (True, False):
        for count in SENSORS:
            model = learn([own], axes, count, ignored=() if speed else log.of("speed"))
            cells = [numbers(errors(model, rest)[0])]
            for hours in READ:
                rms = errors(model, rest, 3600.0 * hours)[0]
                cells.append(f"{numbers(rms)} ({100.0 * (1.0 - rms / whole).min():.0f} %)")
            row(count, "yes" if speed else "no", *cells)


def year(log: Log, axes: tuple[str, ...]) -> None:
    """Print what learning costs from copies of a log, one a day."""
    begun = time.perf_counter()
    days = (replace(log, times=log.times + 86400.0 * day) for day in range(365))
    samples = learn(days, axes, 4).learned_from.samples
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"{samples} samples: {time.perf_counter() - begun:.0f} s, {peak:.0f} MB")


def main(path: Path) -> None:
    """Print all tables for one log."""
    log = read_log([path])
    axes = log.of("length")
    begun = time.perf_counter()
    learn([log], axes, 4)
    print(f"learning from all of it: {time.perf_counter() - begun:.1f} s\n")
    rolling(log, axes)
    print()
    for share in (0.6, 0.7):
        print(f"learned from the first {100 * share:.0f} %")
        ladder(log, axes, share)
        print()


if __name__ == "__main__":
    if sys.argv[2:] == ["--year"]:
        given = read_log([Path(sys.argv[1])])
        year(given, given.of("length"))
    else:
        main(Path(sys.argv[1]))
