"""What the commands of models do where the model is the machine's own physics."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds

if TYPE_CHECKING:
    import xarray as xr

    from artefacts.arrays import Array
    from estimator.joint_aware.ageing import AgeingJointAware
    from estimator.joint_aware.estimator import JointAware

Sample = tuple[float, ...]


def calibrate(case: Path | None, responses: Sequence[Path], out: Path) -> None:
    """Fit the machine of a case to its responses, and write the observer made of it."""
    from artefacts.response import read_response
    from estimator.joint_aware.calibration import calibrate_joint_aware, report
    from estimator.joint_aware.model_file import write_observer
    from fesim.case.schema import read_case
    from thermojoint.cli import console, plausibility

    if case is None:
        raise InputError("--kind joint-aware: needs the machine; add --case MACHINE.toml")
    machine = read_case(case)
    inputs = [case, *arguments.files_of(machine), *responses]
    arguments.check_outputs({"--out": (out, file_kinds.OBSERVER)}, inputs)
    if len(set(responses)) < len(responses):
        raise InputError("--input: a response is given twice; give each once")
    console.warn(plausibility.of_case(machine, str(case)))
    read = {str(path): read_response(path) for path in responses}
    for name, response in read.items():
        console.warn(plausibility.of_response(response, name))
    with console.progress_bars() as progress:
        progress("calibrating", 0, 1)
        calibrated = calibrate_joint_aware(machine, read)
        progress("calibrating", 1, 1)
    write_observer(calibrated.model, out)
    console.show_physics(console.out(), report(calibrated.fit))
    console.wrote(out)


def opened(
    model: Path,
    source: TextIO | None,
    response: xr.Dataset | None,
    where: str,
    resume: Path | None,
    ageing: str | None = None,
) -> tuple[JointAware | AgeingJointAware, Array, Iterable[Sample]]:
    """Return the estimator, the state to go on from, and the samples of a log or a response."""
    from estimator.joint_aware.log import read_log
    from estimator.joint_aware.readings import samples_in
    from estimator.joint_aware.starting import started

    estimator, state = started(model, resume, parameters(ageing))
    names = estimator.model.sensors
    if source is not None:
        return estimator, state, read_log(source, names, where)
    if response is None:
        raise InputError(f"{where}: no log and no response; give one of them")
    return estimator, state, samples_in(response, names)


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
    from artefacts.files import write_text
    from estimator import noise
    from estimator.joint_aware.estimator import JointAware
    from estimator.joint_aware.judging import judge
    from estimator.joint_aware.model_file import read_observer
    from thermojoint.cli import console

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
    console.show_bands(console.out(), rows)
    console.wrote(out)
