"""The commands `compensate` and `control`: axis offsets and a closed loop."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds


def compensate(
    estimate: Annotated[
        Path,
        typer.Argument(
            metavar="ESTIMATE", help="CSV of 'estimate', '-' for standard input.", allow_dash=True
        ),
    ],
    settings: Annotated[Path, typer.Option(help="Settings of the compensation output (TOML).")],
    out: Annotated[
        Path, typer.Option(help="CSV to write, '-' for standard output.", allow_dash=True)
    ],
) -> None:
    """Preview the axis offsets that a control will receive, for every cycle.

    The settings define axes and signs, resolution, rate, dead band, filter, limit, and the
    behaviour without a usable estimate. Accepts the estimate of any estimator. For an axis with a
    slope in the settings and an estimate along an axis, the output is K0, slope and P0.

    Example: [bold]thermojoint compensate estimate.csv --settings offsets.toml --out
    offsets.csv[/bold]
    """
    import numpy as np

    from estimator.estimate_table import read_estimate, strokes_of
    from estimator.interface import SILENT
    from thermojoint import console
    from thermojoint.compensation.offsets.output import band_along
    from thermojoint.compensation.offsets.preview import header, heard_by, preview, row_of
    from thermojoint.compensation.offsets.settings import (
        check_axes,
        read_settings,
        with_slopes,
    )
    from thermojoint.compensation.offsets.usable import limit_without_band, reasons_against

    arguments.check_outputs({"--out": (out, file_kinds.OFFSETS)}, [estimate, settings])
    wanted = read_settings(settings)
    with arguments.at_work("compensating", estimate, out):
        with arguments.opened(estimate) as source:
            if source is None:
                raise InputError(
                    f"{estimate}: a response is not an estimate; run 'estimate' on it first"
                )
            axes, rows = read_estimate(source, arguments.shown(estimate))
        check_axes(wanted, (*axes, *rows[0].places), str(settings))
        along = with_slopes(wanted, strokes_of(axes, rows), str(settings)).output
        bands = [band_along(along, axes, row.band, row.lines) for row in rows]
        if warning := limit_without_band(wanted.trust, np.array(bands)):
            console.warn([f"{settings}: {warning}"])
        counted = Counter[str]()
        with arguments.output(out) as target:
            writer = csv.writer(target, lineterminator="\n")
            writer.writerow(header(wanted))
            for cycle in preview(wanted, axes, rows, str(settings)):
                counted[cycle.state] += 1
                writer.writerow(row_of(wanted, cycle))
    times, trust = [row.time for row in rows], wanted.trust
    _report(arguments.shown(estimate), times, counted)
    against = Counter[str]()
    for row, band, heard in zip(rows, bands, heard_by(rows), strict=True):
        against.update(reasons_against(trust, band, row.status))
        against.update([SILENT] * bool(row.time - heard > trust.oldest))
    if against:
        parts = ", ".join(f"{why} {100.0 * n / len(rows):.3g} %" for why, n in against.items())
        console.say(f"  unusable by {settings}: {parts} of the estimates")
    apart = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if apart > trust.oldest:
        console.warn(
            [
                f"{settings}: oldest_s {trust.oldest:g} is shorter than the {apart:g} s between "
                "two estimates: offsets are held in between; make it longer"
            ]
        )
    for own in along.slopes:
        reference, low, high = (1e3 * at for at in (own.reference, own.low, own.high))
        console.say(
            f"  {own.axis}: K0 at P0 = {reference:g} mm and slope; from {low:g} to {high:g} mm at "
            f"most {1e6 * along.largest:g} um, {1e6 * along.rate:g} um/s"
        )
    console.wrote(out)


def _report(where: str, times: Sequence[float], counted: Mapping[str, int]) -> None:
    """Print the duration and pauses of the estimates, and the share of time in each mode."""
    import numpy as np

    from thermojoint import console
    from thermojoint.artefacts.log_record import Record, ended, with_times
    from thermojoint.artefacts.tables.clock import tells_date

    record = Record(where, dated=tells_date(times[0]))
    for line in ended(with_times(record, np.array(times), -np.inf)):
        console.say(line)
    cycles = sum(counted.values())
    shares = ", ".join(f"{state} {100.0 * n / cycles:.3g} %" for state, n in counted.items())
    console.say(f"  offsets: {shares} of the time")


def control(
    loop: Annotated[Path, typer.Argument(help="File of the closed loop (TOML).")],
    out: Annotated[Path | None, typer.Option(help="Report to write (HTML).")] = None,
    figures: arguments.Json = None,
) -> None:
    """Simulate a closed loop: machine, estimator, a heater with PID control, axis offsets.

    The controller is tuned with the transfer functions of the model to the margins required in the
    file; it is then tested on the simulated machine, not on the model.

    Example: [bold]thermojoint control step.toml --out step.html --json step.json[/bold]
    """
    from fesim.case.schema import read_case
    from thermojoint.compensation.loop.schema import read_loop

    given = read_loop(loop)
    # After the file, so that mistakes in it are reported before the libraries are loaded.
    from thermojoint import console, plausibility
    from thermojoint.artefacts.files import write_text
    from thermojoint.artefacts.settings.section import files_of
    from thermojoint.cli import results
    from thermojoint.compensation.loop.judging import as_content
    from thermojoint.compensation.loop.report import report_html
    from thermojoint.compensation.loop.run import close_loop

    machine = read_case(given.plant.case)
    arguments.check_outputs(
        {"--out": (out, file_kinds.LOOP_REPORT), "--json": (figures, file_kinds.LOOP_FIGURES)},
        [loop, *files_of(given), *files_of(machine)],
    )
    console.warn(plausibility.of_case(machine, str(given.plant.case)))
    closed = close_loop(given, console.say)
    content = as_content(closed)
    if out:
        write_text(out, report_html(closed, content))
    arguments.write_json(figures, content)
    results.show_loop(console.out(figures), content)
    console.wrote(out, figures)
