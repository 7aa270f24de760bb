"""The complete chain with its files: responses, models, tables, validation, figures, report."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from calibrate import chain
from calibrate.baselines import fit_baselines
from calibrate.drivable import check_drivable
from calibrate.placement.fchs import RULE, Rule, with_roles
from calibrate.provenance import provenance_of
from calibrate.responses import candidates_in, moving_axes
from estimator.fchs import judging as judge
from estimator.fchs.judging import Validated
from estimator.joint_aware.estimator import JointAware
from fesim.case.schema import Case
from fesim.setup.machine import set_up
from fesim.setup.soundness import check_stands
from fesim.setup.structure import build_structure
from thermojoint import console
from thermojoint.artefacts.errors import ThermojointError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.folders import whole_folder
from thermojoint.artefacts.json_file import write_json
from thermojoint.artefacts.processes import process_pool
from thermojoint.artefacts.response import probes_of, write_response
from thermojoint.models.baselines import Baselines, write_baselines
from thermojoint.models.model_file import Provenance, write_model
from thermojoint.models.parameters import Model
from thermojoint.models.sensors import ROLES, named_sensors
from thermojoint.paper import inputs, printing
from thermojoint.paper.candidates import with_candidates
from thermojoint.paper.drawing import (
    draw_figures,
    draw_views,
    estimate_figures,
    field_scenes,
    paper_figures,
)
from thermojoint.paper.inputs import check_placeable
from thermojoint.paper.long_runs import (
    LongRuns,
    at_sensors,
    simulate_long,
    simulate_steady,
    warm_part,
    without_nonlinear,
)
from thermojoint.paper.observers import fitted_text, observers_beside
from thermojoint.paper.report import ReportData, report_html
from thermojoint.paper.summary import compare_schemes, convergence, pressure_share
from thermojoint.paper.tables import printed_tables, tables_json
from thermojoint.paper.verdict import error_table, verdict
from thermojoint.pictures.scenes import Scene
from thermojoint.pictures.view import whole_structure

if TYPE_CHECKING:
    import xarray as xr


def reproduce(case: Case, out: Path, long: LongRuns | None = None) -> None:
    """Run the complete chain for `case`, write its results to `out` and print them.

    The folder is replaced as a whole when everything is complete
    (`thermojoint.artefacts.folders`).

    Parameters
    ----------
    case : Case
        The machine; its heat input is replaced by the study's inputs. Nothing else may act on it
        (`calibrate.drivable.check_drivable`). Without named sensors and candidates, candidates are
        generated. A method that is not applicable is left out, with the reason.
    out : Path
        Folder for ``responses/*.nc``, ``model.json``, ``baselines.json``, ``joint_aware.h5`` and
        ``kalman_linear.h5`` with their reports (``*.json``), ``tables.json``, the same for the
        model calibrated until the machine is steady (``*_steady.json``), ``validation.json``,
        ``figures/*.png`` and ``report.html``.
    long : LongRuns, optional
        Durations of the day and the cool-down.

    Raises
    ------
    InputError
        The case is unusable.
    ConvergenceError
        A march or a calibration did not converge.
    """
    check_stands(case)
    check_drivable(case)
    check_placeable(case)
    runs = long or LongRuns()
    left_out: dict[str, str] = {}
    with (
        whole_folder(out) as folder,
        console.progress_bars() as report,
        process_pool(runs.processes) as crew,
    ):
        report("setting up", 0, 1)
        if not (case.candidates or named_sensors(case.probes)):
            case = with_candidates(case, build_structure(case))
        setup = set_up(case)
        report("setting up", 1, 1)
        beside_it = crew.submit(_beside_calibration, case, runs, folder)
        heats = inputs.CALIBRATION | inputs.VALIDATION
        responses = inputs.simulate_inputs(case, heats, setup=setup, progress=report)

        report("calibrating", 0, 3)
        calibrated: chain.Calibrated | None = None
        provenance: Provenance | None = None
        with _or_why_not(left_out, "linear", "fchs"):
            chosen_from = {name: responses[name] for name in inputs.CALIBRATION}
            calibrated, provenance = _calibrate(case, chosen_from, runs.rule)
            write_model(calibrated.model, folder / "model.json", provenance)
        roles = _roles(calibrated, responses[inputs.REFERENCE])
        responses = {name: with_roles(response, roles) for name, response in responses.items()}
        known = {name: responses[name] for name in inputs.CALIBRATION}
        sensors = {role: setup.probes[name] for role, name in roles.items()}
        observed = observers_beside(crew, case, sensors, known, folder, runs.effort)
        report("calibrating", 1, 3)
        lasting, steps, scenes = beside_it.result()
        steady: Model | None = None
        with _or_why_not(left_out, "linear-steady", "fchs-steady"):
            if isinstance(steps, ThermojointError):
                raise steps
            seen = {name: at_sensors(response, roles) for name, response in steps.items()}
            steady = _steady(case, seen, folder)
        axes = moving_axes(known[inputs.REFERENCE], _others(known))
        baselines: Baselines | None = None
        with _or_why_not(left_out, "mlr", "ridge", "arx"):
            baselines = fit_baselines([response.sel(axis=axes) for response in known.values()])
            write_baselines(baselines, folder / "baselines.json")
        tables: dict[str, Any] | None = None
        if calibrated is not None and provenance is not None:
            tables = tables_json(calibrated.model, provenance)
            write_json(folder / "tables.json", tables)
        lasting = {
            name: _kept(at_sensors(response, roles), folder, out)
            for name, response in lasting.items()
        }
        _write_responses(responses | lasting, folder)
        places = {role: probe.position for role, probe in sensors.items()}
        structure = whole_structure(_hot(case), setup.structure, places)
        views = draw_views(folder / "figures", structure, scenes)
        report("calibrating", 2, 3)
        observers, failed = observed()
        left_out |= failed
        report("calibrating", 3, 3)

        report("validating", 0, 1)
        model = None if calibrated is None else calibrated.model
        beside = judge.Beside(baselines, steady)
        validated = _judged(crew, (model, responses, lasting), runs, beside, observers)
        figures_of_run = validated.figures() | {"left_out": left_out}
        write_json(folder / "validation.json", figures_of_run)
        report("validating", 1, 1)

        report("drawing", 0, 1)
        figures = estimate_figures(validated)
        if model is not None:
            figures |= paper_figures(model, responses, validated.estimates)
        pictures = draw_figures(folder / "figures", figures, views)
        report("drawing", 1, 1)

        reports = {} if provenance is None else provenance.reports
        data = ReportData(
            title=case.title,
            facts=facts(case, responses[inputs.REFERENCE]),
            tables=()
            if tables is None or provenance is None
            else printed_tables(tables, provenance.at_bound),
            validation=validated.rows,
            left_out=left_out,
            schemes=compare_schemes(validated.rows, validated.as_printed, validated.vectors),
            blocks=validated.blocks,
            convergence={
                name: convergence(response) for name, response in (responses | lasting).items()
            },
            share=pressure_share(responses[inputs.PRESSURE]),
            placement="" if calibrated is None else calibrated.sensors_text,
            fits=reports | {observer.kind: fitted_text(observer) for observer in observers},
            pictures=pictures,
            case=case.model_dump_json(indent=2),
        )
        write_text(folder / "report.html", report_html(data))
    show(console.out(), data)


@contextmanager
def _or_why_not(left_out: dict[str, str], *methods: str) -> Iterator[None]:
    """Note the reason for leaving out these methods if the block cannot have them."""
    try:
        yield
    except ThermojointError as error:
        left_out |= dict.fromkeys(methods, str(error))


def _roles(calibrated: chain.Calibrated | None, reference: xr.Dataset) -> dict[str, str]:
    """Return role to probe: from the model, or any four around the source and at the joint."""
    names = probes_of(reference)
    if calibrated is not None and calibrated.placement is not None:
        return calibrated.placement.roles
    if named := named_sensors(names):
        return {role: role for role in named}
    near_source, at_joint = candidates_in(reference)
    last = dict(zip(names, reference["temperature"].to_numpy()[-1].tolist(), strict=True))
    hot_first = sorted(near_source, key=lambda name: -last[name])
    return dict(zip(ROLES, (hot_first[0], hot_first[-1], at_joint[0], at_joint[-1]), strict=True))


def _beside_calibration(
    case: Case, runs: LongRuns, folder: Path
) -> tuple[dict[str, xr.Dataset], dict[str, xr.Dataset] | ThermojointError, dict[str, Scene]]:
    """Return the results that do not depend on the choice of sensors.

    These are the long responses, the responses to steps until the machine is steady (or the reason
    why there are none), and scenes of the fields. The histories of the long responses are written
    to `folder`.
    """
    setup = set_up(case)
    lasting = simulate_long(case, runs, folder / "responses", setup, _silent)
    steps: dict[str, xr.Dataset] | ThermojointError
    try:
        steps = simulate_steady(case, runs, setup, _silent)
    except ThermojointError as error:
        steps = error
    return lasting, steps, field_scenes(_hot(case), setup, _silent)


def _hot(case: Case) -> Case:
    """Return the case for the pictures of the fields."""
    heat = (inputs.CALIBRATION | inputs.VALIDATION)[inputs.PRESSURE]
    return case.model_copy(update={"heat_input": heat})


def _silent(_task: str, _done: int, _all: int) -> None:
    """Report nothing."""


def _steady(case: Case, steps: Mapping[str, xr.Dataset], folder: Path) -> Model:
    """Return the model calibrated from steps until the machine is steady, with the same sensors."""
    _write_responses({f"{name}-steady": response for name, response in steps.items()}, folder)
    calibrated, provenance = _calibrate(case, steps)
    write_model(calibrated.model, folder / "model_steady.json", provenance)
    write_json(folder / "tables_steady.json", tables_json(calibrated.model, provenance))
    return calibrated.model


def _judged(
    crew: Executor,
    known: tuple[Model | None, Mapping[str, xr.Dataset], Mapping[str, xr.Dataset]],
    runs: LongRuns,
    beside: judge.Beside,
    observers: Sequence[JointAware],
) -> Validated:
    """Validate every estimator in every case; estimators without a warm start begin at rest.

    `known` are the model, its responses and the long responses.
    """
    model, responses, lasting = known
    at_rest = [(observer, observer.initial_state()) for observer in observers]
    # Samples after a warm start take longest, so each observer has a process.
    warm = [[(observer, observer.warm_state())] for observer in observers] or [[]]
    started = {inputs.WARM_START: warm_part(lasting[inputs.DAY], runs)}
    cold = replace(beside, observers=at_rest)
    begun = replace(beside, settled_s=60.0 * runs.settled)
    warmed = [
        crew.submit(
            judge.validate_model, model, None, started, beside=replace(begun, observers=own)
        )
        for own in warm
    ]
    long = crew.submit(judge.validate_model, model, None, lasting, beside=cold)
    short = crew.submit(
        judge.validate_model,
        model,
        responses[inputs.REFERENCE],
        {name: responses[name] for name in inputs.VALIDATION},
        noisy=[inputs.TRIANGLE],
        beside=cold,
    )
    hours = [without_nonlinear(run.result()) for run in (long, *warmed)]
    return judge.joined([short.result(), *hours])


def show(terminal: Console, data: ReportData) -> None:
    """Print the tables of a report."""
    printing.show_tables(terminal, data.tables)
    printing.show_estimators(terminal, error_table(data.validation))
    printing.show_schemes(terminal, data.schemes)
    printing.show_blocks(terminal, data.blocks)
    printing.show_convergence(terminal, data.convergence)
    if data.share is not None:
        printing.show_share(terminal, data.share)
    if data.placement:
        terminal.print(data.placement)
    for name, reason in data.left_out.items():
        terminal.print(f"{name} is left out: {reason}")
    if data.validation:
        terminal.print()
        terminal.print(verdict(data.validation))


def facts(case: Case, response: xr.Dataset) -> list[tuple[str, str]]:
    """Return versions, mesh sizes, solver and time step."""
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
    case: Case, responses: Mapping[str, xr.Dataset], rule: Rule = RULE
) -> tuple[chain.Calibrated, Provenance]:
    base, others = responses[inputs.REFERENCE], _others(responses)
    calibrated = chain.calibrate_responses(base, others, rule=rule)
    origin = case.model_dump_json()
    return calibrated, provenance_of(calibrated, origin)


def _others(responses: Mapping[str, xr.Dataset]) -> dict[float, xr.Dataset]:
    """Return the calibration responses other than the reference by their heat inputs."""
    return {
        float(responses[name]["heat_input"][-1]): responses[name]
        for name in inputs.CALIBRATION
        if name != inputs.REFERENCE
    }


def _kept(response: xr.Dataset, folder: Path, out: Path) -> xr.Dataset:
    """Return a response whose case refers to its histories in `out`, their final folder."""
    case = str(response.attrs["case"]).replace(str(folder), str(out.resolve()))
    return response.assign_attrs(case=case)


def _write_responses(responses: Mapping[str, xr.Dataset], folder: Path) -> None:
    for name, response in responses.items():
        write_response(response, folder / "responses" / f"{name}.nc")
