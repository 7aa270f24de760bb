"""Comparison of the estimators' errors, as a table and in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from thermojoint.paper import paper_values

if TYPE_CHECKING:
    from estimator.rows import Row

#: Estimators compared with the paper's accuracy, with their display names.
CLAIMED = {"fchs": "FCHS", "joint-aware": "joint-aware"}

#: Case and axis.
Key = tuple[str, str]


@dataclass(frozen=True)
class CaseErrors:
    """Largest errors of every estimator in one case along one axis, µm."""

    case: str
    axis: str
    #: Errors in the order of the table's estimators.
    errors: tuple[float, ...]
    #: Value that the paper reports for its machine.
    paper: float | None


@dataclass(frozen=True)
class ErrorTable:
    """Largest errors of all estimators."""

    #: The columns.
    estimators: tuple[str, ...]
    #: The lines.
    rows: tuple[CaseErrors, ...]


def error_table(rows: Sequence[Row]) -> ErrorTable:
    """Return the largest errors of all estimators as a table."""
    estimators = tuple(dict.fromkeys(str(row["estimator"]) for row in rows))
    rows_by_key: dict[Key, dict[str, Row]] = {}
    for row in rows:
        rows_by_key.setdefault(_key(row), {})[str(row["estimator"])] = row
    return ErrorTable(
        estimators,
        tuple(
            CaseErrors(
                case,
                axis,
                tuple(largest_error(each[name]) for name in estimators),
                next((claim for row in each.values() if (claim := paper_claim(row))), None),
            )
            for (case, axis), each in rows_by_key.items()
        ),
    )


def paper_claim(row: Row) -> float | None:
    """Return the largest error (µm) the paper reports for a row of the validation, if it does."""
    if row["estimator"] not in CLAIMED or row["axis"] not in paper_values.TABLE1_DEFORMATION:
        return None
    return paper_values.VALIDATION_ERROR_UM.get(str(row["case"]))


def largest_error(row: Row) -> float:
    """Return the largest error of a row, µm."""
    value = row["max_abs_error_um"]
    return math.nan if value is None else float(value)


def verdict(rows: Sequence[Row]) -> str:
    """Compare FCHS and the joint-aware estimator with the paper and the linear model, in words."""
    return " ".join(text for name in CLAIMED if (text := _reached(rows, name)))


def _reached(rows: Sequence[Row], name: str) -> str:
    """Return a description of one estimator's accuracy; empty if it was not validated."""
    own_rows = [row for row in rows if row["estimator"] == name]
    if not own_rows:
        return ""
    linear = {_key(row): largest_error(row) for row in rows if row["estimator"] == "linear"}
    error = {_key(row): largest_error(row) for row in own_rows}
    near = {_key(row): claim for row in own_rows if (claim := paper_claim(row)) is not None}
    reached = [key for key, claim in near.items() if error[key] <= claim]
    missed = [key for key in near if key not in reached]
    both = [key for key in error if key in linear]
    worse = [key for key in both if error[key] > linear[key]]

    sentences = []
    if near:
        sentences.append(
            f"The {CLAIMED[name]} estimator's largest error is within what the paper reports of "
            f"its own machine in {len(reached)} of {len(near)} rows{_listed(reached)}."
        )
    if missed:
        sentences.append(f"It is not in {_against(missed, error, near)}.")
    if both:
        sentences.append(
            f"The linear model alone has a larger error than {CLAIMED[name]}, from the same "
            f"temperatures, in {len(both) - len(worse)} of {len(both)}."
        )
    if worse:
        sentences.append(f"It has the smaller one in {_against(worse, error, linear)}.")
    return " ".join(sentences)


def _key(row: Row) -> Key:
    return str(row["case"]), str(row["axis"])


def _against(keys: Sequence[Key], error: dict[Key, float], other: dict[Key, float]) -> str:
    """Return rows with both figures as text, e.g. "triangle x (0.2 against 0.1 µm)"."""
    rows = [
        f"{case} {axis} ({error[case, axis]:.3g} against {other[case, axis]:.3g} µm)"
        for case, axis in keys
    ]
    return ", ".join(rows)


def _listed(keys: Sequence[Key]) -> str:
    """Return cases with their axes as text, e.g. ": triangle x and y"."""
    axes: dict[str, list[str]] = {}
    for case, axis in keys:
        axes.setdefault(case, []).append(axis)
    cases = [f"{case} {' and '.join(names)}" for case, names in axes.items()]
    return f": {', '.join(cases)}" if cases else ""
