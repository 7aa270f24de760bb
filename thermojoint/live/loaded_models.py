"""Models of a service: each file is opened once and shared by its machines."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from estimator.intake import Intake, axis_name
from estimator.interface import Estimator
from estimator.kind import Kind, OpenedEstimator, Options, checked_limit
from estimator.lines import places_in
from estimator.ranges import Range
from estimator.registry import kind_of_file, resumed, save_state, started
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, ThermojointError
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.handshake import HandshakeSettings
from thermojoint.compensation.offsets.settings import (
    Settings,
    check_axes,
    read_settings,
    with_slopes,
)
from thermojoint.live.next_reading import RequestLimits
from thermojoint.live.publication import AxisLine, Layout
from thermojoint.live.samples import AssemblyRule
from thermojoint.live.settings import HandshakeSection, ModelSection, Service

#: Default tolerance of the handshake with a target, um.
TARGET_DIFFERS_UM = 10.0


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """An opened model with everything that its machines share."""

    #: Estimator of any kind.
    estimator: Estimator
    #: Digest of the model; a state continues with a model of the same digest.
    digest: str
    #: Name of its file.
    file: str
    #: Readings of its machines.
    intake: Intake
    ranges: tuple[Range, ...]
    #: (estimator, state, sample) to reading minus model; None for a kind without residuals.
    residuals: Callable[[Any, Array, Array], Array] | None
    rule: AssemblyRule
    #: Names of the published values.
    layout: Layout
    #: Settings of the compensation output.
    output: Settings | None
    #: Handshake with the control of a machine, added by `machine_models`.
    handshake: HandshakeSettings | None = None
    request_limits: RequestLimits | None = None
    #: Indices of the details that are displacements at axis positions, by name.
    places: Mapping[str, int] = field(default_factory=dict)


def load_models(service: Service) -> tuple[dict[str, LoadedModel], dict[str, ThermojointError]]:
    """Return the models of a service that can be opened, and the errors of the others."""
    opened: dict[str, LoadedModel] = {}
    refused: dict[str, ThermojointError] = {}
    for name, section in service.given.models.items():
        try:
            opened[name] = load_model(section, service.folder / "models")
        except ThermojointError as error:
            refused[name] = error
    return opened, refused


def load_model(section: ModelSection, folder: Path) -> LoadedModel:
    """Open the model of a section.

    `folder` is for assembled coefficients, with which a restarted service continues.

    Raises
    ------
    InputError
        A file is unusable, or the model and the settings do not match.
    ConvergenceError
        The model cannot be assembled at the interval.
    """
    path = section.file
    kind = kind_of_file(path)
    model = kind.read(path)
    intake = kind.intake(model, section.reads == "above-ambient")
    estimator, digest = _open_estimator(kind, model, section, folder)
    output = None
    if section.offsets is not None:
        strokes = kind.strokes(model)
        output = with_slopes(read_settings(section.offsets), strokes, str(section.offsets))
    axes = tuple(map(axis_name, estimator.axes))
    places = places_in(axes, [channel.name for channel in estimator.details])
    if output is not None:
        check_axes(output, (*axes, *places), str(section.offsets))
        _check_age(output, section)
    layout = Layout(
        axes=axes,
        controls=output.output.names if output else (),
        details=estimator.details,
        readings=intake.names,
        lines=lines_in(output),
    )
    _warm_up(estimator, section.interval_s)
    rule = AssemblyRule(section.interval_s, section.lateness_s, section.hold_s, intake.wanted)
    return LoadedModel(
        estimator,
        digest,
        path.name,
        intake,
        kind.ranges(model),
        kind.residuals,
        rule,
        layout,
        output,
        request_limits=_request_limits(kind, estimator, section),
        places=places,
    )


def lines_in(output: Settings | None) -> tuple[AxisLine, ...]:
    """Return the lines that a control receives under some settings."""
    slopes = () if output is None else output.output.slopes
    return tuple(AxisLine(one.axis, one.reference, one.lever) for one in slopes)


def _warm_up(estimator: Estimator, interval: float) -> None:
    """Compile, and compute tables, by samples without effect: no machine waits for it later.

    In the last one all readings are missing.
    """
    state = estimator.initial_state()
    for k, value in enumerate((0.0, 0.0, 0.0, math.nan)):
        with suppress(ThermojointError):
            state, _ = estimator.sample(state, k * interval, [value] * len(estimator.channels))


def _request_limits(
    kind: Kind[Any, Any], estimator: OpenedEstimator, section: ModelSection
) -> RequestLimits | None:
    """Return the conditions for requesting readings; refuse a limit that none can satisfy."""
    given, next_reading = section.next_reading, kind.next_reading
    if given is None:
        return None
    limit = MICRO * given.above_um
    checked_limit(kind, estimator, limit, f"{section.file}: next_reading.above_um")
    if next_reading is None:
        return None
    return RequestLimits(
        limit, 60.0 * given.interval_min, lambda state: next_reading(estimator, state, limit)
    )


def _check_age(output: Settings, section: ModelSection) -> None:
    """Refuse an `oldest_s` with which every estimate is too old before the next one."""
    if output.trust.oldest <= section.interval_s:
        raise InputError(
            f"{section.offsets}: oldest_s {output.trust.oldest:g} is not longer than interval_s "
            f"{section.interval_s:g} of the model: offsets would never follow; make it longer"
        )


def _open_estimator(
    kind: Kind[Any, Any],
    model: Any,  # noqa: ANN401
    section: ModelSection,
    folder: Path,
) -> tuple[OpenedEstimator, str]:
    """Start the estimator, or reuse the coefficients of the same file and interval."""
    options = Options(section.interval_s, 60.0 * section.run_length_min)
    content, reusable = f"{kind.fingerprint(model)} {section.reads}", kind.paced
    if kind.assembled(model) and kind.carried:
        # The coefficients are in the file; another file of the same model has other ones.
        content, reusable = f"{kind.carried(started(kind, model, options))!r} {content}", False
    if reusable:
        content = f"{section.interval_s!r} {section.run_length_min!r} {content}"
    digest = hashlib.sha256(content.encode()).hexdigest()
    coefficients = folder / f"{digest[:32]}.json"
    if reusable and coefficients.is_file():
        return resumed(kind, model, options, coefficients)[0], digest
    estimator = started(kind, model, options)
    if reusable:
        coefficients.parent.mkdir(parents=True, exist_ok=True)
        save_state(estimator, estimator.initial_state(), coefficients)
    return estimator, digest


def machine_models(models: Mapping[str, LoadedModel], service: Service) -> dict[str, LoadedModel]:
    """Return the model of every machine, with the handshake of its control."""
    return {
        name: replace(models[section.model], handshake=handshake_settings(section.handshake))
        for name, section in service.machines.items()
    }


def handshake_settings(section: HandshakeSection | None) -> HandshakeSettings | None:
    """Return the limits of a handshake in SI; None without one."""
    if section is None:
        return None
    differs = section.differs_um
    if differs is None:
        # The values in force in a target are always known.
        differs = TARGET_DIFFERS_UM if section.by == "target" else math.inf
    return HandshakeSettings(section.heartbeat_s, MICRO * differs, section.differs_s)
