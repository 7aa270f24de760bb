"""The march against CalculiX: the same coarse machine, the same steps, one thread on both sides.

CalculiX iterates heat and contact within each increment. The march has two couplings: `staggered`,
the paper's and the default, in which the last step's pressure sets the conductance, and `iterated`,
which solves the equations of CalculiX's increment. Both are measured against the same runs of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.against_calculix.compare import Ours, comparable, run_ours, run_theirs
from benchmarks.against_calculix.deck import Choices
from benchmarks.against_calculix.problem import problem_of
from benchmarks.against_calculix.run import PROGRAM, available
from benchmarks.against_calculix.structures import machine
from benchmarks.against_calculix.studies import TIMEOUT
from benchmarks.performance.timing import Row, Skipped, medians
from fesim.case.schema import Case

STEPS, REPEATS = 1050, 3
#: Steps of the other side: a run, and a shorter one that tells what its steps alone cost.
MEASURED, SHORTER = 30, 10
#: Coupling of the march to what its rows are called.
NAMES = {"staggered": "march-vs-calculix", "iterated": "march-vs-calculix-iterated"}


@dataclass(frozen=True)
class Theirs:
    """CalculiX's side, s: a coupled step without set-up, and all steps with it."""

    step: float
    whole: float


def rows() -> Iterator[Row | Skipped]:
    """Yield a coupled step and a whole run with set-up, for both couplings of the march."""
    if not available():
        for name in NAMES.values():
            for row in (f"{name}-step", name):
                yield Skipped(row, f"no {PROGRAM} on the PATH; install it (Debian: calculix-ccx)")
        return
    cases = {coupling: long_case(coupling) for coupling in NAMES}
    problem = problem_of(cases["staggered"])
    problem = replace(problem, law=comparable(problem.law))
    # Libraries are loaded once, not in every run.
    run_ours(machine(march__duration_min=0.1), problem.law)
    pairs: dict[str, list[tuple[Ours, Theirs]]] = {coupling: [] for coupling in cases}
    with TemporaryDirectory() as name:
        for _ in range(REPEATS):
            ours = {coupling: run_ours(case, problem.law) for coupling, case in cases.items()}
            long, short = (
                run_theirs(
                    replace(problem, steps=count), Choices(), Path(name), "timed", TIMEOUT
                ).seconds
                for count in (MEASURED, SHORTER)
            )
            step = (long - short) / (MEASURED - SHORTER)
            # The steps that are not measured are like the last ones, which are the cheapest.
            theirs = Theirs(step, long + (STEPS - MEASURED) * step)
            for coupling, one in ours.items():
                pairs[coupling].append((one, theirs))
    for coupling, found in pairs.items():
        yield from compared(NAMES[coupling], cases[coupling], found)


def long_case(coupling: str) -> Case:
    """Return the coarse machine with all steps."""
    return machine(march__duration_min=2.0 * STEPS / 60.0, march__coupling=coupling)


def compared(name: str, case: Case, pairs: list[tuple[Ours, Theirs]]) -> Iterator[Row]:
    """Yield the rows of one coupling."""
    marches = (
        f"ours {case.march.coupling}, {case.march.thermal} thermal order, gap equations in NumPy "
        f"(machine code knows no exponential law); {PROGRAM} iterates within the increment, to its "
        "own tolerances; one thread on both sides"
    )
    yield _row(
        f"{name}-step",
        [(1e3 * ours.march_seconds / STEPS, 1e3 * theirs.step) for ours, theirs in pairs],
        "ms",
        f"a coupled step of the coarse machine (100 mm) without set-up; {marches}; {PROGRAM}: "
        f"{MEASURED} steps less {SHORTER}",
    )
    yield _row(
        name,
        [(ours.seconds, theirs.whole) for ours, theirs in pairs],
        "s",
        f"{STEPS} coupled steps of the coarse machine (100 mm), set-up included; {marches}; "
        f"{PROGRAM} measured on {MEASURED} steps, the others as the last {MEASURED - SHORTER} of "
        "them",
    )


def _row(name: str, pairs: list[tuple[float, float]], unit: str, note: str) -> Row:
    return Row(name, *medians(pairs), unit, f"{note}; median of {len(pairs)}")
