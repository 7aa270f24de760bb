"""Set-up: reuse after a change of the heat, many contact elements, large structures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from benchmarks.performance.cases import (
    condensations,
    fresh_condensations,
    reference_case,
    reference_machine,
    with_elements,
)
from benchmarks.performance.scaling import LARGE_LIMIT, Size, free_memory, measured_once
from benchmarks.performance.timing import Row, Skipped, paired, seconds
from fesim.case.schema import Case
from fesim.setup.machine import set_up

REPEATS = 3
#: Element edges of the milling machine of 589 000 displacements, mm.
LARGE = "16.5"
#: Those of the largest one, and next to its joint.
LARGEST = ["--elements", "8.76", "--joint-elements", "7.2"]
#: Time for the largest structure, s.
LONGEST = 1800.0
#: Contact elements along and across each of five joints; elements along each edge of a joint.
PILLAR = ["--pillar", "20", "20", "12"]


def changed_rows(repeats: int = REPEATS, machine: Case | None = None) -> Iterator[Row]:
    """Yield the rows of a set-up of which only source, film or temperature probes changed."""
    case = machine or reference_machine()
    surfaces = ["rear", "interior", "exterior"]
    changes: dict[str, list[Case]] = {
        "source": [heated_at(case, surfaces[k % 3]) for k in range(repeats)],
        "film": [with_film(case, 7.0 + k) for k in range(repeats)],
        "probe": [read_at(case, 400.0 + k) for k in range(repeats)],
    }
    for name, cases in changes.items():
        with fresh_condensations():
            set_up(case)
            yield Row(
                f"setup-changed-{name}",
                *paired(partial(_kept, iter(cases)), partial(_anew, iter(cases)), repeats),
                "s",
                f"set-up of the equal-heights machine with another {name} and the rest on the disk "
                f"against an empty folder; median of {repeats}",
            )


def _kept(cases: Iterator[Case]) -> None:
    set_up(next(cases))


def _anew(cases: Iterator[Case]) -> None:
    with condensations("off"):
        set_up(next(cases))


def heated_at(case: Case, surface: str) -> Case:
    """Return a case whose source is on another surface."""
    (name,) = case.sources
    source = case.sources[name].model_copy(update={"surface": surface})
    return case.model_copy(update={"sources": {name: source}})


def with_film(case: Case, film: float) -> Case:
    """Return a case with another film, W/(m2 K)."""
    return case.model_copy(update={"convection_W_m2K": {"exterior": film}})


def read_at(case: Case, height: float) -> Case:
    """Return a case with one more temperature probe, at some height (mm)."""
    probe = {"position_mm": [625.0, height, 87.5], "body": "column"}
    data = case.model_dump()
    return Case.model_validate(data | {"probes": data["probes"] | {"T9": probe}})


def changed_large_rows() -> Iterator[Row]:
    """Yield the row of a set-up of 589 000 displacements of which only the source changed."""
    case = with_elements(reference_case(), float(LARGE), None)
    with fresh_condensations():
        whole = seconds(lambda: set_up(case))
        again = seconds(lambda: set_up(heated_at(case, "rear")))
    yield Row(
        "setup-changed-589k",
        again,
        whole,
        whole / again,
        "s",
        "set-up of 589 000 displacements with another source and the rest on the disk against an "
        "empty folder; measured once",
    )


def contact_rows() -> Iterator[Row | Skipped]:
    """Yield the rows of 2 000 contact elements in five joints."""
    yield from _against_plain("contacts-2000", PILLAR)


def large_rows() -> Iterator[Row | Skipped]:
    """Yield the rows of a structure of 589 000 displacements."""
    yield from _against_plain("setup-589k", ["--elements", LARGE])


def largest_rows() -> Iterator[Row | Skipped]:
    """Yield the row of the largest structure that the memory and the time allowed hold."""
    one = _size("setup-largest", LARGEST, LARGE_LIMIT)
    if isinstance(one, Skipped):
        yield one
        return
    note = (
        f"{one.unknowns} displacements, {one.temperatures} temperatures, {one.modes} modes, "
        f"{one.memory:.1f} GB; other: the time limit; measured once"
    )
    yield Row("setup-largest", one.setup, LONGEST, LONGEST / one.setup, "s", note)


def _against_plain(name: str, options: list[str]) -> Iterator[Row | Skipped]:
    """Yield set-up time and memory against one factor of the whole stiffness."""
    ours, plain = (
        _size(name, [*options, *way], LARGE_LIMIT if way else 0.0) for way in ([], ["--plain"])
    )
    if isinstance(ours, Skipped):
        yield ours
        return
    if isinstance(plain, Skipped):
        yield plain
        return
    how = (
        f"{ours.unknowns} displacements, {ours.contacts} contact elements, {ours.modes} modes, "
        "against one stiffness assembled form by form and factorised at once, reduced thermal "
        "model the same; measured once"
    )
    yield Row(name, ours.setup, plain.setup, plain.setup / ours.setup, "s", how)
    yield Row(f"{name}-memory", ours.memory, plain.memory, plain.memory / ours.memory, "GB", how)
    if ours.contacts > 1000:
        limit = 80.0
        note = f"a step of the same, {ours.contacts} contact elements; other: the limit"
        yield Row(f"{name}-step", ours.step, limit, limit / ours.step, "ms", note)


def _size(name: str, options: list[str], needed: float) -> Size | Skipped:
    free = free_memory()
    if free is not None and free < needed:
        return Skipped(name, f"{needed:.0f} GB are needed, {free:.0f} GB are free")
    one = measured_once(options)
    return Skipped(name, one) if isinstance(one, str) else one
