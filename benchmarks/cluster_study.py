"""A large study on a Dask cluster: what a case costs whom, and what is lost with its parts.

    python -m benchmarks.cluster_study --count 20000 --kills 2000 --out cluster.json

The study of `benchmarks.performance.batch`: one condensation, adaptive steps to 0.01 um,
displacements kept. Scheduler, two workers and `thermojoint batch` are processes of their own on one
computer. First an undisturbed study. Then a smaller one in which a worker is killed after a quarter
of the cases, the scheduler after half of them, and which is continued by the same command on a new
cluster.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
import psutil

from benchmarks.performance.batch import ADAPTIVE, coarse_study
from benchmarks.performance.cases import fresh_condensations
from benchmarks.study import command, free_port, options_of, write_json
from fesim.simulate import simulate

WORKERS = 2
#: Between two looks at the processes and the journal, s.
LOOK = 0.1
#: A study or a cluster that takes longer has failed, s.
PATIENCE = 3600.0


def main(arguments: list[str] | None = None) -> None:
    """Print and write what the studies took."""
    parser = options_of(__doc__, "cluster.json")
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--kills", type=int, default=2_000)
    given = parser.parse_args(arguments)
    with TemporaryDirectory() as name, fresh_condensations():
        found = {
            "undisturbed": undisturbed(Path(name) / "whole", given.count),
            "killed": killed(Path(name) / "killed", given.kills),
        }
    print(json.dumps(found, indent=1))
    write_json(given.out, found)


def undisturbed(folder: Path, count: int) -> dict[str, Any]:
    """Run a study on a cluster; return what a case costs each of its processes."""
    _write_study(folder, count)
    with ExitStack() as stack:
        scheduler, address = stack.enter_context(a_scheduler(folder))
        workers = stack.enter_context(some_workers(folder, address))
        begun = time.perf_counter()
        parts = {"command": started(folder, address), "scheduler": scheduler, "workers": workers}
        seen = {name: psutil.Process(one.pid) for name, one in parts.items()}
        first = {name: used_by(one)[0] for name, one in seen.items()}
        looks: dict[str, list[tuple[float, int]]] = {name: [] for name in seen}
        while parts["command"].poll() is None:
            for name, one in seen.items():
                with suppress(psutil.NoSuchProcess):  # the command has ended meanwhile
                    looks[name].append(used_by(one))
            time.sleep(LOOK)
        taken = time.perf_counter() - begun
    _all_done(folder, count)
    files = [path for path in (folder / "out").rglob("*") if path.is_file()]
    return {
        "cases": count,
        "cases_per_minute": round(60.0 * count / taken),
        "files": len(files),
        "disk_KB_per_case": round(1e-3 * sum(path.stat().st_size for path in files) / count, 1),
    } | {
        name: {
            "processor_ms_per_case": round(1e3 * (every[-1][0] - first[name]) / count, 2),
            "memory_MB": round(1e-6 * max(memory for _, memory in every)),
        }
        for name, every in looks.items()
    }


def killed(folder: Path, count: int) -> dict[str, Any]:
    """Kill a worker, then the scheduler, and continue; return what became of the cases."""
    _write_study(folder, count)
    with ExitStack() as stack:
        scheduler, address = stack.enter_context(a_scheduler(folder))
        nanny = stack.enter_context(some_workers(folder, address))
        running = started(folder, address)
        _wait(lambda: _events(folder)["done"] >= count // 4, running)
        # Not the process that watches them, which starts another one.
        every = psutil.Process(nanny.pid).children(recursive=True)
        next(one for one in every if one.cpu_times().user > 1.0).kill()
        _wait(lambda: _events(folder)["done"] >= count // 2, running)
        scheduler.kill()
        code = running.wait(PATIENCE)
    kept = _events(folder)["done"]
    with ExitStack() as stack:
        _, address = stack.enter_context(a_scheduler(folder))
        stack.enter_context(some_workers(folder, address))
        again = started(folder, address).wait(PATIENCE)
    _all_done(folder, count)
    events = _events(folder)
    return {
        "cases": count,
        "exit_code_without_scheduler": code,
        "done_until_then": kept,
        "exit_code_continued": again,
        "events": dict(events),
        "done_twice": events["done"] - count,
    }


def used_by(process: psutil.Process) -> tuple[float, int]:
    """Processor time, s, and memory, bytes, of a process and all its children."""
    every = [process, *process.children(recursive=True)]
    times = [one.cpu_times() for one in every]
    seconds = sum(one.user + one.system for one in times)
    return seconds, sum(one.memory_info().rss for one in every)


@contextmanager
def a_scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start a scheduler; yield it and its address."""
    port = free_port()
    arguments = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    with _dask(folder, "scheduler", arguments) as process:
        yield process, f"tcp://127.0.0.1:{port}"


@contextmanager
def some_workers(folder: Path, address: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start the workers; yield the process that watches them."""
    arguments = ["worker", address, "--nworkers", str(WORKERS), "--nthreads", "1", "--no-dashboard"]
    with _dask(folder, "workers", [*arguments, "--local-directory", str(folder)]) as process:
        yield process


@contextmanager
def _dask(folder: Path, name: str, arguments: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    with (folder / f"{name}.log").open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments], stdout=log, stderr=log
        )
    try:
        time.sleep(5.0)
        yield process
    finally:
        for one in [*psutil.Process(process.pid).children(recursive=True), process]:
            one.kill()
        process.wait()


def started(folder: Path, address: str) -> subprocess.Popen[bytes]:
    """Start the command."""
    words = command("batch", folder / "study.toml", "--out", folder / "out", "--scheduler", address)
    with (folder / "command.log").open("ab") as log:
        return subprocess.Popen(words, stdout=log, stderr=log)


def _write_study(folder: Path, count: int) -> None:
    folder.mkdir()
    # The condensation is kept, as in a study that is continued.
    simulate(coarse_study(folder, count, "displacement", ADAPTIVE).cases[0].case)


def _events(folder: Path) -> Counter[str]:
    path = folder / "out" / "journal.jsonl"
    lines = path.read_text("utf-8").splitlines(keepends=True) if path.exists() else []
    return Counter(json.loads(line)["event"] for line in lines if line.endswith("\n"))


def _wait(happened: Callable[[], bool], running: subprocess.Popen[bytes]) -> None:
    until = time.monotonic() + PATIENCE
    while not happened():
        if running.poll() is not None or time.monotonic() > until:
            raise RuntimeError("the command has ended before anything was killed")
        time.sleep(LOOK)


def _all_done(folder: Path, count: int) -> None:
    status = pd.read_csv(folder / "out" / "summary.csv")["status"]
    if list(status) != ["done"] * count:
        raise RuntimeError(f"not every case is done: {Counter(status)}")


if __name__ == "__main__":
    main()
