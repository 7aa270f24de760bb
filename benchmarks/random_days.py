"""Adaptive marches of random days of 8 h, at full fineness: none may fail, none be off.

    python -m benchmarks.random_days --out days.json [--case reference] [--first 0] [--count 100]

Every day has heat, jumps and ambient of its own, drawn from its number as those of `thermojoint
reproduce` are. Every tenth is marched with a tenth of the tolerance, too. Exit code 1 if one fails.
Figures in docs/march.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.study import case_file, options_of, write_rows
from fesim.case.schema import Case, read_case
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA
from thermojoint.paper.long_runs import TOLERANCE_UM, driven, random_day

MINUTES = 480.0
#: Of this many days one is marched again, with this part of the tolerance.
AGAIN, PART = 10, 0.1


def rows(case: Case, first: int, count: int) -> Iterator[dict[str, Any]]:
    """Yield the figures of every day, or how it failed."""
    setup = set_up(case)
    with TemporaryDirectory() as folder:
        for number in range(first, first + count):
            day = driven(case, random_day(MINUTES, number), MINUTES, f"{number}", Path(folder))
            row: dict[str, Any] = {"day": number}
            try:
                moved, about = marched(day, setup)
                row |= about | {"largest_um": round(MEGA * float(np.abs(moved).max()), 1)}
                if number % AGAIN == 0:
                    finer = day.replace(march={"tolerance_um": PART * TOLERANCE_UM})
                    off = np.abs(marched(finer, setup)[0] - moved).max()
                    row["off_um"] = round(MEGA * float(off), 4)
            except (ValueError, ArithmeticError) as error:
                row["failed"] = f"{type(error).__name__}: {error}"
            yield row


def marched(case: Case, setup: Setup) -> tuple[Array, dict[str, Any]]:
    """Return the displacement of an adaptive march, m, and what it says of its steps."""
    response = simulate(case, setup=setup, accuracy=False).response
    moved = columns_of(response, "displacement", ["x", "y"])
    if not np.isfinite(moved).all():
        raise ArithmeticError("displacement that is no number")
    estimated = round(float(response.attrs["estimated_error_um"]), 4)
    return moved, {"steps": int(response.attrs["march_steps"]), "estimated_um": estimated}


def main(arguments: list[str] | None = None) -> None:
    """March the days and write their rows."""
    parser = options_of(__doc__, "days.json")
    parser.add_argument("--case", default="reference")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    options = parser.parse_args(arguments)
    case = read_case(case_file(options.case))
    found = write_rows(rows(case, options.first, options.count), options.out)
    if failed := [row["day"] for row in found if "failed" in row]:
        raise SystemExit(f"failed: {failed}")


if __name__ == "__main__":
    main()
