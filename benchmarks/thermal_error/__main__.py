"""Make the data of the benchmark, and score methods on it.

python -m benchmarks.thermal_error make --data thermal_error_data
python -m benchmarks.thermal_error score --data thermal_error_data --out leaderboard
python -m benchmarks.thermal_error score --method my_package.my_module:predict --out mine
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from threadpoolctl import threadpool_limits

from benchmarks.thermal_error import leaderboard, making, tasks
from benchmarks.thermal_error.methods import METHODS, method_named
from benchmarks.thermal_error.plants import NAMES
from benchmarks.thermal_error.scoring import Method, NotApplicable, Score, score
from thermojoint.artefacts.errors import ThermojointError

BAD_INPUT, DIFFERENT = 2, 1


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        with threadpool_limits(limits=1):
            return int(options.run(options))
    except ThermojointError as error:
        print(f"thermal_error: {error}", file=sys.stderr)
        return BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="thermal_error", description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    make = commands.add_parser("make", help="simulate the data and check it against the hashes")
    _add_folder(make)
    make.add_argument("--plant", action="append", choices=list(NAMES), help="default: all")
    make.add_argument("--freeze", action="store_true", help="take these data as the frozen ones")
    make.set_defaults(run=_make)
    scored = commands.add_parser("score", help="judge methods, write the leaderboard")
    _add_folder(scored)
    scored.add_argument("--plant", action="append", choices=list(NAMES), help="default: all")
    scored.add_argument("--measured", type=Path, help="CSV of the measured machine, if you have it")
    scored.add_argument("--method", action="append", help="name or package.module:function")
    scored.add_argument("--out", type=Path, default=Path("leaderboard"), help="writes .json, .md")
    scored.set_defaults(run=_score)
    return parser


def _add_folder(parser: argparse.ArgumentParser) -> None:
    where = Path("thermal_error_data")
    parser.add_argument("--data", type=Path, default=where, help="folder of the data")


def _make(options: argparse.Namespace) -> int:
    plants = tuple(options.plant or NAMES)
    if options.freeze:
        making.freeze(options.data, print, plants)
        return 0
    other = making.make(options.data, print, plants)
    return DIFFERENT if other else 0


def _score(options: argparse.Namespace) -> int:
    # A user's module is in the working folder.
    sys.path.insert(0, str(Path.cwd()))
    methods = dict(method_named(text) for text in options.method or METHODS)
    found: list[Score] = []
    impossible: list[tuple[str, str, str]] = []
    for task in _tasks(options):
        for name, method in methods.items():
            _one(task, name, method, found, impossible)
    leaderboard.write(found, impossible, options.out)
    print(leaderboard.as_markdown(found))
    return 0


def _tasks(options: argparse.Namespace) -> Iterator[tasks.Task]:
    yield from tasks.simulated(options.data, tuple(options.plant or NAMES))
    if options.measured:
        yield from tasks.measured(options.measured)


def _one(
    task: tasks.Task,
    name: str,
    method: Method,
    found: list[Score],
    impossible: list[tuple[str, str, str]],
) -> None:
    try:
        rows = score(task, name, method)
    except NotApplicable as reason:
        impossible.append((task.name, name, str(reason)))
        print(f"{task.name}: {name}: not applicable, {reason}", file=sys.stderr)
        return
    found += rows
    errors = ", ".join(f"{one.channel} {one.rms_um:.3g} µm rms" for one in rows)
    print(f"{task.name}: {name}: {errors}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
