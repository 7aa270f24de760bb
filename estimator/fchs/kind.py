"""The paper's estimator as a kind: from a model file, or from an assembled estimator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator import measured
from estimator.fchs.estimator import Fchs
from estimator.intake import Intake, intake
from estimator.judging import Conditions, Figures
from estimator.kind import Cold, Kind, OnFirst, Options
from estimator.ranges import Range, calibrated_ranges
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.schema import states
from thermojoint.models.assembly import Assembly, assemble
from thermojoint.models.assembly_file import FILE, as_content, from_content, read_assembly
from thermojoint.models.model_file import read_model
from thermojoint.models.parameters import Model
from thermojoint.models.sensors import roles_in

if TYPE_CHECKING:
    import xarray as xr

    from estimator.export.program import Contents, Precision

#: A model is assembled when it is started; an assembled estimator is used as it is.
Given = Model | Assembly


def _read(path: Path) -> Given:
    return read_assembly(path) if states(path, FILE.schema) else read_model(path)


def _model(given: Given) -> Model:
    return given.model if isinstance(given, Assembly) else given


def _start(given: Given, options: Options) -> Fchs:
    if isinstance(given, Assembly):
        return Fchs(given)
    return Fchs(assemble(given, options.interval, options.run_length))


def _resumed(given: Given, options: Options, carried: Any, where: str) -> Fchs:  # noqa: ANN401
    """Resume with the same coefficients that the run started with."""
    assembly = from_content(carried, f"{where}: estimator")
    if assembly.model.digest != _model(given).digest:
        raise InputError(
            f"{where}: state of another model; start afresh, or use the model it was saved with"
        )
    if isinstance(given, Assembly) and _assembled_for(given) != _assembled_for(assembly):
        raise InputError(
            f"{where}: of an estimator assembled for {assembly.dt_s:g} s and "
            f"{assembly.run_length_s / 60.0:g} min; give that one"
        )
    return Fchs(assembly)


def _assembled_for(assembly: Assembly) -> tuple[float, float]:
    """Return the nominal sampling interval and the length of a run, s."""
    return assembly.dt_s, assembly.run_length_s


def _intake(given: Given, above_ambient: bool) -> Intake:
    sensors = list(_model(given).linear.direct)
    if above_ambient:
        names = ["delta_T_K", *(f"{name}_K" for name in sensors)]
        return intake(names, len(names), lambda readings, cold: (list(readings), cold))
    names = ["a_degC", "b_degC", *(f"{name}_degC" for name in sensors), "ambient_degC"]

    def convert(readings: Sequence[float], cold: float) -> tuple[list[float], float]:
        hot, back, *joint, ambient = readings
        return [hot - back, *(value - ambient for value in joint)], cold

    return intake(names, len(names), convert)


def _log(
    given: Given, pieces: Iterable[Log], where: str, on_first: OnFirst | None, cold: Cold
) -> Iterator[tuple[float, ...]]:
    sensors = list(_model(given).linear.direct)
    return measured.samples_in(pieces, sensors, where, on_first)


def _ranges(given: Given) -> tuple[Range, ...]:
    span = _model(given).span
    return calibrated_ranges(span.duration_s, span.heat, span.temperatures)


def _judge(
    kind: Kind[Given, Fchs],
    given: Given,
    responses: Mapping[str, xr.Dataset],
    conditions: Conditions,
) -> Figures:
    from estimator.fchs.judging import Beside, validate_model

    seen = {
        conditions.named(name): conditions.noisy(response, kind.sensors(given, response))
        for name, response in responses.items()
    }
    beside = Beside(conditions.baselines)
    return validate_model(_model(given), conditions.reference, seen, beside=beside).figures()


def _program(estimator: Fchs, precision: Precision, interval: float) -> Contents:
    from estimator.fchs.program import contents

    return contents(estimator)


KIND: Kind[Given, Fchs] = Kind(
    name="a model of the paper's kind",
    read=_read,
    fingerprint=lambda given: _model(given).digest,
    start=_start,
    paced=True,
    assembled_for=lambda estimator: _assembled_for(estimator.assembly),
    assembled=lambda given: isinstance(given, Assembly),
    carried=lambda estimator: as_content(estimator.assembly),
    resumed=_resumed,
    intake=_intake,
    log=_log,
    response=lambda given, response: measured.response_samples(response, _model(given)),
    sensors=lambda given, seen: list(dict.fromkeys(roles_in(seen, _model(given)).values())),
    ranges=_ranges,
    judge=_judge,
    program=_program,
)
