"""The commands `simulate`, `batch` and `verify`."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from thermojoint.cli import arguments, file_kinds

#: Exit code of `verify` if a check is out of tolerance.
OUT_OF_TOLERANCE = 1


def simulate(
    case: Annotated[Path, typer.Argument(help="Case file (TOML).")],
    out: Annotated[Path, typer.Option(help="Response file to write (NetCDF).")],
    save: Annotated[
        Path | None, typer.Option("--save-state", help="Write the state at the end here (NPZ).")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option("--continue", help="Go on from a saved state (NPZ).")
    ] = None,
    snapshots: Annotated[
        Path | None,
        typer.Option(
            help="Folder for field snapshots (VTU/PVD) at the case's output.snapshots_s, or at "
            "the end if it names none."
        ),
    ] = None,
) -> None:
    """Simulate a case: heat, contact and displacement in time.

    Example: [bold]thermojoint simulate machine.toml --out machine.nc[/bold]

    Example: [bold]thermojoint simulate longer.toml --continue half.npz --out rest.nc[/bold]
    """
    from fesim.axes.setup import check_still
    from fesim.case.schema import first_step_at, read_case
    from fesim.march.state_file import load_state, save_state
    from fesim.simulate import prepared, standing
    from fesim.simulate import simulate as run_case
    from fesim.snapshots import snapshot_writer
    from thermojoint import console, plausibility
    from thermojoint.artefacts.errors import InputError
    from thermojoint.artefacts.folders import whole_folder
    from thermojoint.artefacts.response import write_response
    from thermojoint.artefacts.settings.section import files_of
    from thermojoint.cli import results
    from thermojoint.paper import printing
    from thermojoint.paper.summary import (
        accuracy_line,
        axis_lines,
        convergence,
        covered_areas,
        drive_lines,
    )

    given = read_case(case)
    # The state of --continue is no input here: its successor may replace it.
    arguments.check_outputs(
        {"--out": (out, file_kinds.RESPONSE), "--save-state": (save, file_kinds.MARCH_STATE)},
        [case, *files_of(given)],
    )
    begin = load_state(resume, given) if resume else None
    times, step = given.output.snapshots_s, given.march.step_s
    if begin is not None:
        times = [time for time in times if first_step_at(time, step) > begin.index]
        if snapshots and given.output.snapshots_s and not times:
            raise InputError(
                f"output.snapshots_s: no time after the state, at {begin.index * step:g} s; add "
                "one, or leave --snapshots out"
            )
    folder = snapshots or (out.with_name(f"{out.stem}-snapshots") if times else None)
    if folder:
        check_still(given, "--snapshots")
        arguments.check_whole_folder(folder)
    console.warn(plausibility.of_case(given, str(case)))
    with (
        whole_folder(folder) if folder else nullcontext() as fields,
        console.progress_bars() as report,
    ):
        report("setting up", 0, 1)
        ready = prepared(given)
        setup = standing(ready)
        report("setting up", 1, 1)
        console.warn(plausibility.of_structure(setup.structure, str(case)))
        finished = run_case(
            given,
            setup=ready,
            start=begin,
            on_step=snapshot_writer(setup, fields, times or [60.0 * given.march.duration_min])
            if fields
            else None,
            progress=lambda done, total: report("marching", done, total),
        )
        response = finished.arrays
        write_response(response, out)
        if save:
            save_state(finished.state, given, save)
    results.show_results(console.out(), response)
    printing.show_convergence(console.out(), {out.name: convergence(response)})
    if covered := covered_areas(response):
        parts = ", ".join(f"{1e4 * area:.4g} cm2 of {name!r}" for name, area in covered.items())
        console.say(f"joints cover {parts} of the meshed part: no convection there")
    if "secant_residual" in response:
        left = float(response["secant_residual"].to_numpy().max())
        console.say(f"last secant step: temperatures changed by {left:.1e} K at most")
    if given.axes:
        for line in axis_lines(finished.response) + drive_lines(finished.response):
            console.say(line)
    if "error_total_um" in response.attrs:
        console.say(accuracy_line(response.attrs))
    console.wrote(out, save, folder)


def batch(
    given: Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")],
    out: Annotated[Path, typer.Option(help="Folder for all results; existing ones are kept.")],
    workers: arguments.Workers = None,
    scheduler: arguments.Scheduler = None,
    page: Annotated[
        Path | None, typer.Option(help="Page with figures and pictures of all cases (HTML).")
    ] = None,
) -> None:
    """Simulate many cases: grids, lists and Latin hypercubes over the values of a case.

    Responses, one dataset of all of them and a summary table go into the folder. After any
    interruption the same command goes on from there. Exit code 1 if a case failed.

    Example: [bold]thermojoint batch study.toml --out results[/bold]

    Example: [bold]thermojoint batch study.toml --out results --scheduler tcp://10.0.0.1:8786[/bold]
    """
    from fesim.batch.study import read_study
    from thermojoint import console
    from thermojoint.cli import batch_run

    batch_run.check_workers(workers, scheduler)
    arguments.check_outputs({"--page": (page, file_kinds.STUDY_PAGE)}, [given])
    study = read_study(given)
    recruit = partial(batch_run.crew_of, workers, scheduler)
    finished = batch_run.run_cases(study, str(given), out, recruit)
    for line in batch_run.closing_lines(finished, out):
        console.say(line)
    if page and not finished.stopped:
        # Here, not above: most batches have no page.
        import xarray as xr

        from thermojoint.artefacts.files import write_text
        from thermojoint.pictures.study_page import study_html

        with xr.open_dataset(out / "dataset.zarr", engine="zarr") as dataset:
            write_text(page, study_html(study, finished.summary, dataset))
        console.wrote(page)
    if code := batch_run.worst(finished):
        raise typer.Exit(code)


def verify(
    out: arguments.Json = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Page to write (Markdown), as in the docs.")
    ] = None,
) -> None:
    """Verify the simulator by known results; exit code 1 if a check is out of tolerance.

    Example: [bold]thermojoint verify[/bold]

    Example: [bold]thermojoint verify --json verify.json[/bold]
    """
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.cli import results
    from thermojoint.verification import suite
    from thermojoint.verification.report import markdown as verification_page
    from thermojoint.verification.report import results_data

    arguments.check_outputs(
        {
            "--json": (out, file_kinds.VERIFICATION),
            "--markdown": (markdown, file_kinds.VERIFICATION_PAGE),
        }
    )
    compared: list[suite.Result] = []
    with console.progress_bars() as report:
        report("verifying", 0, len(suite.GROUPS))
        for result in suite.run(suite.GROUPS):
            compared.append(result)
            report("verifying", len(compared), len(suite.GROUPS))
    arguments.write_json(out, results_data(compared))
    results.show_verification(console.out(out), compared)
    if markdown:
        write_text(markdown, verification_page(compared))
    console.wrote(out, markdown)
    if not all(result.passed for result in compared):
        raise typer.Exit(OUT_OF_TOLERANCE)
