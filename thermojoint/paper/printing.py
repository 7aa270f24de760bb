"""Terminal output of the reproduced tables and of the validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Column, Table

from thermojoint.console import number, numeric, rounded, titled
from thermojoint.paper import paper_values

if TYPE_CHECKING:
    from estimator.rows import Row
    from thermojoint.paper.summary import Convergence, PressureShare, SchemeErrors
    from thermojoint.paper.tables import PrintedTable
    from thermojoint.paper.verdict import ErrorTable


def show_tables(console: Console, tables: Sequence[PrintedTable]) -> None:
    """Print Tables 1-3 with the paper's values beside ours, and reasons for differences."""
    from thermojoint.paper.tables import NOTE

    for printed in tables:
        table = Table("parameter", "unit", *numeric("ours", "paper"))
        for block in printed.blocks:
            table.add_section()
            table.add_row(block.title, style="bold")
            for row in block.rows:
                table.add_row(
                    row.name,
                    row.unit,
                    f"{number(row.ours)}{' *' if row.at_bound else ''}",
                    number(row.paper),
                )
        titled(console, printed.title, table)
    console.print(NOTE)
    console.print(f"Paper: {paper_values.CITATION}.")


#: Possible columns of a table of errors, in their order: heading, key, factor and unit.
_ERRORS = (
    ("max error", "max_abs_error_um", 1.0, ""),
    ("rms error", "rms_error_um", 1.0, ""),
    ("rms uncompensated", "rms_uncompensated_um", 1.0, ""),
    ("rms error zeroed", "rms_error_zeroed_um", 1.0, ""),
    ("uncompensated zeroed", "rms_uncompensated_zeroed_um", 1.0, ""),
    ("peak", "peak_total_um", 1.0, ""),
    ("nonlinear peak", "peak_nonlinear_um", 1.0, ""),
    ("band", "mean_band_um", 1.0, ""),
    ("inside the band", "band_cover", 100.0, " %"),
    ("interval score", "interval_score_um", 1.0, ""),
)


def show_validation(console: Console, rows: Sequence[Row]) -> None:
    """Print the errors of estimators of any kind; columns without values are left out."""
    from thermojoint.paper.verdict import paper_claim

    held = [column for column in _ERRORS if any(column[1] in row for row in rows)]
    claims = [paper_claim(row) for row in rows]
    claimed = any(claim is not None for claim in claims)
    headings = [heading for heading, *_ in held] + ["paper's error"] * claimed
    names = [Column(name, no_wrap=True) for name in ("case", "estimator", "axis")]
    table = Table(*names, *numeric(*headings))
    for row, claim in zip(rows, claims, strict=True):
        cells = (_cell(row.get(key), factor, unit) for _, key, factor, unit in held)
        judged = (str(row[name]) for name in ("case", "estimator", "axis"))
        table.add_row(*judged, *cells, *([number(claim)] if claimed else []))
    titled(console, "Validation from temperatures alone (µm)", table)


def _cell(value: str | float | None, factor: float, unit: str) -> str:
    if value is None:
        return ""
    return f"{factor * float(value):.0f}{unit}" if unit else _figure(value)


def show_estimators(console: Console, table: ErrorTable) -> None:
    """Print the largest errors of all estimators, one line per case and axis."""
    names = [Column(name, no_wrap=True) for name in ("case", "axis")]
    estimators = (name.replace("-", "-\n") for name in (*table.estimators, "paper"))
    shown = Table(*names, *numeric(*estimators))
    for row in table.rows:
        shown.add_row(row.case, row.axis, *map(rounded, row.errors), number(row.paper))
    titled(console, "Largest error of the estimated displacement, from temperatures (µm)", shown)


def show_schemes(console: Console, rows: Sequence[SchemeErrors]) -> None:
    """Print the two ways of calibrating Eq. 18 beside the linear estimator."""
    schemes = numeric("linear", "FCHS, calibrated to steps", "FCHS, to estimated strengths")
    table = Table("case", "axis", *schemes)
    for row in rows:
        errors = (number(value, 3) for value in (row.linear, row.steps, row.estimated))
        table.add_row(row.case, row.axis, *errors)
    titled(console, "Largest error by the calibration of Eq. 18 (µm)", table)


def show_blocks(console: Console, rows: Sequence[Row]) -> None:
    """Print the contributions of the blocks of Figure 5 to the error."""
    if not rows:
        return
    table = Table("case", "driven by", "axis", *numeric("linear", "nonlinear", "total"))
    for row in rows:
        table.add_row(
            str(row["case"]),
            str(row["driven_by"]),
            str(row["axis"]),
            *(_figure(row[f"{part}_error_um"]) for part in ("linear", "nonlinear", "total")),
        )
    titled(console, "Largest error by what drives the blocks (µm)", table)


def show_convergence(console: Console, rows: Mapping[str, Convergence]) -> None:
    """Print the solver statistics of each response, then its thermal model."""
    solver = ("steps", "gap residual (m)", "heat balance", "iterations", "most", "cuts")
    table = Table("response", *numeric(*solver))
    for name, row in rows.items():
        table.add_row(
            name,
            str(row.steps),
            f"{row.gap_residual:.1e}",
            f"{row.heat_balance:.1e}",
            str(row.iterations),
            str(row.most_iterations),
            str(row.cuts),
        )
    titled(console, "Solver", table)
    # Responses of one run mostly share a set-up, whose line is printed once.
    for model in dict.fromkeys(row.thermal_model for row in rows.values()):
        console.print(f"Thermal model: {model}.")


def show_share(console: Console, share: PressureShare) -> None:
    """Print the share of the final pressure change of each contact element at a given time."""
    from thermojoint.paper.summary import STILL

    title = (
        f"Change of contact pressure after {share.at_s:g} s "
        f"(paper, under compression: {paper_values.PRESSURE_SHARE:.0%} of the final change)"
    )
    changes = (f"after {share.at_s:g} s (MPa)", "at the end (MPa)", "share")
    table = Table(*numeric("contact element", *changes))
    for row in share.rows:
        part = "–" if row.share is None else f"{round(100 * row.share)} %"
        table.add_row(str(row.contact), f"{row.early_MPa:+.2f}", f"{row.final_MPa:+.2f}", part)
    titled(console, title, table)
    console.print(f"No share where the final change is below {STILL:.0%} of the largest one.")


def _figure(value: str | float | None) -> str:
    """Return a figure of a row as text for a table."""
    return number(None if value is None else float(value), 3)
