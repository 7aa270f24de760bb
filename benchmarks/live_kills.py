"""A service killed at random moments of a day says what one says that was never killed.

python -m benchmarks.live_kills --count 50

A day of readings comes line by line; the service is killed (SIGKILL) again and again, while it
starts, too, and begins each life with other settings and with one of several models. Then every
sample of its history is set against services that are never killed: one for each run of samples
with the same model, which reads just these. Times, numbers, readings, estimates, bands and statuses
must be equal, and every sample of the day must be there once. Offsets move by the clock, and not as
often as samples are read; that none jumps is looked at in `benchmarks.offset_invariant`.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import random
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.study import MEASURED_LOG, learn, options_of, service, write_json
from thermojoint.artefacts.errors import InputError
from thermojoint.live.archive import Archive, History
from thermojoint.live.loaded_models import load_model
from thermojoint.live.publication import Columns
from thermojoint.live.service import run
from thermojoint.live.settings import read_service

MACHINE = "mill"
_OFFSETS = """
cycle_s = 1.0
resolution_um = {resolution}
rate_um_s = {rate}
filter_s = 60.0
oldest_s = 600.0
unusable = []
[axes.X]
follows = "{axis}"
"""
_SERVICE = """
folder = "{folder}"
behind_s = 1e9
[models.model]
file = "{model}"
interval_s = {interval}
offsets = "offsets.toml"
[machines.{machine}]
model = "model"
source = "log"
[sources.log]
kind = "csv"
path = "{csv}"
starts = "2026-03-02T00:00:00Z"
follow = {follow}
[store]
keep_days = 10000.0
checkpoint_s = {checkpoint}
[watchdog]
uncertain_s = 600.0
bad_s = 6000.0
"""


def prepare(place: Path, model: Path, axis: str, interval: float, checkpoint: float) -> None:
    """Write the files of two services: one that reads a whole day, one that is fed it."""
    (place / "offsets.toml").write_text(_OFFSETS.format(axis=axis, resolution=0.1, rate=0.05))
    for name, csv, follow in (("whole", "day.csv", "false"), ("killed", "fed.csv", "true")):
        text = _SERVICE.format(
            folder=name,
            model=model,
            interval=interval,
            machine=MACHINE,
            csv=csv,
            follow=follow,
            checkpoint=checkpoint,
        )
        (place / f"{name}.toml").write_text(text)


def change(place: Path, draw: random.Random) -> None:
    """Give the service that is killed other settings, and one of the models, by another name."""
    for path, drawn in (
        ("offsets.toml", {"resolution_um": (0.1, 1.0, 5.0), "rate_um_s": (0.05, 1.0)}),
        ("killed.toml", {"checkpoint_s": (0.2, 2.0, 60.0), "uncertain_s": (60.0, 600.0)}),
    ):
        text = (place / path).read_text()
        for key, values in drawn.items():
            text = re.sub(rf"(?m)^{key} = .*", f"{key} = {draw.choice(values)}", text)
        (place / path).write_text(text)
    text = (place / "killed.toml").read_text()
    model = re.findall(r'(?m)^file = "(.*)"', text)[0]
    other = place / f"copy-{draw.randrange(1000)}.json"
    shutil.copyfile(draw.choice(sorted(place.glob("model*.json")) or [Path(model)]), other)
    (place / "killed.toml").write_text(text.replace(f'"{model}"', f'"{other}"'))


def started(place: Path, name: str) -> subprocess.Popen[bytes]:
    """Start a service of its own process; its log is appended to a file."""
    return service(place / f"{name}.toml", place / f"{name}.log")


def kill_through(
    place: Path,
    lines: Sequence[str],
    count: int,
    draw: random.Random,
    shortest: float,
    longest: float,
) -> int:
    """Feed a service the lines of a day, and kill it `count` times; return how often it had begun.

    `place`: where `prepare` wrote its files. `lines`: header and rows. `draw`: draws the moments.
    `shortest`, `longest`: a service lives so long after its first sign of life, s; less than 0: it
    is killed as it starts.
    """
    fed = place / "fed.csv"
    fed.write_text(lines[0])
    per_life = -(-(len(lines) - 1) // (count + 1))
    at, had_begun = 1, 0
    with fed.open("a") as out:
        for _ in range(count):
            log = place / "killed.log"
            before = log.read_bytes().count(b"event=ready") if log.exists() else 0
            change(place, draw)
            process = started(place, "killed")
            until, alive = time.monotonic() + 120.0, 0.0
            lives = draw.uniform(shortest, longest)
            rows = list(lines[at : at + per_life])
            share = max(1, len(rows) // 20)
            while time.monotonic() < until and process.poll() is None:
                ready = log.read_bytes().count(b"event=ready") > before
                alive = alive or (time.monotonic() if ready else 0.0)
                if lives < 0.0 and time.monotonic() > until - 120.0 + 4.0 * -lives:
                    break  # while it starts
                if alive and time.monotonic() - alive > max(lives, 0.0):
                    break
                if alive and rows:
                    # A row need not be whole when it is seen.
                    text = "".join(rows[:share])
                    del rows[:share]
                    cut = draw.randrange(len(text))
                    out.write(text[:cut])
                    out.flush()
                    time.sleep(0.002)
                    out.write(text[cut:])
                    out.flush()
                time.sleep(draw.uniform(0.0, 0.03))
            assert process.poll() is None, log.read_text()[-2000:]
            process.kill()
            process.wait()
            had_begun += bool(alive)
            out.write("".join(rows))
            out.flush()
            at += per_life
        out.write("".join(lines[at:]))
    return had_begun


def finish(place: Path, name: str, samples: int, timeout: float = 300.0) -> History:
    """Let a service read to the end, stop it, and return its history."""
    process = started(place, name)
    until = time.monotonic() + timeout
    archive = Archive(place / name / "history.sqlite")
    try:
        while time.monotonic() < until and process.poll() is None:
            time.sleep(0.1)
            if archive.path.exists() and _count(archive) >= samples:
                break
        # One that does not follow its file ends by itself.
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.5)
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        assert process.wait(60.0) == 0, (place / f"{name}.log").read_text()[-2000:]
    finally:
        process.kill()
    return archive.history(MACHINE, 0.0, 1e11, 10**9)


def _count(archive: Archive) -> int:
    try:
        last = archive.latest(MACHINE)
    except (InputError, sqlite3.OperationalError):
        # The service has only just made its store.
        return 0
    return last.number if last else 0


def differences(whole: History, killed: History) -> list[str]:
    """Return in what two histories differ; published times apart, to the last bit."""
    found = []
    if not np.array_equal(whole.numbers, killed.numbers):
        return [f"samples: {len(whole.numbers)} and {len(killed.numbers)}"]
    for name in ("times", "quality", "displacement", "band", "details", "readings"):
        one, other = getattr(whole.columns, name), getattr(killed.columns, name)
        if not np.array_equal(one, other, equal_nan=True):
            rows = int((~((one == other) | (np.isnan(one) & np.isnan(other)))).sum())
            found.append(f"{name}: {rows} values")
    if whole.status != killed.status:
        found.append("status")
    if whole.gaps or killed.gaps:
        found.append(f"holes: {len(whole.gaps)} and {len(killed.gaps)}")
    return found


def undisturbed(place: Path, lines: Sequence[str], killed: History) -> Iterator[History]:
    """Yield the history of a service for each run of samples with one model, which reads them.

    `place`: where `prepare` wrote its files; the models are ``model*.json`` there. `lines`: of the
    whole day, header and rows. `killed`: of the service that was killed; its model by sample is in
    its store.
    """
    text = (place / "whole.toml").read_text()
    given = read_service(place / "whole.toml").given.models["model"]
    models = {
        load_model(given.model_copy(update={"file": path}), place / "kept").digest: path
        for path in place.glob("model*.json")
    }
    with closing(sqlite3.connect(place / "killed" / "history.sqlite")) as store:
        rows = store.execute(
            "SELECT model, count FROM chunks JOIN eras ON eras.id = era ORDER BY first"
        ).fetchall()
    at = 1
    for k, (digest, chunks) in enumerate(itertools.groupby(rows, key=lambda row: row[0])):
        count = sum(count for _, count in chunks)
        (place / "day.csv").write_text("".join([lines[0], *lines[at : at + count]]))
        at += count
        (place / "whole.toml").write_text(
            text.replace('folder = "whole"', f'folder = "whole-{k}"').replace(
                str(given.file), str(models[digest])
            )
        )
        asyncio.run(run(read_service(place / "whole.toml"), asyncio.Event()))
        yield Archive(place / f"whole-{k}" / "history.sqlite").history(MACHINE, 0.0, 1e11, 10**9)


def together(parts: Sequence[History]) -> History:
    """Return histories as one."""
    columns = zip(*(vars(one.columns).values() for one in parts), strict=True)
    return replace(
        parts[0],
        columns=Columns(*map(np.concatenate, columns)),
        numbers=np.concatenate([one.numbers for one in parts]),
        status=tuple(word for one in parts for word in one.status),
        gaps=tuple(hole for one in parts for hole in one.gaps),
    )


def measured_day(interval: float, hours: float | None = None) -> list[str]:
    """Return a day of the measured machine, between its minutes by interpolation, as CSV lines.

    Its log has 23 hours; where more are asked for, it begins again, as that of a played machine.
    """
    source = MEASURED_LOG
    names = source.read_text("utf-8").splitlines()[0]
    table = np.genfromtxt(source, delimiter=",", skip_header=1)
    rest = np.genfromtxt(source.with_name("unseen.csv"), delimiter=",", skip_header=1)
    table = np.vstack([table, rest])
    first, last = table[[0, -1], 0]
    times = np.arange(first, last if hours is None else first + 3600.0 * hours, interval)
    again = last - first + np.diff(table[-2:, 0]).item()
    columns = [np.interp(times, table[:, 0], column, period=again) for column in table.T[1:]]
    rows = np.column_stack([times, *columns])
    return [names + "\n", *(",".join(f"{one:.6g}" for one in row) + "\n" for row in rows)]


def main() -> None:
    """Run it and print what was found as JSON; exit code 1 if anything differs."""
    parser = options_of(__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--interval-s", type=float, default=10.0)
    parser.add_argument("--out", type=Path, help="JSON to write")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        model = place / "model.json"
        learn(model, "disp1_um", "disp3_um")
        # The other model is of a machine that moves twice as far.
        other = json.loads(model.read_text())
        for channel in other["channels"]:
            channel["weights"] = [2.0 * weight for weight in channel["weights"]]
        (place / "model-twice.json").write_text(json.dumps(other))
        lines = measured_day(given.interval_s)
        (place / "day.csv").write_text("".join(lines))
        prepare(place, model, "disp1", given.interval_s, 2.0)
        begun = time.monotonic()
        alive = kill_through(place, lines, given.count, random.Random(given.seed), -0.5, 1.5)
        killed = finish(place, "killed", len(lines) - 1)
        parts = list(undisturbed(place, lines, killed))
        found = differences(together(parts), killed)
        told = {
            "kills": given.count,
            "killed_after_ready": alive,
            "changes_of_the_model": len(parts) - 1,
            "samples": len(killed.numbers),
            "hours": (len(lines) - 1) * given.interval_s / 3600.0,
            "differences": found,
            "wall_s": round(time.monotonic() - begun, 1),
        }
    print(json.dumps(told, indent=2))
    if given.out:
        write_json(given.out, told)
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
