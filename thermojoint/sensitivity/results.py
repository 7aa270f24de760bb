"""Results of a sensitivity study: figures of its cases, a table and a dictionary of all indices."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fesim.batch.study import Study, Values
from fesim.batch.summary import FIGURES
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.sensitivity.local import Effect
from thermojoint.sensitivity.measures import INDICES, MEASURES, STILL
from thermojoint.sensitivity.screening import Design, indices_of

if TYPE_CHECKING:
    import pandas as pd

#: Figures of a batch that describe the machine, not the solver.
PHYSICAL = (
    *(name for name in FIGURES if name.startswith("displacement_") and "final" in name),
    "temperature_max_K",
    "pressure_min_MPa",
    "pressure_max_MPa",
    "open_share_final",
    "bolt_force_min_N",
    *(name for name in FIGURES if name.startswith("displacement_") and "peak" in name),
)


def check_figures(asked: Sequence[str], known: Sequence[str], where: str) -> None:
    """Refuse unknown figures; `where` is the place that requests them.

    Raises
    ------
    InputError
        There is no such figure.
    """
    for name in asked:
        if name not in known:
            raise unknown_name("figure", name, known, where)


def physical(columns: Iterable[str]) -> list[str]:
    """Return the columns of a study allowed for `--figure`: `PHYSICAL`, and lines of axes."""
    return [*PHYSICAL, *(name for name in columns if name not in FIGURES)]


def chosen_figures(summary: pd.DataFrame, asked: Sequence[str]) -> list[str]:
    """Return the figures to evaluate: the requested ones, or all of `PHYSICAL` that change.

    The many figures over the stroke of a moving axis are only included on request.

    Raises
    ------
    InputError
        No case has a result, or a requested figure has no value.
    """
    wanted = dict.fromkeys((*PHYSICAL, *asked))
    have = [name for name in wanted if name in summary and summary[name].notna().any()]
    if not have:
        raise InputError(
            "no case has a result, so there are no effects; summary.csv has the reasons"
        )
    check_figures(asked, have, "--figure")
    changing = [name for name in have if np.ptp(summary[name].dropna()) > STILL]
    return list(asked) or changing or have


def figures_of_rows(
    study: Study, rows: Sequence[Values], summary: pd.DataFrame, names: Sequence[str]
) -> Array:
    """Return the figures of each row's case, shape (rows, figures); NaN without a result."""
    # A name may be that of a varied value, which a failed case has, too.
    done = summary[summary["status"] == "done"]
    by_id = done.set_index("id")[list(names)].astype(np.float64)
    ids = {_key(case.values): case.id for case in study.cases}
    return by_id.reindex([ids.get(_key(row)) for row in rows]).to_numpy()


def local_results(effects: Sequence[Effect], names: Sequence[str]) -> list[dict[str, Any]]:
    """Return an entry for each parameter and figure, sorted by effect within each figure."""
    entries = [
        {
            "figure": name,
            "path": effect.parameter.path,
            "value": effect.parameter.value,
            "per": effect.parameter.change,
            "change": float(effect.change[at]),
            "error": float(effect.error[at]),
        }
        for at, name in enumerate(names)
        for effect in effects
    ]
    return _ranked(entries, names, "change")


def screening_results(
    design: Design, figures: Array, names: Sequence[str]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return an entry for each range and figure, and the convergence of the first index.

    Raises
    ------
    InputError
        A case has no result.
    """
    missing = int(np.isnan(figures).any(axis=1).sum())
    if missing:
        raise InputError(
            f"{missing} of {len(figures)} cases have no result, so there are no indices; narrow "
            "the ranges that their reasons name (summary.csv), and run the command again"
        )
    entries, convergence = [], {}
    first, _ = MEASURES[design.method]
    for at, name in enumerate(names):
        stages = indices_of(design, figures[:, at])
        for number, span in enumerate(design.ranges):
            values = {index: stages[-1][index][number] for index in INDICES[design.method]}
            ends = {"low": span.low, "high": span.high}
            entries.append({"figure": name, "path": span.path, **ends, **values})
        convergence[name] = [{"samples": s["samples"], first: s[first]} for s in stages]
    return _ranked(entries, names, first), convergence


def _ranked(entries: list[dict[str, Any]], names: Sequence[str], by: str) -> list[dict[str, Any]]:
    place = {name: at for at, name in enumerate(names)}
    return sorted(entries, key=lambda entry: (place[entry["figure"]], -abs(entry[by])))


def _key(values: Values) -> str:
    return json.dumps(values, sort_keys=True)
