"""What the user sees: tables on standard output, progress and errors on the other one."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from thermojoint.paper import paper_values

if TYPE_CHECKING:
    import xarray as xr

    from estimator.joint_aware.placement import Placement
    from estimator.rows import Row
    from thermojoint.paper.summary import Convergence, PressureShare, SchemeErrors
    from thermojoint.paper.tables import PrintedTable
    from thermojoint.paper.verdict import ErrorTable

#: An axis with less than this part of the largest band does not move.
STILL = 1e-6
#: Called with (what is being worked on, done, in all).
Report = Callable[[str, int, int], None]


def out() -> Console:
    """Return the console for results, as wide as the terminal, or 100 columns in a file."""
    console = Console(highlight=False, markup=False)
    return console if console.is_terminal else Console(highlight=False, markup=False, width=100)


@contextmanager
def progress_bars() -> Iterator[Report]:
    """Give a function that shows one bar for each thing named; silent where there is no terminal.

    Yields
    ------
    callable
        To be called with (name, done, in all).
    """
    console = Console(stderr=True)
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )
    tasks: dict[str, TaskID] = {}

    def report(name: str, done: int, total: int) -> None:
        if name not in tasks:
            tasks[name] = bars.add_task(name, total=total)
        bars.update(tasks[name], completed=done, total=total)

    with bars:
        yield report


def say(text: str) -> None:
    """Print one line about what was done, on standard error."""
    print(text, file=sys.stderr, flush=True)


def warn(lines: Iterable[str]) -> None:
    """Print a line for each warning, on standard error."""
    for line in lines:
        say(f"warning: {line}")


def wrote(*paths: Path | None) -> None:
    """Say which files were written."""
    for path in paths:
        if path is not None:
            say(f"wrote {path}")


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as a table shows it; a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}g}"


def rounded(value: float) -> str:
    """Return a number with two digits that count, or as a whole number, never with an exponent."""
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"


def show_tables(console: Console, tables: Sequence[PrintedTable]) -> None:
    """Print Tables 1-3 with the paper's values beside ours, and why they may differ."""
    from thermojoint.paper.tables import NOTE

    for printed in tables:
        table = Table()
        table.add_column("parameter")
        table.add_column("unit")
        table.add_column("ours", justify="right")
        table.add_column("paper", justify="right")
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
        _titled(console, printed.title, table)
    console.print(NOTE)
    console.print(f"Paper: {paper_values.CITATION}.")


def show_test(console: Console, title: str, content: Mapping[str, Any]) -> None:
    """Print the parameters of a thermal test after ISO 230-3."""
    table = Table()
    table.add_column("parameter")
    for name in ("value", "unit", "from (min)", "to (min)"):
        table.add_column(name, justify="left" if name == "unit" else "right")
    for row in content["parameters"]:
        ends = (f"{row[key] / 60.0:.1f}" for key in ("begin_s", "end_s"))
        table.add_row(row["symbol"], number(row["value"]), row["unit"], *ends)
    _titled(console, title, table)


def show_loop(console: Console, content: Mapping[str, Any]) -> None:
    """Print margins and residuals of a closed loop."""
    design = content["design"]
    if design is not None:
        margins = Table()
        for name in ("delay (s)", "gain margin (dB)", "phase margin (°)", "more delay (s)"):
            margins.add_column(name, justify="right")
        for delay, found in {"as it is": design["margins"], **design["late"]}.items():
            gain = "unstable" if found["phase_margin_deg"] < 0.0 else "no limit"
            if gain != "unstable" and found["gain_margin_dB"] is not None:
                gain = number(found["gain_margin_dB"], 3)
            rest = (found["phase_margin_deg"], found["delay_margin_s"])
            margins.add_row(delay, gain, *(number(value, 3) for value in rest))
        _titled(
            console,
            f"The heater's loop: {number(design['gain_W_um'])} W/µm, integral time "
            f"{number(design['integral_time_s'])} s, feed-forward "
            f"{number(design['feed_forward_W_W'])} W/W",
            margins,
        )
        worst = design["worst_gain_margin_dB"]
        console.print(
            f"At worst: {'no limit' if worst is None else f'{worst:.3g} dB'}, "
            f"{design['worst_phase_margin_deg']:.3g}°."
        )
    table = Table()
    table.add_column("run")
    table.add_column("axis")
    for name in ("moves (µm)", "with offsets (µm)", "estimate's error (µm)"):
        table.add_column(name, justify="right")
    for run in content["runs"]:
        for axis, found in run["axes"].items():
            left = found.get("with_offsets", {"largest_um": None})
            values = (found["displacement"], left, found["estimate_error"])
            shown = (number(one["largest_um"], 3) for one in values)
            table.add_row(run["run"], axis, *shown)
    _titled(console, content["title"], table)
    for run in content["runs"]:
        if run.get("reached"):
            console.print(f"{run['run']}: {run['reached']}.")


def show_validation(console: Console, rows: Sequence[Row]) -> None:
    """Print the errors of the estimators, from temperatures alone."""
    from thermojoint.paper.verdict import paper_claim

    table = Table()
    title = "Validation from temperatures alone (µm)"
    for name in ("case", "estimator", "axis"):
        table.add_column(name, no_wrap=True)
    for name in ("max error", "rms error", "peak", "nonlinear peak", "paper's error"):
        table.add_column(name, justify="right")
    for row in rows:
        claim = paper_claim(row)
        table.add_row(
            str(row["case"]),
            str(row["estimator"]),
            str(row["axis"]),
            *(
                _figure(row[name])
                for name in (
                    "max_abs_error_um",
                    "rms_error_um",
                    "peak_total_um",
                    "peak_nonlinear_um",
                )
            ),
            number(claim),
        )
    _titled(console, title, table)


def show_estimators(console: Console, table: ErrorTable) -> None:
    """Print the largest errors of all estimators beside each other, a line for a case and axis."""
    shown = Table()
    for name in ("case", "axis"):
        shown.add_column(name, no_wrap=True)
    for name in (*table.estimators, "paper"):
        shown.add_column(name.replace("-", "-\n"), justify="right")
    for row in table.rows:
        shown.add_row(row.case, row.axis, *map(rounded, row.errors), number(row.paper))
    _titled(console, "Largest error of the estimated displacement, from temperatures (µm)", shown)


def show_bands(console: Console, rows: Sequence[Mapping[str, str | float]]) -> None:
    """Print the errors of an estimator that knows a band, and how often it holds."""
    table = Table()
    for name in ("case", "estimator", "axis"):
        table.add_column(name, no_wrap=True)
    for name in ("max error", "rms error", "peak", "band", "inside the band"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(
            *(str(row[name]) for name in ("case", "estimator", "axis")),
            *(
                number(float(row[name]), 3)
                for name in ("max_abs_error_um", "rms_error_um", "peak_total_um", "mean_band_um")
            ),
            f"{100.0 * float(row['band_cover']):.0f} %",
        )
    _titled(console, "Validation from temperatures alone (µm)", table)


def show_placement(console: Console, placement: Placement, axes: Sequence[str]) -> None:
    """Print the band for one sensor, two and so on, along the axes that move."""
    largest = max(float(value) for one in placement.steps for value in one.band)
    moving = [k for k in range(len(axes)) if placement.steps[0].band[k] > STILL * largest]
    table = Table()
    for name in ("sensors", "one more", *(f"band {axes[k]}" for k in moving)):
        table.add_column(name, justify="left" if name == "one more" else "right")
    rows = [(one.names[-1], one) for one in placement.steps]
    for name, one in [*rows, ("after exchanges", placement.chosen)]:
        bands = [number(1e6 * float(one.band[k]), 3) for k in moving]
        table.add_row(str(len(one.names)), name, *bands)
    _titled(console, "Half band of 95 % (µm)", table)
    console.print(f"Chosen: {', '.join(placement.chosen.names)}")


def show_physics(console: Console, report: Mapping[str, Any]) -> None:
    """Print the machine's fitted parameters and what of them the data determine."""
    table = Table()
    for name in ("parameter", "factor on the case", "uncertainty", "before"):
        table.add_column(name, justify="left" if name == "parameter" else "right")
    for one in report["parameters"]:
        table.add_row(
            one["parameter"],
            number(one["factor"], 3),
            f"{100.0 * one['std']:.1f} %",
            f"{100.0 * one['prior_std']:.1f} %",
        )
    _titled(console, "The machine's physics", table)
    known = Table()
    for name in ("singular value", "decided by", "direction"):
        known.add_column(name, justify="right" if name == "singular value" else "left")
    for one in report["directions"]:
        parts = ", ".join(f"{name} {weight:+.2f}" for name, weight in one["of"].items())
        known.add_row(number(one["singular_value"], 3), one["decided_by"], parts)
    _titled(console, "What the responses determine (in units of the priors)", known)


def show_schemes(console: Console, rows: Sequence[SchemeErrors]) -> None:
    """Print the two ways of calibrating Eq. 18 beside the linear estimator."""
    table = Table()
    for name in ("case", "axis"):
        table.add_column(name)
    for name in ("linear", "FCHS, calibrated to steps", "FCHS, to estimated strengths"):
        table.add_column(name, justify="right")
    for row in rows:
        errors = (number(value, 3) for value in (row.linear, row.steps, row.estimated))
        table.add_row(row.case, row.axis, *errors)
    _titled(console, "Largest error by the calibration of Eq. 18 (µm)", table)


def show_blocks(console: Console, rows: Sequence[Row]) -> None:
    """Print which block of Figure 5 an error comes from."""
    if not rows:
        return
    table = Table()
    title = "Largest error by what drives the blocks (µm)"
    for name in ("case", "driven by", "axis"):
        table.add_column(name)
    for name in ("linear", "nonlinear", "total"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(
            str(row["case"]),
            str(row["driven_by"]),
            str(row["axis"]),
            *(_figure(row[f"{part}_error_um"]) for part in ("linear", "nonlinear", "total")),
        )
    _titled(console, title, table)


def show_results(console: Console, response: xr.Dataset) -> None:
    """Print what a simulated response comes to: displacement, temperature, and the joint."""
    from fesim.batch.summary import figures_of
    from thermojoint.paper.summary import result_lines

    figures = figures_of(response)
    table = Table()
    table.add_column("axis")
    for name in ("final", "peak"):
        table.add_column(name, justify="right")
    for axis in response["axis"].to_numpy():
        at = (figures[f"displacement_{axis}_{kind}_um"] for kind in ("final", "peak"))
        # To the nanometre, and without the sign of a zero: less is rounding.
        table.add_row(str(axis), *(f"{round(value, 3) + 0.0:.3f}" for value in at))
    _titled(console, f"Displacement of {response.attrs['displacement_of']} (µm)", table)
    for line in result_lines(response, figures):
        console.print(line)


def show_convergence(console: Console, rows: Mapping[str, Convergence]) -> None:
    """Print the solver's figures of each response, then the thermal model they had."""
    table = Table()
    title = "Solver"
    table.add_column("response")
    for name in ("steps", "gap residual (m)", "heat balance", "iterations", "most", "cuts"):
        table.add_column(name, justify="right")
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
    _titled(console, title, table)
    # Responses of one run mostly share one set-up: one line then, not one for each.
    for model in dict.fromkeys(row.thermal_model for row in rows.values()):
        console.print(f"Thermal model: {model}.")


def show_share(console: Console, share: PressureShare) -> None:
    """Print how far the contact pressure of each contact element has come by a given time."""
    from thermojoint.paper.summary import STILL

    table = Table()
    title = (
        f"Change of contact pressure after {share.at_s:g} s "
        f"(paper, under compression: {paper_values.PRESSURE_SHARE:.0%} of the final change)"
    )
    table.add_column("contact element", justify="right")
    for name in (f"after {share.at_s:g} s (MPa)", "at the end (MPa)", "share"):
        table.add_column(name, justify="right")
    for row in share.rows:
        part = "–" if row.share is None else f"{round(100 * row.share)} %"
        table.add_row(str(row.contact), f"{row.early_MPa:+.2f}", f"{row.final_MPa:+.2f}", part)
    _titled(console, title, table)
    console.print(f"No share where the final change is below {STILL:.0%} of the largest one.")


def _figure(value: str | float | None) -> str:
    """Return a figure of a row as a table shows it."""
    return number(None if value is None else float(value), 3)


def _titled(console: Console, title: str, table: Table) -> None:
    """Print a table under its title; a title inside would be broken to the table's width."""
    console.print()
    console.print(title, style="bold")
    console.print(table)
