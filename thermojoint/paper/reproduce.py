"""The whole chain with its files: responses, model, tables, validation, figures, report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from artefacts.files import write_text
from artefacts.folders import whole_folder
from artefacts.response import write_response
from calibrate import chain
from calibrate.baselines import baselines_of
from calibrate.placement import with_roles
from calibrate.provenance import provenance_of
from estimator import judge
from estimator.fchs.stream import Signals
from estimator.judge import superposed
from estimator.noise import joint_noise
from fesim.case.schema import Case
from fesim.setup.machine import Setup, set_up
from models.baselines import write_baselines
from models.model_file import Provenance, write_model
from models.parameters import Model
from models.sensors import roles_in
from thermojoint.cli import console
from thermojoint.paper import inputs
from thermojoint.paper.inputs import check_drivable, check_placeable
from thermojoint.paper.report import Picture, ReportData, write_report
from thermojoint.paper.summary import compare_schemes, convergence, pressure_share, verdict
from thermojoint.paper.tables import printed_tables, tables_json
from thermojoint.pictures.figures import (
    displacements_figure,
    errors_figure,
    heat_text,
    pressure_figure,
    temperatures_figure,
    write_figure,
)
from thermojoint.pictures.view import FIELDS, field_scene, run_to_end, whole_structure

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

REFERENCE = "step-1.0"
#: The response of Figure 7, and of the field pictures.
PRESSURE = "step-2.0"
#: The responses of Figures 8 and 9, and of 10 and 11; the latter's noise is the estimate's.
EXTRAPOLATION, TRIANGLE, NOISY = "step-3.0", "triangle", "triangle-noise"

CAPTIONS = {
    "figure-06-structure": "Figure 6: the structure, its contact strips, sensors and heat source Q",
    "figure-07-contact-pressure": "Figure 7: change of the contact pressure, heat input 2.0",
    "figure-08-temperature-deviation": "Figure 8: temperature deviation from the linear structure "
    "at T1 and T2, heat input 3.0",
    "figure-09-nonlinear-displacement": "Figure 9: actual and estimated nonlinear displacement, "
    "heat input 3.0",
    "figure-10-noisy-deviation": "Figure 10: temperature deviation under the triangle, and with "
    "the sensor noise put on it",
    "figure-11-noisy-displacement": "Figure 11: actual and estimated nonlinear displacement under "
    "the triangle, with sensor noise",
    **{
        f"error-{name}": f"Error of every estimator, {name}" for name in (*inputs.VALIDATION, NOISY)
    },
    "temperature": "Temperature at the end of the step, heat input 2.0",
    "deformation": "Deformed shape at the end of the step, heat input 2.0",
    "pressure": "Contact pressure at the end of the step, heat input 2.0",
}


def reproduce(case: Case, out: Path) -> None:
    """Run the chain on `case`, fill the folder `out` and print what came out.

    The folder is all old until everything is there, and then all new (`artefacts.folders`).

    Parameters
    ----------
    case : Case
        The machine; its heat input is replaced by those of the study. Nothing else may act on it
        (`thermojoint.paper.inputs.check_drivable`), and it names its sensors or has candidates
        for them.
    out : Path
        Folder for ``responses/*.nc``, ``model.json``, ``baselines.json``, ``tables.json``,
        ``validation.json``, ``figures/*.png`` and ``report.html``.

    Raises
    ------
    InputError
        The case is unusable.
    ConvergenceError
        A march or a calibration did not converge.
    """
    check_drivable(case)
    check_placeable(case)
    with whole_folder(out) as folder, console.progress_bars() as report:
        report("setting up", 0, 1)
        setup = set_up(case)
        report("setting up", 1, 1)
        heats = inputs.CALIBRATION | inputs.VALIDATION
        responses = inputs.simulate_inputs(case, heats, setup=setup, progress=report)
        for name, response in responses.items():
            write_response(response, folder / "responses" / f"{name}.nc")

        report("calibrating", 0, 1)
        calibrated, provenance = _calibrate(case, responses)
        if calibrated.placement is not None:
            responses = {
                name: with_roles(response, calibrated.placement.roles)
                for name, response in responses.items()
            }
            for name, response in responses.items():
                write_response(response, folder / "responses" / f"{name}.nc")
        write_model(calibrated.model, folder / "model.json", provenance)
        baselines = baselines_of(calibrated, [responses[name] for name in inputs.CALIBRATION])
        write_baselines(baselines, folder / "baselines.json")
        tables = tables_json(calibrated.model, provenance)
        _write_json(folder / "tables.json", tables)
        report("calibrating", 1, 1)

        report("validating", 0, 1)
        judged = {name: responses[name] for name in inputs.VALIDATION}
        validated = judge.validate_model(
            calibrated.model,
            responses[REFERENCE],
            judged,
            noisy=[TRIANGLE],
            baselines=baselines,
        )
        _write_json(folder / "validation.json", validated.figures())
        report("validating", 1, 1)

        report("drawing", 0, 1)
        figures = paper_figures(calibrated.model, responses, validated.estimates)
        axes = list(calibrated.model.linear.deformation)
        figures |= {
            f"error-{name}": errors_figure(
                np.asarray(validated.estimates[name].time), errors, axes, name
            )
            for name, errors in validated.errors.items()
        }
        hot = case.model_copy(update={"heat_input": heats[PRESSURE]})
        pictures = _draw(folder / "figures", figures, hot, setup, calibrated.model.sensors, report)
        report("drawing", 1, 1)

        data = ReportData(
            title=case.title,
            facts=facts(case, responses[REFERENCE]),
            tables=printed_tables(tables, provenance.at_bound),
            validation=validated.rows,
            schemes=compare_schemes(validated.rows, validated.as_printed, validated.vectors),
            blocks=validated.blocks,
            convergence={name: convergence(response) for name, response in responses.items()},
            share=pressure_share(responses[PRESSURE]),
            placement="" if calibrated.placement is None else str(calibrated.placement),
            fits=provenance.reports,
            pictures=pictures,
            case=case.model_dump_json(indent=2),
        )
        write_report(data, folder / "report.html")
    show(console.out(), data)


def show(terminal: Console, data: ReportData) -> None:
    """Print the tables of a report."""
    console.show_tables(terminal, data.tables)
    console.show_validation(terminal, data.validation)
    console.show_schemes(terminal, data.schemes)
    console.show_blocks(terminal, data.blocks)
    console.show_convergence(terminal, data.convergence)
    if data.share is not None:
        console.show_share(terminal, data.share)
    if data.placement:
        terminal.print(data.placement)
    if data.validation:
        terminal.print()
        terminal.print(verdict(data.validation))


def paper_figures(
    model: Model, responses: Mapping[str, xr.Dataset], estimates: Mapping[str, Signals]
) -> dict[str, Figure]:
    """Return the paper's Figures 7-11, by file name without its suffix.

    Parameters
    ----------
    model : Model
        Names the sensors and the axes.
    responses : mapping
        The responses of the study, by name.
    estimates : mapping
        What the estimator made of "step-3.0", "triangle" and "triangle-noise".
    """
    reference = responses[REFERENCE]
    steep, triangle = responses[EXTRAPOLATION], responses[TRIANGLE]
    times, noisy = estimates[EXTRAPOLATION], estimates[NOISY]
    sensors = list(model.linear.direct)
    on_steep = deviations(model, reference, steep)
    on_triangle = deviations(model, reference, triangle)
    noise = joint_noise(triangle)
    return {
        "figure-07-contact-pressure": pressure_figure(responses[PRESSURE]),
        "figure-08-temperature-deviation": temperatures_figure(
            np.asarray(times.time),
            {
                sensor: {"simulated": on_steep[:, j], "estimator": times.deviation[:, j]}
                for j, sensor in enumerate(sensors)
            },
            heat_text(steep),
        ),
        "figure-09-nonlinear-displacement": displacements_figure(
            np.asarray(times.time), _nonlinear(model, reference, steep, times), heat_text(steep)
        ),
        "figure-10-noisy-deviation": temperatures_figure(
            triangle["time"].to_numpy(),
            {
                sensor: {
                    "with noise": on_triangle[:, j] + noise[sensor],
                    "simulated": on_triangle[:, j],
                }
                for j, sensor in enumerate(sensors)
            },
            heat_text(triangle),
        ),
        "figure-11-noisy-displacement": displacements_figure(
            np.asarray(noisy.time),
            _nonlinear(model, reference, triangle, noisy),
            heat_text(triangle),
        ),
    }


def deviations(model: Model, reference: xr.Dataset, response: xr.Dataset) -> np.ndarray:
    """Return the deviation of T1, T2 ... from the superposed reference, K, shape (k, sensors)."""
    roles = roles_in(response, model)
    probes = [roles[role] for role in model.linear.direct]
    part, base = response.sel(probe=probes), reference.sel(probe=probes)
    return part["temperature"].to_numpy() - superposed(base, part, "temperature")


def facts(case: Case, response: xr.Dataset) -> list[tuple[str, str]]:
    """Return what was run: versions, mesh, solver, step."""
    versions = json.loads(str(response.attrs.get("versions", "{}")))
    mesh = case.structure
    size = f", elements of {mesh.element_size_mm:g} mm" if hasattr(mesh, "element_size_mm") else ""
    return [
        ("structure", f"{mesh.kind}{size}"),
        ("temperature unknowns", f"{response.attrs['thermal_unknowns']}"),
        ("displacement unknowns", f"{response.attrs['displacement_unknowns']}"),
        ("contact elements", str(response.sizes["contact"])),
        ("friction coefficient", str(response.attrs["friction"])),
        *(
            (
                f"reference step, {name}",
                f"{source.reference_power_W:g} W {source.reading}, {source.count} of them",
            )
            for name, source in case.sources.items()
        ),
        (
            "march",
            f"{case.march.duration_min:g} min at {case.march.step_s:g} s, {case.march.coupling}",
        ),
        ("linear solver", str(response.attrs["linear_solver"])),
        ("versions", ", ".join(f"{name} {number}" for name, number in versions.items())),
    ]


def _calibrate(
    case: Case, responses: Mapping[str, xr.Dataset]
) -> tuple[chain.Calibrated, Provenance]:
    others = {
        float(responses[name]["heat_input"][-1]): responses[name]
        for name in inputs.CALIBRATION
        if name != REFERENCE
    }
    calibrated = chain.calibrate_responses(responses[REFERENCE], others)
    origin = case.model_dump_json()
    return calibrated, provenance_of(calibrated, origin)


def _draw(
    folder: Path,
    figures: Mapping[str, Figure],
    case: Case,
    setup: Setup,
    sensors: Mapping[str, tuple[float, float, float]],
    report: console.Report,
) -> list[Picture]:
    """Write the figures and the 3-D pictures of the end of `case`."""
    from thermojoint.pictures.stills import write_pictures

    _, _, last = run_to_end(case, report, setup)
    scenes = {"figure-06-structure": whole_structure(case, setup.structure, sensors)}
    scenes |= {str(show): field_scene(show, case, setup, last) for show in FIELDS}
    for name, figure in figures.items():
        write_figure(figure, folder / f"{name}.png")
    write_pictures({folder / f"{name}.png": scene for name, scene in scenes.items()})
    return [Picture(folder / f"{name}.png", caption) for name, caption in CAPTIONS.items()]


def _nonlinear(
    model: Model, reference: xr.Dataset, response: xr.Dataset, estimate: Signals
) -> dict[str, dict[str, np.ndarray]]:
    """Axis to the actual and the estimated nonlinear displacement, m."""
    linear = superposed(reference, response, "displacement")
    known = [str(name) for name in response["axis"].to_numpy()]
    actual = response["displacement"].to_numpy() - linear
    return {
        axis: {"actual": actual[:, known.index(axis)], "estimated": estimate.nonlinear[:, k]}
        for k, axis in enumerate(model.linear.deformation)
    }


def _write_json(path: Path, content: Mapping[str, object] | Sequence[object]) -> None:
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")
