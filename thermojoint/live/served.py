"""The models of a service: each file opened once, shared by all machines that run with it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from estimator.fchs.estimator import Fchs
from estimator.interface import Estimator
from estimator.joint_aware.model_file import fingerprint
from estimator.joint_aware.recognition import is_observer
from estimator.joint_aware.starting import started as started_joint_aware
from estimator.learned.starting import started as started_learned
from estimator.starting import started as started_fchs
from thermojoint.artefacts.errors import ThermojointError, unknown_name
from thermojoint.compensation.offsets.settings import Settings, read_settings
from thermojoint.live.intake import Intake, axis_name, intake_of
from thermojoint.live.publication import Layout
from thermojoint.live.samples import Rule
from thermojoint.live.settings import ModelSection, Service
from thermojoint.models.assembly_file import write_assembly
from thermojoint.models.learned import is_learned


@dataclass(frozen=True, eq=False)
class Served:
    """A model with all that its machines share.

    Attributes
    ----------
    estimator : Estimator
        Of any kind.
    digest : str
        A state goes on with the model of the same one.
    file : str
        Where it came from, as the service file says.
    intake : Intake
        What its machines read.
    rule : Rule
        How their samples are made.
    layout : Layout
        Names of what is published of them.
    output : Settings or None
        Of the compensation output.
    """

    estimator: Estimator
    digest: str
    file: str
    intake: Intake
    rule: Rule
    layout: Layout
    output: Settings | None


def served_models(service: Service) -> dict[str, Served]:
    """Open the models of a service; raises as their readers and as `served`."""
    return {
        name: served(section, service.base, service.folder / "models")
        for name, section in service.given.models.items()
    }


def served(section: ModelSection, base: Path, kept: Path) -> Served:
    """Open one model.

    Parameters
    ----------
    section : ModelSection
        What the service file says of it.
    base : Path
        Where its paths begin.
    kept : Path
        Folder for what is assembled from it: a service goes on with the coefficients it began with.

    Raises
    ------
    InputError
        A file is unusable, or the model and the settings do not fit.
    ConvergenceError
        The model cannot be assembled at the interval.
    """
    estimator, digest = _opened(section, base, kept)
    intake = intake_of(estimator, section.reads == "above-ambient")
    output = None if section.offsets is None else read_settings(base / section.offsets)
    axes = tuple(map(axis_name, estimator.axes))
    if output is not None:
        _check_axes(output, axes, section.offsets or "")
    layout = Layout(
        axes=axes,
        controls=output.output.names if output else (),
        details=estimator.details,
        readings=intake.names,
    )
    _warm_up(estimator, section.interval_s)
    rule = Rule(section.interval_s, section.lateness_s, section.hold_s, intake.wanted)
    return Served(estimator, digest, section.file, intake, rule, layout, output)


def _warm_up(estimator: Estimator, interval: float) -> None:
    """Take samples that count nowhere: machine code is made now, not while a machine waits."""
    state = estimator.initial_state()
    for k in range(3):
        with suppress(ThermojointError):
            state, _ = estimator.sample(state, k * interval, [0.0] * len(estimator.channels))


def _check_axes(output: Settings, axes: tuple[str, ...], where: str) -> None:
    for name in output.output.estimated:
        if name not in axes:
            raise unknown_name("axis", name, axes, f"{where}: axes: the estimate has")


def _opened(section: ModelSection, base: Path, kept: Path) -> tuple[Estimator, str]:
    path = base / section.file
    reads = section.reads
    if is_learned(path):
        learned, _ = started_learned(path)
        return learned, f"learned {learned.model.digest}"
    if is_observer(path):
        observer, _ = started_joint_aware(path)
        return observer, f"{observer.kind} {fingerprint(observer.model)} {reads}"
    content = path.read_bytes() if path.is_file() else b""
    made_of = f"{section.interval_s!r} {section.run_length_min!r} "
    digest = hashlib.sha256(made_of.encode() + content).hexdigest()
    own = kept / f"{digest[:32]}.json"
    source = own if own.is_file() else path
    fchs, _ = started_fchs(source, section.interval_s, 60.0 * section.run_length_min)
    if source is path:
        _keep(fchs, own)
    return fchs, f"fchs {digest} {reads}"


def _keep(estimator: Fchs, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_assembly(estimator.assembly, path)


def single(models: Mapping[str, Served], service: Service) -> dict[str, Served]:
    """Return the model of every single machine."""
    return {name: models[section.model] for name, section in service.machines.items()}
