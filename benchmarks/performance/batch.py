"""Cases per minute of `thermojoint batch`, against calling `simulate` for one case after another.

200 cases of the coarse equal-heights machine, a Latin hypercube over heat input, friction and
roughness. Both sides may keep condensations on the disk, as they do unless told otherwise; the loop
finds its condensation there from the second case on. It is measured on some cases spread over the
study, before and after the batches, and scaled.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import mean, median
from tempfile import TemporaryDirectory
from time import perf_counter

from benchmarks.performance.cases import coarse_text, condensations, fresh_condensations
from benchmarks.performance.timing import Row
from fesim.batch.local import local_crew
from fesim.batch.run import run_batch
from fesim.batch.study import Study, read_study
from fesim.simulate import simulate
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.artefacts.response import write_response

SAMPLES, REPEATS = 200, 3
#: Cases that the loop is measured on, each time.
LOOPED = 10
WORKERS = (1, 2)

#: Steps of the shipped case, and adaptive ones of which a displacement is off by 0.01 um.
STEPS = "step_s = 2.0"
ADAPTIVE = 'step_s = 60.0\nmethod = "adaptive"\ntolerance_um = 0.01'

STUDY = """case = "coarse.toml"
keep = "{keep}"
[latin_hypercube]
samples = {samples}
seed = 1
[[latin_hypercube.ranges]]
path = "heat_input.level"
low = 0.5
high = 3.0
[[latin_hypercube.ranges]]
path = "joints.knee.friction_coefficient"
low = 0.15
high = 0.6
[[latin_hypercube.ranges]]
path = "joints.knee.roughness_um"
low = 0.6
high = 2.5
scale = "log"
"""


def coarse_study(folder: Path, samples: int, keep: str = "response", march: str = STEPS) -> Study:
    """Write the study of the coarse machine, marched in some way, into a folder and read it."""
    case = coarse_text()
    if STEPS not in case:
        raise ValueError(f"the machine has other steps than {STEPS!r}")
    (folder / "coarse.toml").write_text(case.replace(STEPS, march), encoding="utf-8")
    (folder / "study.toml").write_text(STUDY.format(samples=samples, keep=keep), encoding="utf-8")
    return read_study(folder / "study.toml")


def loop_seconds(study: Study, folder: Path, some: slice) -> float:
    """Return the mean time of one case in a plain loop, response written, s."""
    cases = study.cases[some]
    begun = perf_counter()
    for one in cases:
        write_response(simulate(one.case).response, folder / "loop.nc")
    return (perf_counter() - begun) / len(cases)


def batch_seconds(study: Study, folder: Path, workers: int) -> float:
    """Return the time of the whole batch, processes started and results written, s."""
    begun = perf_counter()
    finished = run_batch(study, folder, lambda: local_crew(workers))
    taken = perf_counter() - begun
    if not (finished.summary["status"] == "done").all():
        raise ConvergenceError("batch-throughput: not every case is done")
    return taken


def rows(samples: int = SAMPLES, repeats: int = REPEATS) -> Iterator[Row]:
    """Yield batch-throughput for each number of workers."""
    with TemporaryDirectory() as name, fresh_condensations():
        folder = Path(name)
        study = coarse_study(folder, samples)
        some = slice(0, None, max(1, samples // LOOPED))
        with condensations("off"):
            alone = loop_seconds(study, folder, some)
        simulate(study.cases[0].case)
        loops: list[float] = []
        batches: dict[int, list[float]] = {workers: [] for workers in WORKERS}
        for turn in range(repeats):
            before = loop_seconds(study, folder, some)
            for workers, times in batches.items():
                times.append(batch_seconds(study, folder / f"out-{workers}-{turn}", workers))
            loops.append(mean((before, loop_seconds(study, folder, some))))
    for workers, times in batches.items():
        yield Row(
            f"batch-throughput-{workers}",
            60.0 * samples / median(times),
            60.0 / median(loops),
            median(samples * loop / taken for loop, taken in zip(loops, times, strict=True)),
            "cases/min",
            f"{samples} cases of the coarse machine, {workers} worker{'s'[: workers > 1]}, start "
            f"included; other: simulate() for one case after another, from 2 x "
            f"{len(study.cases[some])} of them ({60.0 / alone:.0f} cases/min where nothing is kept "
            f"on the disk); median of {repeats}",
        )


#: Cases that are marched adaptively, and in steps of 2 s.
FREE, STEPPED = 10_000, 500


def displacement_rows(free: int = FREE, stepped: int = STEPPED) -> Iterator[Row]:
    """Yield batch-10000: cases per minute where only displacements are kept, adaptive steps."""
    with TemporaryDirectory() as name, fresh_condensations():
        folder = Path(name)
        ways = {"free": (free, ADAPTIVE), "stepped": (stepped, STEPS)}
        rates = []
        for way, (samples, march) in ways.items():
            study = coarse_study(folder, samples, "displacement", march)
            simulate(study.cases[0].case)
            rates.append(60.0 * samples / batch_seconds(study, folder / way, 2))
    ours, other = rates
    yield Row(
        "batch-10000",
        ours,
        other,
        ours / other,
        "cases/min",
        f"measured on {free} cases of the coarse machine that share one condensation, 2 workers, "
        "start included, displacements and figures kept, adaptive steps to 0.01 um and a row "
        f"every minute; other: {stepped} such cases in steps of 2 s; both measured once",
    )
