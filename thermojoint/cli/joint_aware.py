"""Calibration and learning of joint-aware models for the commands `calibrate` and `learn`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds

if TYPE_CHECKING:
    import xarray as xr

    from fesim.case.schema import Case

#: Option of both commands.
CaseOption = Annotated[
    Path | None, typer.Option(help="Case file of the machine, for --kind joint-aware.")
]


def calibrate(
    case: Path | None, responses: Sequence[Path], out: Path, report_file: Path | None
) -> None:
    """Fit the machine of a case to its responses, and write its joint-aware model."""
    from thermojoint import console, plausibility
    from thermojoint.artefacts.response import read_response

    machine = _machine(case, responses, out, report_file)
    if len(set(responses)) < len(responses):
        raise InputError("--input: a response is given twice; give each once")
    read = {str(path): read_response(path) for path in responses}
    for name, response in read.items():
        console.warn(plausibility.of_response(response, name))
    _fitted(machine, read, out, report_file)


def learn(
    case: Path | None,
    logs: Sequence[Path],
    displacement: Sequence[str],
    renamed: Mapping[str, str],
    out: Path,
) -> None:
    """Fit the machine of a case to the runs of a measured log."""
    from thermojoint.artefacts.log import joined
    from thermojoint.artefacts.log_file import log_pieces
    from thermojoint.cli.log_reading import reported

    machine = _machine(case, logs, out, None)
    log = joined(reported(log_pieces(logs, renamed)))
    from calibrate.joint_aware.measured_runs import runs_of

    _fitted(machine, runs_of(log, machine, displacement), out, None)


def _machine(case: Path | None, data: Sequence[Path], out: Path, report_file: Path | None) -> Case:
    """Read the case, and check the output files."""
    from fesim.case.schema import read_case
    from thermojoint import console, plausibility
    from thermojoint.artefacts.settings.section import files_of

    if case is None:
        raise InputError("--kind joint-aware: needs the machine; add --case MACHINE.toml")
    machine = read_case(case)
    arguments.check_outputs(
        {
            "--out": (out, file_kinds.OBSERVER),
            "--json": (report_file, file_kinds.CALIBRATION_REPORT),
        },
        [case, *files_of(machine), *data],
    )
    console.warn(plausibility.of_case(machine, str(case)))
    return machine


def _fitted(
    machine: Case, read: Mapping[str, xr.Dataset], out: Path, report_file: Path | None
) -> None:
    """Calibrate the machine, write the model and its report, and print the parameters."""
    from calibrate.joint_aware.calibration import calibrate_joint_aware
    from calibrate.joint_aware.report import short_report, whole_report
    from estimator.joint_aware.model_file import write_observer
    from thermojoint import console
    from thermojoint.cli import results

    with console.working("calibrating"):
        calibrated = calibrate_joint_aware(machine, read)
        content = whole_report(calibrated) if report_file else short_report(calibrated)
    write_observer(calibrated.model, out)
    arguments.write_json(report_file, content)
    results.show_physics(console.out(report_file), content)
    console.wrote(out, report_file)
