"""Replay of a machine that has been running for hours: writes the readings of its sensors.

It replays a measured day repeatedly, beginning with the hours that the model has not seen. The
hours before now are written at once, then one line every ten seconds. After a restart it continues
as if it had never stopped.
"""

import argparse
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd

INTERVAL_S = 10.0
MEASURED_S = 60.0
FOLDER = Path(__file__).parent.parent / "measured_machine"


def readings() -> tuple[list[str], np.ndarray]:
    """Return names and readings of a whole day, a row every interval; displacements left out."""
    day = pd.concat([pd.read_csv(FOLDER / f"{part}.csv") for part in ("unseen", "learned")])
    day = day[[name for name in day.columns if name.startswith(("temp", "spindle"))]]
    at = np.arange(0.0, len(day), INTERVAL_S / MEASURED_S)
    rows = np.column_stack([np.interp(at, np.arange(len(day)), day[name]) for name in day.columns])
    # A speed is constant until the next one.
    speed = day.columns.get_loc("spindle_rpm")
    rows[:, speed] = day["spindle_rpm"].to_numpy()[at.astype(int)]
    return list(day.columns), rows


def begun(path: Path, hours: float) -> tuple[float, int]:
    """Return the time of the first line, s since 1970, and the number of complete lines."""
    whole = path.read_bytes().rpartition(b"\n")[0].splitlines() if path.exists() else []
    if len(whole) < 2:
        return time.time() - 3600.0 * hours, 0
    first = datetime.fromisoformat(whole[1].decode().partition(",")[0])
    return first.timestamp(), len(whole) - 1


def main() -> None:
    """Write lines until it is stopped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=3.0, help="since when the machine runs")
    parser.add_argument("--out", type=Path, default=Path("mill.csv"))
    given = parser.parse_args()
    names, rows = readings()
    start, count = begun(given.out, given.hours)
    with given.out.open("a" if count else "w", encoding="utf-8") as out:
        if not count:
            out.write(",".join(["timestamp", *names]) + "\n")
        while True:
            at = start + INTERVAL_S * count
            if at > time.time():
                out.flush()
                time.sleep(at - time.time())
            stamp = datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds")
            row = rows[count % len(rows)]
            out.write(",".join([stamp, *(f"{value:g}" for value in row)]) + "\n")
            count += 1


if __name__ == "__main__":
    main()
