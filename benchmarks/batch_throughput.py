"""Cases per minute of `thermojoint batch`, against calling `simulate` for one case after another.

200 cases of the coarse reference machine, a Latin hypercube over heat input, friction and
roughness. The other side sets every case up anew, as a plain loop does; it is measured on some
cases spread over the study, before and after the batches, and scaled.

Run: python benchmarks/batch_throughput.py [SAMPLES]
"""

from __future__ import annotations

import json
import re
import sys
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from artefacts.response import write_response
from fesim.batch.local import local_crew
from fesim.batch.run import run_batch
from fesim.batch.study import Study, read_study
from fesim.simulate import simulate

STUDY = """case = "coarse.toml"
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


def coarse_study(folder: Path, samples: int) -> Study:
    """Write the study of the coarse machine into a folder and read it."""
    text = files("thermojoint").joinpath("cases/reference.toml").read_text("utf-8")
    text = re.sub(r"joint_element_size_mm.*", "", text).replace("size_mm = 50.0", "size_mm = 100.0")
    (folder / "coarse.toml").write_text(text)
    (folder / "study.toml").write_text(STUDY.format(samples=samples))
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
    finished = run_batch(study, folder / f"out-{workers}", lambda: local_crew(workers))
    taken = perf_counter() - begun
    if not (finished.summary["status"] == "done").all():
        raise SystemExit("not every case is done")
    return taken


def rows(samples: int) -> list[dict[str, str | float]]:
    """Return the rows of the table."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        study = coarse_study(folder, samples)
        simulate(study.cases[0].case)
        step = max(1, samples // 5)
        before = loop_seconds(study, folder, slice(0, None, step))
        taken = {workers: batch_seconds(study, folder, workers) for workers in (1, 2)}
        loop = 0.5 * (before + loop_seconds(study, folder, slice(0, None, step)))
    return [
        {
            "name": f"batch-throughput-{workers}",
            "ours": 60.0 * samples / seconds,
            "other": 60.0 / loop,
            "ratio": samples * loop / seconds,
            "unit": "cases/min",
            "note": f"{samples} cases, {workers} workers, start included; other: simulate() for "
            "one case after another, from 2 x 5 of them",
        }
        for workers, seconds in taken.items()
    ]


if __name__ == "__main__":
    print(json.dumps(rows(int(sys.argv[1]) if len(sys.argv) > 1 else 200), indent=2))
