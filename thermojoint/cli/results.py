"""Results of single commands as tables on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Column, Table

from thermojoint.console import number, numeric, titled

if TYPE_CHECKING:
    from calibrate.placement.joint_aware import Placement
    from thermojoint.artefacts.response import AnyResponse
    from thermojoint.verification.suite import Result

#: An axis with less than this fraction of the largest band does not move.
STILL = 1e-6
#: A further run that leaves more than this fraction of the uncertainty is not worth its hours.
ENOUGH = 0.8


def show_test(console: Console, title: str, content: Mapping[str, Any]) -> None:
    """Print the parameters of a thermal test after ISO 230-3."""
    from thermojoint.standards.iso230_3.report import bases

    based = bases(content["parameters"])
    wide = numeric("± U, k = 2") if based else []
    table = Table("parameter", *numeric("value"), *wide, "unit", *numeric("from (min)", "to (min)"))
    for row in content["parameters"]:
        ends = (f"{row[key] / 60.0:.1f}" for key in ("begin_s", "end_s"))
        budget = row["uncertainty"]
        expanded = "" if budget is None else number(budget["expanded"], 2)
        table.add_row(
            row["symbol"], number(row["value"]), *[expanded][: len(wide)], row["unit"], *ends
        )
    titled(console, title, table)
    for source, basis in based:
        console.print(f"{source}: {basis}", markup=False)


def show_loop(console: Console, content: Mapping[str, Any]) -> None:
    """Print margins and residuals of a closed loop."""
    design = content["design"]
    if design is not None:
        margins = Table(
            *numeric("delay (s)", "gain margin (dB)", "phase margin (°)", "more delay (s)")
        )
        for delay, late in {"as it is": design["margins"], **design["late"]}.items():
            gain = "unstable" if late["phase_margin_deg"] < 0.0 else "no limit"
            if gain != "unstable" and late["gain_margin_dB"] is not None:
                gain = number(late["gain_margin_dB"], 3)
            rest = (late["phase_margin_deg"], late["delay_margin_s"])
            margins.add_row(delay, gain, *(number(value, 3) for value in rest))
        titled(
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
    table = Table(
        "run", "axis", *numeric("moves (µm)", "with offsets (µm)", "estimate's error (µm)")
    )
    for run in content["runs"]:
        for axis, axis_run in run["axes"].items():
            left = axis_run.get("with_offsets", {"largest_um": None})
            values = (axis_run["displacement"], left, axis_run["estimate_error"])
            shown = (number(value["largest_um"], 3) for value in values)
            table.add_row(run["run"], axis, *shown)
    titled(console, content["title"], table)
    for run in content["runs"]:
        if run.get("reached"):
            console.print(f"{run['run']}: {run['reached']}.")


def show_placement(console: Console, placement: Placement, axes: Sequence[str]) -> None:
    """Print the band for one sensor, two and so on, along the axes that move."""
    largest = max(float(value) for step in placement.steps for value in step.band)
    moving = [k for k in range(len(axes)) if placement.steps[0].band[k] > STILL * largest]
    bands = numeric(*(f"band {axes[k]}" for k in moving))
    table = Table(*numeric("sensors"), "one more", *bands)
    rows = [(step.names[-1], step) for step in placement.steps]
    for name, choice in [*rows, ("after exchanges", placement.chosen)]:
        cells = [number(1e6 * float(choice.band[k]), 3) for k in moving]
        table.add_row(str(len(choice.names)), name, *cells)
    titled(console, "Half band of 95 % (µm)", table)
    console.print(f"Chosen: {', '.join(placement.chosen.names)}")


def show_physics(console: Console, report: Mapping[str, Any]) -> None:
    """Print the machine's fitted parameters, and the combinations that the data determine."""
    from thermojoint.reduced.parameters import shown

    table = Table("parameter", *numeric("factor on the case", "uncertainty", "before"))
    for parameter in report["parameters"]:
        name = parameter["parameter"]
        value, after = shown(name, parameter["factor"], parameter["std"])
        before = shown(name, 0.0, parameter["prior_std"])[1]
        table.add_row(name, value, after, before)
    titled(console, "The machine's physics", table)
    known = Table(*numeric("singular value"), "decided by", "direction")
    for direction in report["directions"]:
        parts = ", ".join(f"{name} {weight:+.2f}" for name, weight in direction["of"].items())
        known.add_row(number(direction["singular_value"], 3), direction["decided_by"], parts)
    titled(console, "What the responses determine (in units of the priors)", known)
    if report["doubt"] > 1.0:
        console.print(
            f"The machine differs from its case by more than these parameters: errors are taken as "
            f"{number(report['doubt'], 2)} times as large as usual."
        )
        heat = report["unknown_heat_W"]
        console.print(
            f"Heat that no source brings is estimated, too ({number(heat, 2)} W a face)."
            if heat
            else "Heat that no source brings is not estimated; thermometers all over the machine "
            "would tell it."
        )
        days = report["recorded_days"]
        console.print(
            f"What thermometers mean that disagree with the model is told by {', '.join(days)}."
            if days
            else "Two to five recorded days of ordinary work as further runs would tell what "
            "thermometers mean that disagree with the model."
        )
    if unchecked := report["unchecked_runs"]:
        console.print(
            f"The band is not checked on {', '.join(unchecked)}: the other runs alone tell too "
            "little for a fit."
        )
    console.print(further_run_line(report["further_runs"]))


def further_run_line(further_runs: Sequence[Mapping[str, Any]]) -> str:
    """Return the most informative further run, and the uncertainty of a day after it.

    The first of the runs, which are those of a report on the calibration, stands for no run.
    """

    def deviation(further: Mapping[str, Any]) -> float:
        return float(np.linalg.norm(list(further["day_std_um"].values())))

    def sizes(further: Mapping[str, Any]) -> str:
        return " / ".join(f"{value:.2f}" for value in further["day_std_um"].values())

    present, *others = further_runs
    best = min(others, key=deviation)
    axes = ", ".join(present["day_std_um"])
    now = f"Uncertainty of a day with known heat: {sizes(present)} µm along {axes}"
    if deviation(best) > ENOUGH * deviation(present):
        return f"{now}; no further run would tell much more."
    return (
        f"{now}; with one more run, a {best['run']}, {sizes(best)} µm: record it, calibrate again."
    )


def show_results(console: Console, response: AnyResponse) -> None:
    """Print the results of a simulated response: displacement, temperature, joints."""
    from fesim.batch.summary import figures_of
    from thermojoint.paper.summary import result_lines

    figures = figures_of(response)
    if response.sizes["axis"]:
        _show_displacement(console, response, figures)
    for line in result_lines(response, figures):
        console.print(line)


def _show_displacement(
    console: Console, response: AnyResponse, figures: Mapping[str, float]
) -> None:
    table = Table("axis", *numeric("final", "peak"))
    for axis in response["axis"].to_numpy():
        at = (figures[f"displacement_{axis}_{kind}_um"] for kind in ("final", "peak"))
        # To the nanometre, since further digits are rounding errors; adding zero turns -0 into 0.
        table.add_row(str(axis), *(f"{round(value, 3) + 0.0:.3f}" for value in at))
    titled(console, f"Displacement of {response.attrs['displacement_of']} (µm)", table)


def show_verification(console: Console, results: Sequence[Result]) -> None:
    """Print one table for each group of checks, and the number of passed ones."""
    from thermojoint.verification.report import shown

    for result in results:
        numbers = ("reference", "computed", "error", "tolerance")
        table = Table(
            Column("quantity", overflow="fold"),
            *(Column(name, justify="right", no_wrap=True) for name in numbers),
            Column("source", overflow="fold"),
        )
        for check in result.checks:
            table.add_row(*shown(check), style=None if check.passed else "bold red")
        titled(console, result.group.title, table)
    checks = [check for result in results for check in result.checks]
    failed = [check.name for check in checks if not check.passed]
    console.print(f"\n{len(checks) - len(failed)} of {len(checks)} checks are within tolerance.")
    for name in failed:
        console.print(f"out of tolerance: {name}", style="bold red")
