"""Set-up time, peak memory and step time over mesh sizes and numbers of contact elements."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from benchmarks.performance.cases import reference_case, with_elements
from benchmarks.performance.timing import Row, Skipped
from fesim.setup.parts import make_parts
from fesim.solid.spaces import make_spaces

#: Element edges of the milling machine, mm: 22 000 to 590 000 displacement unknowns.
ELEMENTS = (50.0, 25.0, 20.0, 16.5)
#: Contact elements along and across each strip, on the reference mesh.
CONTACTS = ((9, 3), (15, 5), (24, 8), (36, 12))
REFERENCE_MESH = ["--elements", "50", "--joint-elements", "25"]
#: Most memory allowed, GB.
REFERENCE_LIMIT, LARGE_LIMIT = 4.0, 20.0
#: A size whose set-up takes longer than this is measured once, s.
LONG, REPEATS = 60.0, 3
#: Memory grows faster than the unknowns, with about this power of them.
MEMORY_POWER = 4.0 / 3.0


@dataclass(frozen=True)
class Size:
    """One measured size."""

    #: Displacement and temperature unknowns, contact elements, modes of the reduced model.
    unknowns: int
    temperatures: int
    contacts: int
    modes: int
    #: s.
    setup: float
    #: Peak of the process, GB.
    memory: float
    #: ms.
    step: float
    #: How often it was measured.
    repeats: int = 1


def mesh_rows() -> Iterator[Row | Skipped]:
    """Yield the rows over mesh sizes, and those of the memory."""
    reference = measured([*REFERENCE_MESH, "--candidates"])
    if isinstance(reference, str):
        yield Skipped("memory-reference", reference)
    else:
        yield memory_row("memory-reference", reference, REFERENCE_LIMIT)
    smallest: Size | None = None
    largest: Size | None = None
    for element in ELEMENTS:
        name = f"{element:g}-mm"
        found = lacking_memory(element, largest) if largest else None
        one = found or measured(["--elements", str(element)])
        if isinstance(one, str):
            yield Skipped(f"scaling-{name}", one)
            if element == ELEMENTS[-1]:
                yield Skipped("memory-500k", one)
            continue
        if smallest is not None:
            yield from against(one, smallest, f"{round(1e-3 * one.unknowns)}k", one.unknowns)
        smallest, largest = smallest or one, one
        if element == ELEMENTS[-1]:
            yield memory_row("memory-500k", one, LARGE_LIMIT)


def contact_rows() -> Iterator[Row | Skipped]:
    """Yield the rows over numbers of contact elements."""
    fewest: Size | None = None
    for along, across in CONTACTS:
        one = measured([*REFERENCE_MESH, "--contacts", str(along), str(across)])
        if isinstance(one, str):
            yield Skipped(f"scaling-{along * across}-contacts", one)
        elif fewest is None:
            fewest = one
        else:
            yield from against(one, fewest, f"{one.contacts}-contacts", one.contacts)


def against(one: Size, smallest: Size, name: str, size: int) -> Iterator[Row]:
    """Yield set-up time, memory and step time of one size against the smallest."""
    mesh = name.endswith("k")
    grown = size / (smallest.unknowns if mesh else smallest.contacts)
    how = f"median of {one.repeats}" if one.repeats > 1 else "measured once"
    for what, unit in (("setup", "s"), ("memory", "GB"), ("step", "ms")):
        ours, other = getattr(one, what), getattr(smallest, what)
        yield Row(
            f"scaling-{what}-{name}",
            ours,
            other,
            other / ours,
            unit,
            f"{one.unknowns} displacements, {one.contacts} contact elements, {one.modes} modes, "
            f"against {smallest.unknowns}, {smallest.contacts}, {smallest.modes}: "
            f"{'unknowns' if mesh else 'contact elements'} x {grown:.1f}, this x "
            f"{ours / other:.1f}; {how}",
        )


def memory_row(name: str, one: Size, limit: float) -> Row:
    """Return the row of the peak memory against what is allowed."""
    return Row(
        name,
        one.memory,
        limit,
        limit / one.memory,
        "GB",
        f"peak of a process that sets up {one.unknowns} displacements and {one.temperatures} "
        f"temperatures with {one.contacts} contact elements in {one.setup:.0f} s; other: what is "
        "allowed",
    )


def lacking_memory(element: float, last: Size) -> str | None:
    """Say why a mesh is not measured, if the memory that is free will not hold it."""
    free = free_memory()
    if free is None:
        return None
    structure = make_parts(with_elements(reference_case(), element, None)).structure
    unknowns = make_spaces(structure.mesh).displacement_size
    needed = last.memory * (unknowns / last.unknowns) ** MEMORY_POWER
    if needed <= free:
        return None
    return f"{unknowns} displacements need about {needed:.0f} GB, {free:.0f} GB are free"


def free_memory(table: Path = Path("/proc/meminfo")) -> float | None:
    """Memory that a new process may take, GB; None where the system does not say."""
    if not table.exists():
        return None
    for line in table.read_text("ascii").splitlines():
        if line.startswith("MemAvailable:"):
            return 1.024e-6 * float(line.split()[1])
    return None


def measured(options: list[str]) -> Size | str:
    """Measure one size in processes of its own; return why not if it does not come to its end."""
    found: list[Size] = []
    while len(found) < (1 if found and found[0].setup > LONG else REPEATS):
        one = measured_once(options)
        if isinstance(one, str):
            return one
        found.append(one)
    return replace(
        found[0],
        setup=median(one.setup for one in found),
        memory=median(one.memory for one in found),
        step=median(one.step for one in found),
        repeats=len(found),
    )


def measured_once(options: list[str]) -> Size | str:
    """Measure one size in a process of its own; return why not if it does not come to its end."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.performance.one_size", *options],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["killed, perhaps for want of memory"]
        return f"the process ended with {done.returncode}: {last[0]}"
    return Size(**json.loads(done.stdout))
