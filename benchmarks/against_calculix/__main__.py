"""Compare the march with CalculiX.

    python -m benchmarks.against_calculix                 # about 6 minutes, and 20 for the knee
    python -m benchmarks.against_calculix --fine          # with the machine at 50 mm

Without CalculiX (Debian: calculix-ccx) it says so and ends.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.against_calculix.run import PROGRAM, available
from benchmarks.against_calculix.studies import (
    Comparison,
    coarse_machine,
    moving_knee,
    two_bars,
    two_rods,
)
from benchmarks.study import options_of, write_json


def main() -> None:
    """Run the studies, print the table and write it as JSON."""
    parser = options_of(__doc__, "against_calculix.json")
    parser.add_argument("--fine", action="store_true", help="the machine at 50 mm too")
    parser.add_argument("--keep", type=Path, help="folder for decks and logs; default: none kept")
    given = parser.parse_args()
    console = Console(width=130)
    if not available():
        console.print(f"against_calculix: skipped, no {PROGRAM} on the PATH (Debian: calculix-ccx)")
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        rows = list(_shown(console, folder, fine=given.fine))
    console.print(_table(rows))
    for table in _figures(rows):
        console.print(table)
    write_json(given.out, {"rows": [asdict(row) for row in rows]})


def _shown(console: Console, folder: Path, *, fine: bool) -> Iterator[Comparison]:
    studies = two_bars(folder), two_rods(folder), coarse_machine(folder, fine=fine)
    for row in chain(*studies, moving_knee(folder)):
        console.print(f"{row.study}: {row.variant}: done in {row.ccx_seconds:.1f} s by CalculiX")
        yield row


def _table(rows: list[Comparison]) -> Table:
    table = Table("study", "variant", "ΔT", "Δu", "Δ probe", "Δp", "Δ force", "ours, s", "ccx, s")
    for row in rows:
        found = row.agreement
        errors = (
            [found.temperature, found.displacement, found.probe, found.pressure, found.normal_force]
            if found
            else []
        )
        shown = [f"{abs(error):.1e}" for error in errors] or ["-"] * 5
        table.add_row(
            row.study, row.variant, *shown, f"{row.ours_seconds:.2f}", f"{row.ccx_seconds:.1f}"
        )
    return table


def _figures(rows: list[Comparison]) -> Iterator[Table]:
    """Figures of the machines that do not depend on the mesh, ours and CalculiX's."""
    chosen = [row for row in rows if row.study.startswith("machine")]
    for names in dict.fromkeys(tuple(row.ours) for row in chosen):
        table = Table("study", "variant", "side", *names)
        for row in chosen:
            for side, figures in (("ours", row.ours), ("ccx", row.ccx)):
                if tuple(figures) == names:
                    shown = (f"{value:.2f}" for value in figures.values())
                    table.add_row(row.study, row.variant, side, *shown)
        yield table


if __name__ == "__main__":
    main()
