"""The march against CalculiX: the same coarse machine, the same steps, one thread on both sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.against_calculix.compare import comparable, run_ours, run_theirs
from benchmarks.against_calculix.deck import Choices
from benchmarks.against_calculix.problem import problem_of
from benchmarks.against_calculix.run import PROGRAM, available
from benchmarks.against_calculix.structures import machine
from benchmarks.against_calculix.studies import TIMEOUT
from benchmarks.performance.timing import Row, Skipped

STEPS, REPEATS = 1050, 3
#: Steps of the other side: a run, and a shorter one that tells what its steps alone cost.
MEASURED, SHORTER = 30, 10


def rows() -> Iterator[Row | Skipped]:
    """Yield march-vs-calculix for a coupled step and for a whole run with set-up."""
    if not available():
        for name in ("march-vs-calculix-step", "march-vs-calculix"):
            yield Skipped(name, f"no {PROGRAM} on the PATH; install it (Debian: calculix-ccx)")
        return
    case = machine(march__duration_min=2.0 * STEPS / 60.0)
    problem = problem_of(case)
    law = comparable(problem.law)
    # Machine code is made once on a machine, not in every run.
    run_ours(machine(march__duration_min=0.1), law)
    steps, wholes = [], []
    with TemporaryDirectory() as name:
        for _ in range(REPEATS):
            ours = run_ours(case, law)
            long, short = (
                run_theirs(
                    replace(problem, law=law, steps=count), Choices(), Path(name), "timed", TIMEOUT
                ).seconds
                for count in (MEASURED, SHORTER)
            )
            steps.append((ours.march_seconds / STEPS, (long - short) / (MEASURED - SHORTER)))
            # The steps that are not measured are like the last ones, which are the cheapest.
            wholes.append((ours.seconds, long + (STEPS - MEASURED) * steps[-1][1]))
    mesh = "the coarse machine (100 mm), staggered, one thread on both sides"
    yield _row(
        "march-vs-calculix-step",
        [(1e3 * ours, 1e3 * theirs) for ours, theirs in steps],
        "ms",
        f"one coupled step of {mesh}, without set-up; {PROGRAM}: {MEASURED} steps less {SHORTER}",
    )
    yield _row(
        "march-vs-calculix",
        wholes,
        "s",
        f"{STEPS} coupled steps of {mesh}, set-up included; {PROGRAM} measured on {MEASURED} "
        f"steps, the others as the last {MEASURED - SHORTER} of them",
    )


def _row(name: str, pairs: list[tuple[float, float]], unit: str, note: str) -> Row:
    return Row(
        name,
        median(ours for ours, _ in pairs),
        median(theirs for _, theirs in pairs),
        median(theirs / ours for ours, theirs in pairs),
        unit,
        f"{note}; median of {len(pairs)}",
    )
