"""The scored machines of the studies, as JSON and as a page of Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reference_machine.observables import observables_of
from benchmarks.reference_machine.score import OUT, STATEMENTS, TOLD, WORST, misses, score
from fesim.batch.folder import response_path
from fesim.batch.study import Study, StudyCase
from thermojoint.artefacts.response import read_response

#: Varied alike in every study: no part of what a machine is.
SHARED = {"heat_input", "probes", "candidates"}
#: The responses that a machine is judged by.
INPUTS = {"0.5", "1.0", "2.0", "3.0", "triangle"}


@dataclass(frozen=True)
class Machine:
    """One variant and how it is judged."""

    #: The varied values by their path in the case file.
    values: dict[str, Any]
    #: See `benchmarks.reference_machine.score.score`.
    score: float
    #: By name; the misses in tolerances. None where a machine has no such value.
    observables: dict[str, float | None]
    misses: dict[str, float]


def input_name(heat: dict[str, Any]) -> str:
    """Return what a heat input is called among `INPUTS`."""
    return "triangle" if heat["kind"] == "triangle" else f"{heat['level']:.1f}"


def machines_of(study: Study) -> dict[tuple[Any, ...], dict[str, StudyCase]]:
    """Return the cases of a study by machine (its varied values), and those by heat input."""
    found: dict[tuple[Any, ...], dict[str, StudyCase]] = {}
    for one in study.cases:
        machine = tuple(value for path, value in one.values.items() if path not in SHARED)
        found.setdefault(machine, {})[input_name(one.values["heat_input"])] = one
    return found


def scored(study: Study, folder: Path) -> Iterator[Machine]:
    """Yield the machines of a study whose responses are all in a batch's folder."""
    for cases in machines_of(study).values():
        paths = {name: response_path(folder, one.id) for name, one in cases.items()}
        if set(paths) < INPUTS or not all(path.is_file() for path in paths.values()):
            continue
        seen = observables_of({name: read_response(path) for name, path in paths.items()})
        values = next(iter(cases.values())).values
        yield Machine(
            {path: value for path, value in values.items() if path not in SHARED},
            score(seen),
            {name: None if np.isnan(value) else value for name, value in seen.items()},
            misses(seen),
        )


def as_json(machines: Sequence[Machine]) -> dict[str, Any]:
    """Return what is written: the statements that are scored, and the machines."""
    statements = [
        {
            "name": one.name,
            "printed": one.printed,
            "distance": one.distance.__name__,
            "tolerance": one.tolerance,
            "where": one.where,
        }
        for one in STATEMENTS
    ]
    return {"statements": statements, "machines": [asdict(one) for one in machines]}


def as_markdown(machines: Sequence[Machine]) -> str:
    """Return the machines as a table, best first; in bold what comes out.

    Only values that differ from machine to machine have a column.
    """
    if not machines:
        return "No machine of this study is finished.\n"
    varied = [path for path in machines[0].values if len({m.values[path] for m in machines}) > 1]
    heads = [_short(path) for path in varied]
    heads += [
        "score",
        "δ x / y, µm",
        "δ_NL x / y, µm",
        *(one.heading for one in (*STATEMENTS, *TOLD)),
    ]
    printed = [
        *[""] * len(varied),
        "printed",
        "",
        "",
        *(f"{one.printed:g}" for one in (*STATEMENTS, *TOLD)),
    ]
    rows = [heads, ["---"] * len(heads), printed]
    rows += [_row(one, varied) for one in sorted(machines, key=lambda one: one.score)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in rows)


def _row(machine: Machine, varied: Sequence[str]) -> list[str]:
    seen = machine.observables
    cells = [
        f"{value:g}" if isinstance(value, float) else str(value)
        for value in (machine.values[path] for path in varied)
    ]
    cells += [f"{machine.score:.2f}"]
    cells += [
        f"{seen[f'{kind}_x_um']:.1f} / {seen[f'{kind}_y_um']:.1f}"
        for kind in ("total", "nonlinear")
    ]
    for one in (*STATEMENTS, *TOLD):
        value = seen[one.name]
        text = "–" if value is None else f"{value:.3g}"
        cells.append(f"**{text}**" if machine.misses.get(one.name, WORST) <= OUT else text)
    return cells


def _short(path: str) -> str:
    """Return the end of a path that tells it from others: of a material also its name."""
    parts = path.split(".")
    return ".".join(parts[1:]) if parts[0] == "materials" else parts[-1]
