"""How long the reserve of a service's store lasts on a file system that is really full.

python -m benchmarks.full_disk --machines 10 --hours 8

An ext4 file system in a file (needs root) is filled to the last byte once the store has its
reserve. Then samples of 20 numbers at 1 Hz are committed as by the service, with its checkpoints,
moves of the log and pruning, as fast as the disk allows, until a commit finds no room. Finally the
disk gets room again, and what the store has is counted.
"""

from __future__ import annotations

import json
import sqlite3
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from benchmarks.study import options_of
from thermojoint.live.disk_reserve import OVERHEAD, adjust_reserve, preallocate
from thermojoint.live.publication import Layout
from thermojoint.live.store import (
    Batch,
    Checkpoint,
    StoredSample,
    checkpoint_wal,
    commit,
    era_of,
    open_store,
    prune,
)

#: Numbers in a row; interval of checkpoints, s; size of a state, bytes.
_WIDTH, _CHECKPOINT_S, _STATE = 20, 60, 16_000
#: What a sample's ``rest`` is like.
_REST = json.dumps({"at": 123456789, "output": {"steps": [123], "time": 1.5}, "waiting": []})


@contextmanager
def disk(place: Path, size: int) -> Iterator[Path]:
    """Give a file system of a size (bytes)."""
    image, folder = place / "image", place / "disk"
    folder.mkdir()
    with image.open("wb") as file:
        file.truncate(size)
    subprocess.run(["mkfs.ext4", "-q", "-m", "0", str(image)], check=True)
    subprocess.run(["mount", "-o", "loop", str(image), str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(filler: Path) -> None:
    """Take the last byte."""
    for size in (1 << 20, 4096, 1):
        with suppress(OSError), filler.open("ab", buffering=0) as out:
            while out.write(bytes(size)) == size:
                pass


def measured(folder: Path, machines: int, hours: float) -> dict[str, float | int | bool]:
    """Return how long the reserve lasted, in hours of samples."""
    path = folder / "history.sqlite"
    store = open_store(path)
    preallocate(store, path)
    per_hour = 3600.0 * OVERHEAD * 8.0 * _WIDTH * machines
    room = adjust_reserve(store, path, per_hour * hours)
    while room.reserve < per_hour * hours:
        room = adjust_reserve(store, path, per_hour * hours)
    layout = Layout(("x",), (), (), tuple(map(str, range(15))))
    eras = [era_of(store, f"mill-{k}", "model", layout, 0.0) for k in range(machines)]
    fill(folder / "filler")
    row, rows = bytes(8 * _WIDTH), np.zeros((_CHECKPOINT_S, _WIDTH))
    said, second, end, behind, round_from = room.reserve / per_hour, 0, 0, 0, 0
    with suppress(sqlite3.OperationalError):
        while True:
            batch = Batch([StoredSample(era, second + 1, row, "ok", _REST) for era in eras])
            end = commit(store, batch)
            second += 1
            adjust_reserve(store, path, per_hour * hours)
            due = eras[second % _CHECKPOINT_S :: _CHECKPOINT_S]
            if second > _CHECKPOINT_S and due:
                rows[:, 0] = np.arange(second - _CHECKPOINT_S, second)
                words = _CHECKPOINT_S * ("ok",)
                points = [Checkpoint(era, second, bytes(_STATE), _REST, rows, words) for era in due]
                commit(store, Batch(checkpoints=points))
            if second % _CHECKPOINT_S == 0:
                behind, round_from = round_from, end
            prune(store, behind, due, 7.0 * 86400.0, float(second))
            if second % 10 == 0:
                checkpoint_wal(path)
    (folder / "filler").unlink()
    commit(store, Batch([StoredSample(era, second + 2, row, "ok", _REST) for era in eras]))
    ((last,),) = store.execute("SELECT max(number) FROM journal")
    ((whole,),) = store.execute("PRAGMA integrity_check")
    store.close()
    return {
        "machines": machines,
        "reserve_mb": round(room.reserve / 1e6, 1),
        "said_h": round(said, 2),
        "lasted_h": round(second / 3600.0, 2),
        "whole_and_goes_on": whole == "ok" and last == second + 2,
    }


def main() -> None:
    """Run it and print what was found as JSON."""
    parser = options_of(__doc__)
    parser.add_argument("--machines", type=int, default=10)
    parser.add_argument("--hours", type=float, default=8.0)
    given = parser.parse_args()
    size = int(3.0 * 3600.0 * OVERHEAD * 8.0 * _WIDTH * given.machines * given.hours) + (128 << 20)
    with tempfile.TemporaryDirectory() as place, disk(Path(place), size) as folder:
        print(json.dumps(measured(folder, given.machines, given.hours)))


if __name__ == "__main__":
    main()
