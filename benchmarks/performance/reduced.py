"""The march on the reduced thermal model against the full order: time, error, set-up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr

from benchmarks.performance.cases import fresh_condensations, reference_machine
from benchmarks.performance.timing import Row, paired
from fesim.case.schema import Case, step_count
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate
from thermojoint.paper.inputs import VALIDATION

REPEATS = 3
#: Largest errors asked for: displacement, um; temperature, mK; pressure, of its peak.
ALLOWED = {"displacement": 0.002, "temperature": 1.0, "pressure": 1e-3}
UNITS = {"displacement": "µm", "temperature": "mK", "pressure": "1"}


@dataclass(frozen=True)
class Errors:
    """Largest differences over a run: displacement, um; temperature, mK; pressure, of its peak.

    `pascal` is the pressure's in Pa.
    """

    displacement: float
    temperature: float
    pressure: float
    pascal: float


def errors(full: xr.Dataset, reduced: xr.Dataset) -> Errors:
    """Compare two responses to one case."""

    def largest(name: str) -> float:
        return float(np.abs(full[name].to_numpy() - reduced[name].to_numpy()).max())

    pascal = largest("pressure")
    return Errors(
        displacement=1e6 * largest("displacement"),
        temperature=1e3 * largest("temperature"),
        pressure=pascal / float(full["pressure"].max()),
        pascal=pascal,
    )


def rows(repeats: int = REPEATS) -> Iterator[Row]:
    """Yield the rows of the reduced model on the equal-heights machine with all its candidates."""
    case = reference_machine()
    full_case = case.model_copy(update={"march": case.march.model_copy(update={"thermal": "full"})})
    setups: dict[str, Setup] = {}

    def prepare(which: str, given: Case) -> None:
        setups[which] = set_up(given)

    times = paired(partial(prepare, "reduced", case), partial(prepare, "full", full_case), repeats)
    reduced, full = setups["reduced"], setups["full"]
    modes = 0 if reduced.modes is None else reduced.modes.rates.size
    size = f"{modes} modes for {reduced.spaces.heat.N} temperatures"
    yield Row(
        "reduced-set-up",
        *times,
        "s",
        f"set-up of the equal-heights machine with the reduced model ({size}) against the full "
        f"one, nothing kept from before; median of {repeats}",
    )
    yield from marches(case, reduced, full, repeats)
    yield kept(case, repeats)


def marches(case: Case, reduced: Setup, full: Setup, repeats: int) -> Iterator[Row]:
    """Yield the time of a run that is set up, and the largest errors over the validation cases."""
    runs = [case.model_copy(update={"heat_input": heat}) for heat in VALIDATION.values()]
    steepest = runs[list(VALIDATION).index("step-3.0")]
    simulate(steepest, setup=reduced)
    steps = step_count(case.march)
    yield Row(
        "reduced-vs-full",
        *paired(
            lambda: simulate(steepest, setup=reduced),
            lambda: simulate(steepest, setup=full),
            repeats,
        ),
        "s",
        f"{steps} coupled steps at heat input 3, set up before, response collected; median of "
        f"{repeats}",
    )
    found = [
        errors(simulate(run, setup=full).response, simulate(run, setup=reduced).response)
        for run in runs
    ]
    pascal = max(one.pascal for one in found)
    for name, allowed in ALLOWED.items():
        worst = max(getattr(one, name) for one in found)
        more = f", {pascal:.3g} Pa" if name == "pressure" else ""
        yield Row(
            f"reduced-error-{name}",
            worst,
            allowed,
            allowed / worst,
            UNITS[name],
            f"largest difference from the full order over {', '.join(VALIDATION)}{more}; other: "
            "the limit",
        )


def kept(case: Case, repeats: int) -> Row:
    """Return the row of a set-up that finds its condensation on the disk."""
    with fresh_condensations():
        set_up(case)
        ours = partial(set_up, case)

        def other() -> None:
            with fresh_condensations():
                set_up(case)

        return Row(
            "set-up-kept",
            *paired(ours, other, repeats),
            "s",
            "set-up of the equal-heights machine with its condensation on the disk from an earlier "
            f"run against an empty folder; median of {repeats}",
        )
