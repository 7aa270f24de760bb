"""Measure everything side by side, print it as it comes, write ``bench.json``.

    python -m benchmarks.performance --out bench.json --markdown docs/performance.md
    python -m benchmarks.performance --only closed-form estimator

Condensations are not kept on the disk between rows, except where that is what is measured.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Console

from benchmarks.performance import (
    adaptive,
    axes,
    batch,
    calculix,
    calibration,
    chain,
    closed_form,
    dense_solvers,
    march,
    marching,
    observing,
    scaling,
    set_up,
    start,
    streaming,
)
from benchmarks.performance.cases import condensations
from benchmarks.performance.report import cells, marked, missed, write_json, write_markdown
from benchmarks.performance.timing import Row, Skipped
from thermojoint.artefacts.errors import InputError, ThermojointError, unknown_name

Group = Callable[[], Iterator[Row | Skipped]]

#: The sizes come first: the largest needs memory that later groups make this process hold.
GROUPS: dict[str, Group] = {
    "contacts": scaling.contact_rows,
    "scaling": scaling.mesh_rows,
    "setup-changed-source": set_up.changed_rows,
    "contacts-2000": set_up.contact_rows,
    "setup-589k": set_up.large_rows,
    "setup-largest": set_up.largest_rows,
    "setup-changed-589k": set_up.changed_large_rows,
    "closed-form": closed_form.rows,
    "refactor": march.rows,
    "calculix": calculix.rows,
    "marching": marching.rows,
    "adaptive": adaptive.rows,
    "axes": axes.rows,
    "dense-solvers": dense_solvers.rows,
    "estimator": streaming.rows,
    "joint-aware": observing.rows,
    "calibration": calibration.rows,
    "batch": batch.rows,
    "batch-many": batch.displacement_rows,
    "reproduce": chain.rows,
    "start": start.rows,
}


def main(arguments: Sequence[str] | None = None, groups: Mapping[str, Group] = GROUPS) -> int:
    """Run the harness; return the exit code: 1 if a group failed, 2 if what is given is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.performance")
    parser.add_argument("--out", type=Path, default=Path("bench.json"))
    parser.add_argument("--only", nargs="+", metavar="NAME", help=", ".join(groups))
    parser.add_argument("--markdown", type=Path, help="page whose table is written again")
    given = parser.parse_args(arguments)
    try:
        chosen = _chosen(given.only, groups)
        if given.markdown is not None:
            marked(given.markdown)  # now, not after an hour
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0 if run(chosen, given.out, given.markdown) else 1


def run(groups: Mapping[str, Group], out: Path, page: Path | None) -> bool:
    """Run groups, every row in the file as soon as it is measured; say whether none failed."""
    console = Console(highlight=False, markup=False, width=120)
    results: list[Row | Skipped] = []
    failed: list[str] = []
    console.print(_line(["row", "ours", "other", "unit", "ratio", "target"]), style="bold")
    with condensations("off"):
        for name, group in groups.items():
            for one in _reported(name, group, failed):
                results.append(one)
                write_json(out, results)
                if isinstance(one, Row):
                    console.print(_line(cells(one)), style="bold red" if missed(one) else None)
                else:
                    console.print(f"{one.name:<30}skipped: {one.reason}", style="yellow")
    for one in results:
        if isinstance(one, Row):
            console.print(f"{one.name}: {one.note}")
    if page is not None:
        write_markdown(page, results)
    console.print(f"wrote {out}" + (f" and {page}" if page else ""))
    return not failed


def _reported(name: str, group: Group, failed: list[str]) -> Iterator[Row | Skipped]:
    """The rows of a group; if it fails, what it failed of in place of those that are missing."""
    try:
        yield from group()
    except ThermojointError as error:
        failed.append(name)
        yield Skipped(name, f"failed: {error}")


def _chosen(names: Sequence[str] | None, groups: Mapping[str, Group]) -> dict[str, Group]:
    for name in names or ():
        if name not in groups:
            raise unknown_name("group", name, groups, "--only")
    return {name: groups[name] for name in names or groups}


def _line(texts: Sequence[str]) -> str:
    name, ours, other, unit, ratio, target = texts
    shown = target.replace("**", "")
    return f"{name:<30}{ours:>10}{other:>10}  {unit:<10}{ratio:>8}  {shown}".rstrip()


if __name__ == "__main__":
    sys.exit(main())
