"""Aim and limits of a design question, measured on the figures of its cases."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fesim.batch.study import Study, Values
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.optimisation.search import Search
from thermojoint.optimisation.settings import DesignFile, LimitSection, is_magnitude
from thermojoint.sensitivity.results import figures_of_rows

if TYPE_CHECKING:
    import pandas as pd


def sizes_of(names: Sequence[str], figures: Array) -> Array:
    """Return figures (..., names), with displacements, which have a sign, as magnitudes."""
    signed = np.array([is_magnitude(name) for name in names])
    return np.where(signed, np.abs(figures), figures)


def figures_in(
    given: DesignFile, study: Study, rows: Sequence[Values], summary: pd.DataFrame
) -> Array:
    """Return the figures of a question for each row's case, as magnitudes, shape (rows, figures).

    Missing figures are NaN.

    Raises
    ------
    InputError
        The cases have results, but no such figure.
    """
    done = summary[summary["status"] == "done"]
    for name in given.names:
        if len(done) and done[name].isna().all():
            raise InputError(f"{given.case}: its cases have no figure {name!r}; take another one")
    return sizes_of(given.names, figures_of_rows(study, rows, summary, given.names))


def measured(given: DesignFile, figures: Array) -> Array:
    """Return the minimised aim, and the excess over each limit, shape (cases, 1 + limits).

    Parameters
    ----------
    given : DesignFile
        The question.
    figures : ndarray, shape (cases, 1 + limits)
        Its figures (`DesignFile.names`), as magnitudes.
    """
    aim = figures[:, :1] if given.minimise else -figures[:, :1]
    over = [_excess(limit, figures[:, at]) for at, limit in enumerate(given.limits, start=1)]
    return np.column_stack([aim, *over])


def _excess(limit: LimitSection, figure: Array) -> Array:
    """Excess over a limit relative to the limit; not positive where the limit holds."""
    ends = (1.0, limit.at_most), (-1.0, limit.at_least)
    over = [sign * (figure - end) / (abs(end) or 1.0) for sign, end in ends if end is not None]
    return np.asarray(np.max(over, axis=0))


def holds(limit: LimitSection, figure: float) -> bool:
    """Whether a figure is within a limit."""
    return bool(_excess(limit, np.array([figure]))[0] <= 0.0)


def entries_of(
    given: DesignFile, found: Array, full: Array, own: Array | None
) -> list[dict[str, Any]]:
    """Return an entry for the aim and every limit: optimum, its full march, and present design."""
    entries = []
    for at, name in enumerate(given.names):
        limit = given.limits[at - 1] if at else None
        entries.append(
            {
                "figure": name,
                "at_least": limit.at_least if limit else None,
                "at_most": limit.at_most if limit else None,
                "now": None if own is None else _known(own[at]),
                "found": float(found[at]),
                "full_march": _known(full[at]),
                "holds": limit is None or all(holds(limit, float(v[at])) for v in (found, full)),
            }
        )
    return entries


def _known(figure: float) -> float | None:
    return None if np.isnan(figure) else float(figure)


def history_of(done: Search) -> list[dict[str, Any]]:
    """Return the best case after each generation."""
    entries = []
    for count in done.sizes:
        if (best := done.best(count)) is not None:
            held = bool((done.measured[best, 1:] <= 0.0).all())
            aim = float(done.figures[best, 0])
            entries.append({"cases": count, "aim": aim, "holds": held, "values": done.rows[best]})
    return entries


def figures_by_name(names: Sequence[str], values: Values, figures: dict[str, float]) -> Array:
    """Return figures of one case as magnitudes; a varied value counts as a figure of its own."""
    every = figures | values
    return sizes_of(names, np.array([every.get(name, np.nan) for name in names]))
