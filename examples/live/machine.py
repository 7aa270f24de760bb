"""Plays a machine: writes its readings line by line, as they came in seven hours, only faster."""

import argparse
import time
from pathlib import Path

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--speed", type=float, default=600.0, help="how many times faster")
parser.add_argument("--out", type=Path, default=Path("mill.csv"))
given = parser.parse_args()
log = Path(__file__).parent.parent / "measured_machine" / "unseen.csv"
header, *rows = log.read_text("utf-8").splitlines(keepends=True)
with given.out.open("w", encoding="utf-8") as out:
    out.write(header)
    for row in rows:
        out.write(row)
        out.flush()
        time.sleep(60.0 / given.speed)
