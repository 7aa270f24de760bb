"""What is compared, and what is varied to find the cause of each difference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.against_calculix.compare import (
    Agreement,
    agreement,
    comparable,
    our_values,
    ride_ours,
    run_ours,
    run_theirs,
    values,
)
from benchmarks.against_calculix.deck import Choices
from benchmarks.against_calculix.elements import element_of, node_basis
from benchmarks.against_calculix.problem import problem_of
from benchmarks.against_calculix.run import Run
from benchmarks.against_calculix.structures import bars, knee, machine
from fesim.case.schema import Case
from thermojoint.artefacts.errors import ConvergenceError

#: Linear normal law and linear conductance: CalculiX has both without a table's error.
LINEAR = {
    "joints__joint__normal_law": "back-burdekin",
    "joints__joint__back_burdekin": {"coefficient_um": 0.1, "exponent": 1.0},
    "joints__joint__conductance": {"law": "constants", "constant": 1.45, "exponent": 1.0},
}
#: So tight that CalculiX's iterations do not show in a difference.
TIGHT = 1e-5
#: Steps so long that the transient is over at the end.
STEADY = {"march__step_s": 1e8, "march__duration_min": 40e8 / 60.0}
#: 30 steps of a minute, for the coarse machine: the heat has passed through its elements.
LONG = {"march__step_s": 60.0, "march__duration_min": 30.0}
#: Twice the contact elements of the equal-heights machine each way.
MORE_CONTACTS = {"joints__knee__along": 18, "joints__knee__across": 6}
#: Where the knee stands, mm, and its elements.
KNEE, KNEE_SIZE = (-100.0, 50.0, 200.0), 100.0
#: Of a run, s.
TIMEOUT = 1800.0


@dataclass(frozen=True)
class Comparison:
    """One row."""

    #: What was run.
    study: str
    variant: str
    #: How far both sides differ at the end; None where CalculiX did not run or finish.
    agreement: Agreement | None
    #: Figures at the end: see `our_values`; empty where a side did not run.
    ours: dict[str, float]
    ccx: dict[str, float]
    #: Wall time of our side, and of its march alone.
    ours_seconds: float
    march_seconds: float
    #: Wall time of CalculiX.
    ccx_seconds: float
    #: CalculiX's increments and iterations, those that set the preload included.
    steps: int
    iterations: int
    #: Why it did not finish.
    note: str = ""


def compared(
    case: Case,
    choices: Choices,
    folder: Path,
    labels: tuple[str, str],
    *,
    consistent: bool = False,
    run: Run | None = None,
) -> tuple[Comparison, Run]:
    """Run one case on both sides.

    `choices`: how CalculiX solves it. `folder`: where CalculiX's files go. `labels`: study and
    variant. `consistent`: see `run_ours`. `run`: CalculiX's run, if only our side changes.
    """
    problem = problem_of(case)
    problem = replace(problem, law=comparable(problem.law))
    name = "_".join(labels).replace(" ", "_").replace(",", "").replace(".", "_")
    theirs = run if run is not None else run_theirs(problem, choices, folder, name, TIMEOUT)
    ours = run_ours(case, problem.law, consistent=consistent)
    basis = node_basis(problem.structure, element_of(problem.structure, choices.element))
    row = Comparison(
        *labels,
        agreement(case, problem, ours, theirs, basis),
        our_values(ours.setup, ours.step),
        values(case, problem, basis, theirs),
        ours.seconds,
        ours.march_seconds,
        theirs.seconds,
        theirs.increments,
        theirs.iterations,
    )
    return row, theirs


def ours_alone(case: Case, labels: tuple[str, str]) -> Comparison:
    """Run one case on our side only."""
    ours = run_ours(case, comparable(problem_of(case).law))
    figures = our_values(ours.setup, ours.step)
    return Comparison(*labels, None, figures, {}, ours.seconds, ours.march_seconds, 0.0, 0, 0)


def two_bars(folder: Path) -> Iterator[Comparison]:
    """Steady heat flow through two bars that are held between walls."""
    choices = Choices(steady=True, tolerance=TIGHT)
    for variant, changes in (("linear law, h ~ p", LINEAR), ("exponential law, Eq. 11", {})):
        case = bars(folder, 0.05, **STEADY, **changes)
        yield compared(case, choices, folder, ("two bars", variant))[0]
    case = bars(folder, 0.05, **STEADY, **LINEAR)
    table = replace(choices, table_points=10)
    labels = ("two bars", "the linear law as a table")
    try:
        yield compared(case, table, folder, labels)[0]
    except ConvergenceError as error:
        yield Comparison(*labels, None, {}, {}, 0.0, 0.0, 0.0, 0, 0, str(error))


def two_rods(folder: Path) -> Iterator[Comparison]:
    """The bars in time, 60 steps of 2 s, on finer and finer meshes."""
    choices = Choices(tolerance=TIGHT)
    for size in (0.02, 0.01, 0.005):
        case = bars(folder, size)
        mesh = f"{1e3 * size:g} mm"
        row, run = compared(case, choices, folder, ("two rods", f"elements {mesh}"))
        yield row
        labels = ("two rods", f"elements {mesh}, consistent capacity")
        yield compared(case, choices, folder, labels, consistent=True, run=run)[0]
    labels = ("two rods", "elements 10 mm, steps 1 s")
    yield compared(bars(folder, 0.01, march__step_s=1.0), choices, folder, labels)[0]


def moving_knee(folder: Path) -> Iterator[Comparison]:
    """A knee that stands on its axis, steady: against CalculiX on the machine meshed there."""
    choices = Choices(steady=True, tolerance=TIGHT, patience=60)
    for position in KNEE:
        riding, meshed = knee(KNEE_SIZE, position)
        problem = problem_of(meshed)
        problem = replace(problem, law=comparable(problem.law))
        labels = "machine, moving knee", f"at {position:g} mm, elements {KNEE_SIZE:g} mm"
        run = run_theirs(problem, choices, folder, f"knee_{position:g}", TIMEOUT)
        setup, step, seconds = ride_ours(riding, problem.law)
        basis = node_basis(problem.structure, element_of(problem.structure, choices.element))
        yield Comparison(
            *labels,
            None,
            our_values(setup, step),
            values(meshed, problem, basis, run),
            seconds,
            0.0,
            run.seconds,
            run.increments,
            run.iterations,
        )


def coarse_machine(folder: Path, *, fine: bool) -> Iterator[Comparison]:
    """The equal-heights machine at heat input 3.

    `folder`: where CalculiX's files go. `fine`: with the 50 mm mesh too, which takes CalculiX
    minutes.
    """
    choices = Choices(tolerance=TIGHT)
    study = "machine, 30 x 2 s"
    yield compared(machine(), choices, folder, (study, "100 mm"))[0]
    for size in (50.0, 25.0):
        yield ours_alone(machine(size), (study, f"{size:g} mm, ours alone"))
    if fine:
        yield compared(machine(50.0), choices, folder, (study, "50 mm"))[0]
    study = "machine, 30 x 60 s"
    row, run = compared(machine(**LONG), choices, folder, (study, "100 mm"))
    yield row
    labels = (study, "100 mm, consistent capacity")
    yield compared(machine(**LONG), choices, folder, labels, consistent=True, run=run)[0]
    case = machine(**LONG, **MORE_CONTACTS)
    yield compared(case, choices, folder, (study, "100 mm, 18 x 6 contact elements"), run=run)[0]
    case = machine(**LONG, joints__knee__friction_coefficient=0.0)
    yield compared(case, choices, folder, (study, "100 mm, no friction"))[0]
    for size in (50.0, 25.0):
        yield ours_alone(machine(size, **LONG), (study, f"{size:g} mm, ours alone"))
    if fine:
        row, run = compared(machine(50.0, **LONG), choices, folder, (study, "50 mm"))
        yield row
        case = machine(50.0, **LONG, **MORE_CONTACTS)
        labels = (study, "50 mm, 18 x 6 contact elements")
        yield compared(case, choices, folder, labels, run=run)[0]
