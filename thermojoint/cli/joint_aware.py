"""What the commands of models do where the model is the machine's own physics."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds

if TYPE_CHECKING:
    import xarray as xr

    from estimator.joint_aware.ageing import AgeingJointAware
    from estimator.joint_aware.estimator import JointAware
    from fesim.case.schema import Case
    from thermojoint.artefacts.arrays import Array

Sample = tuple[float, ...]


@dataclass(frozen=True)
class Start:
    """How an estimator begins, and what it reads beside its temperatures.

    Attributes
    ----------
    resume : Path, optional
        A saved state.
    warm : bool
        Nothing is known of the machine's past.
    touches : Path, optional
        Readings of the displacement, CSV.
    touch_noise_um : float, optional
        Their standard deviation, µm.
    ageing : str, optional
        What is learnt as the machine runs, ``preload,film``.
    """

    resume: Path | None = None
    warm: bool = False
    touches: Path | None = None
    touch_noise_um: float | None = None
    ageing: str | None = None


def calibrate(
    case: Path | None, responses: Sequence[Path], out: Path, report_file: Path | None
) -> None:
    """Fit the machine of a case to its responses, and write the observer made of it."""
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
    from thermojoint.artefacts.log_file import read_log

    machine = _machine(case, logs, out, None)
    log = read_log(logs, renamed)
    from calibrate.joint_aware.measured_runs import runs_of

    _fitted(machine, runs_of(log, machine, displacement), out, None)


def _machine(case: Path | None, data: Sequence[Path], out: Path, report_file: Path | None) -> Case:
    """Read the case, and check what is to be written."""
    from fesim.case.schema import read_case
    from thermojoint import console, plausibility
    from thermojoint.artefacts.settings.section import files_of

    if case is None:
        raise InputError("--kind joint-aware: needs the machine; add --case MACHINE.toml")
    machine = read_case(case)
    arguments.check_outputs(
        {
            "--out": (out, file_kinds.OBSERVER),
            "--report": (report_file, file_kinds.CALIBRATION_REPORT),
        },
        [case, *files_of(machine), *data],
    )
    console.warn(plausibility.of_case(machine, str(case)))
    return machine


def _fitted(
    machine: Case, read: Mapping[str, xr.Dataset], out: Path, report_file: Path | None
) -> None:
    """Calibrate, write and show."""
    from calibrate.joint_aware.calibration import calibrate_joint_aware, report
    from calibrate.joint_aware.report import whole_report
    from estimator.joint_aware.model_file import write_observer
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.cli import results

    with console.working("calibrating"):
        calibrated = calibrate_joint_aware(machine, read)
        told = whole_report(calibrated) if report_file else report(calibrated.fit)
    write_observer(calibrated.model, out)
    if report_file:
        write_text(report_file, json.dumps(told, indent=2, allow_nan=False) + "\n")
    results.show_physics(console.out(), told)
    console.wrote(out)


def opened(
    model: Path,
    source: TextIO | None,
    response: xr.Dataset | None,
    where: str,
    start: Start,
) -> tuple[JointAware | AgeingJointAware, Array, Iterable[Sample]]:
    """Return the estimator, the state to go on from, and the samples of a log or a response."""
    from estimator.joint_aware.log import read_log
    from estimator.joint_aware.readings import samples_in
    from estimator.joint_aware.starting import started
    from estimator.touches import read_touches, with_touches

    if start.resume and start.warm:
        raise InputError("--warm: a saved state knows the past; leave out --warm or --continue")
    noise = arguments.reading_noise(start.touch_noise_um, start.touches)
    estimator, state = started(model, start.resume, parameters(start.ageing), noise)
    if start.warm:
        state = estimator.warm_state()
    names = estimator.model.sensors
    samples: Iterable[Sample]
    if source is not None:
        samples = read_log(source, names, where)
    elif response is not None:
        samples = samples_in(response, names)
    else:
        raise InputError(f"{where}: no log and no response; give one of them")
    if start.touches is not None:
        samples = with_touches(samples, *read_touches(start.touches, estimator.axes))
    return estimator, state, samples


def parameters(ageing: str | None) -> list[str]:
    """Return the names in ``preload,film``; an empty text is one empty name, which is refused."""
    return [] if ageing is None else [name.strip() for name in ageing.split(",")]


def save(estimator: JointAware | AgeingJointAware, path: Path, state: Array) -> None:
    """Write a state beside the model it belongs to."""
    from estimator.joint_aware.saved_state import save_state

    save_state(estimator, state, path)


def validate(
    model: Path,
    responses: Mapping[str, xr.Dataset],
    noise_pp: float | None,
    seed: int,
    out: Path | None,
) -> None:
    """Judge an observer by responses, by its band, too."""
    from estimator import noise
    from estimator.joint_aware.estimator import JointAware
    from estimator.joint_aware.judging import judge
    from estimator.joint_aware.model_file import read_observer
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.cli import results

    estimator = JointAware(read_observer(model))
    rows = []
    for name, response in responses.items():
        added, case = None, name
        if noise_pp is not None:
            case = f"{name}, {noise_pp:g} K noise"
            times = response["time"].to_numpy()
            added = noise.sensor_noise(times, noise_pp, seed, len(estimator.model.sensors))
        rows += judge(case, response, estimator, added)[0]
    if out:
        write_text(out, json.dumps({"rows": rows}, indent=2) + "\n")
    results.show_bands(console.out(), rows)
    console.wrote(out)
