"""The march in machine code against the plain version in NumPy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.performance.cases import reference_case, with_contacts
from benchmarks.performance.marching import plainly
from benchmarks.performance.timing import Row, paired
from fesim.case.schema import Case
from fesim.joint.gap import solve_gap
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate

#: Along and across.
GRIDS = ((9, 3), (24, 8))
REPEATS = 3


def plain_solver(setup: Setup) -> Setup:
    """Return the same set-up, its steps taken plainly with `fesim.joint.gap.solve_gap`."""
    contact = replace(setup.machine.contact)
    # Where a cached property keeps its value.
    vars(contact)["settle"] = partial(solve_gap, contact.gap_problem, tolerance=contact.tolerance)
    return replace(setup, machine=replace(setup.machine, contact=contact))


def rows() -> Iterator[Row]:
    """Yield compiled-vs-plain for few and for many contact elements."""
    for along, across in GRIDS:
        yield compared(with_contacts(reference_case(), along, across), REPEATS)


def compared(case: Case, repeats: int) -> Row:
    """Return the row of one case."""
    compiled = set_up(case)
    plain = plain_solver(compiled)
    first = simulate(case, setup=compiled).response
    second = plainly(case, plain)
    difference = np.abs(first["displacement"] - second["displacement"]).max().item()
    contacts = compiled.machine.contact.count
    times = paired(lambda: simulate(case, setup=compiled), lambda: plainly(case, plain), repeats)
    return Row(
        f"compiled-vs-plain-{contacts}",
        *times,
        "s",
        f"{first.sizes['time'] - 1} steps with {contacts} contact elements, set up before; largest "
        f"difference in displacement {difference:.1e} m; median of {repeats}",
    )
