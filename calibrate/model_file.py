"""The model file: a calibrated `Model` as JSON, with its units and where it came from.

The classes below are what stands in the file. They refuse unknown keys, numbers given as text,
NaN and infinity; numbers survive the way there and back to the last bit.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError

from artefacts.errors import InputError
from artefacts.files import write_text
from calibrate.model import (
    DeformationModel,
    FictitiousSource,
    LinearModel,
    Model,
    Regularisation,
    Relaxation,
    RingModel,
)

SCHEMA = "thermojoint-model"
SCHEMA_VERSION = 1
#: Sensors that the estimator reads.
SENSOR_ROLES = ("a", "b", "T1", "T2")
#: Written into every file; heat input and strengths are dimensionless.
UNITS = {
    "K": "K",
    "a": "m-2",
    "alpha": "m2 s-1",
    "r, r0, distances, sensors": "m",
    "A": "K s-1",
    "B": "K s-2",
    "gamma": "s-1",
    "amplitudes": "K",
    "c, d, e, f, rates": "s-1",
    "C, D": "m",
    "E, F": "m s-1",
    "reference_power_W": "W",
    "max_abs_error_K": "K",
    "max_abs_error_um": "um",
}


@dataclass(frozen=True)
class Provenance:
    """Where a model came from and how well it fitted.

    Attributes
    ----------
    case : str
        The case (TOML text) or the name of the measured structure.
    versions : dict
        Package to version.
    max_abs_error_K : dict
        Model, e.g. "thermal" or "direct.T1", to its largest calibration error, K.
    max_abs_error_um : dict
        Model, e.g. "deformation.x", to its largest calibration error, µm.
    reports : dict
        Model to the text of its fit report.
    at_bound : dict
        Model to the names of its parameters that ended at a bound.
    """

    case: str
    versions: dict[str, str] = field(default_factory=dict)
    max_abs_error_K: dict[str, float] = field(default_factory=dict)
    max_abs_error_um: dict[str, float] = field(default_factory=dict)
    reports: dict[str, str] = field(default_factory=dict)
    at_bound: dict[str, list[str]] = field(default_factory=dict)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class _Ring(_Strict):
    kind: Literal["ring"]
    K: float
    a: PositiveFloat
    alpha: PositiveFloat
    r: float = Field(ge=0.0)
    r0: PositiveFloat


class _Relaxation(_Strict):
    kind: Literal["relaxation"]
    amplitudes: list[float]
    rates: list[PositiveFloat]


class _Regularisation(_Strict):
    A: float
    B: float
    gamma: PositiveFloat


class _Deformation(_Strict):
    C: float
    D: float
    E: float
    c: PositiveFloat
    d: PositiveFloat
    e: PositiveFloat
    F: float
    f: float = Field(ge=0.0)


class _Linear(_Strict):
    thermal: _Ring
    regularisation: _Regularisation
    deformation: dict[str, _Deformation]
    direct: dict[str, Annotated[_Ring | _Relaxation, Field(discriminator="kind")]]


class _Source(_Strict):
    K: float
    a: PositiveFloat
    alpha: PositiveFloat
    r0: PositiveFloat
    strengths: dict[str, float]
    regularisation: _Regularisation
    deformation: dict[str, _Deformation]
    driven: dict[str, _Deformation]


class _Provenance(_Strict):
    case: str
    versions: dict[str, str]
    max_abs_error_K: dict[str, float]
    max_abs_error_um: dict[str, float]
    reports: dict[str, str]
    at_bound: dict[str, list[str]] = {}  # files of before have none


class _File(_Strict):
    schema_name: Literal["thermojoint-model"] = Field(alias="schema")
    schema_version: Literal[1]
    units: dict[str, str]
    provenance: _Provenance
    linear: _Linear
    sources: list[_Source]
    distances: list[list[PositiveFloat]]
    sensors: dict[str, list[float]]
    reference_power_W: PositiveFloat


def _thermal_json(model: RingModel | Relaxation) -> dict[str, object]:
    kind = "ring" if isinstance(model, RingModel) else "relaxation"
    return {"kind": kind} | asdict(model)


def _as_json(model: Model, provenance: Provenance) -> dict[str, object]:
    linear = asdict(model.linear)
    linear["thermal"] = _thermal_json(model.linear.thermal)
    linear["direct"] = {name: _thermal_json(part) for name, part in model.linear.direct.items()}
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "units": UNITS,
        "provenance": asdict(provenance),
        "linear": linear,
        "sources": [asdict(source) for source in model.sources],
        "distances": model.distances,
        "sensors": model.sensors,
        "reference_power_W": model.reference_power_W,
    }


def write_model(model: Model, path: Path, provenance: Provenance) -> None:
    """Write `model` to `path` (JSON), whole or not at all.

    Raises
    ------
    InputError
        The model would not be readable: a value that is not finite or out of range, a sensor or an
        axis missing.
    """
    try:
        text = json.dumps(_as_json(model, provenance), indent=2, allow_nan=False)
    except ValueError as error:
        raise InputError(
            f"{path}: the model has a value that is not finite; nothing written"
        ) from (error)
    _parse(text, f"{path} (to be written)")
    write_text(Path(path), text + "\n")


def read_model(path: Path) -> Model:
    """Read a model written by `write_model`.

    Raises
    ------
    InputError
        The file is missing, truncated, of another version, has an unknown key, a value that is not
        finite or out of range, or lacks a sensor or an axis.
    """
    return _to_model(_read(path))


def read_provenance(path: Path) -> Provenance:
    """Read where the model at `path` came from; raises as `read_model`."""
    return Provenance(**_read(path).provenance.model_dump())


def _read(path: Path) -> _File:
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a model written by 'thermojoint calibrate'")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; calibrate again") from error
    return _parse(text, str(path))


def _parse(text: str, where: str) -> _File:
    try:
        raw = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{where}: not valid JSON at line {error.lineno}, perhaps truncated; calibrate again"
        ) from error
    if not isinstance(raw, dict) or raw.get("schema") != SCHEMA:
        raise InputError(f"{where}: not a {SCHEMA!r} file; give one written by 'calibrate'")
    version = raw.get("schema_version")
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{where}: model version {version!r}, expected {SCHEMA_VERSION}; calibrate again with "
            "this version"
        )
    try:
        # From the parsed JSON, not from Python objects: lists are then read as JSON arrays.
        file = _File.model_validate_json(text)
    except ValidationError as error:
        problems = error.errors()
        first = problems[0]
        place = ".".join(str(part) for part in first["loc"])
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(f"{where}: {place}: {first['msg']}{more}; correct it") from error
    _check_consistent(file, where)
    return file


def _check_consistent(file: _File, where: str) -> None:
    """Raise InputError unless units, sensors, axes, distances and spectra fit together."""
    if file.units != UNITS:
        raise InputError(f"{where}: units differ from {UNITS}; convert the values")
    for role in SENSOR_ROLES:
        if role not in file.sensors:
            raise InputError(f"{where}: sensors: {role!r} is missing; give its position in m")
        if len(file.sensors[role]) != 3:
            raise InputError(f"{where}: sensors: {role!r} needs three coordinates in m")
    for role in SENSOR_ROLES[2:]:
        if role not in file.linear.direct:
            raise InputError(f"{where}: linear.direct: the model of {role!r} is missing")
    for name, part in file.linear.direct.items():
        if isinstance(part, _Relaxation) and len(part.amplitudes) != len(part.rates):
            raise InputError(f"{where}: linear.direct.{name}: as many amplitudes as rates needed")
    axes = set(file.linear.deformation)
    if not axes:
        raise InputError(f"{where}: linear.deformation: no axis; calibrate at least one")
    for index, source in enumerate(file.sources):
        if set(source.deformation) != axes:
            raise InputError(f"{where}: sources.{index}.deformation: axes differ from {axes}")
    shape = [len(row) for row in file.distances]
    if shape != [len(file.linear.direct)] * len(file.sources):
        raise InputError(f"{where}: distances: one row per source, one column per sensor needed")


def _ring(part: _Ring) -> RingModel:
    return RingModel(**part.model_dump(exclude={"kind"}))


def _deformations(parts: dict[str, _Deformation]) -> dict[str, DeformationModel]:
    return {axis: DeformationModel(**part.model_dump()) for axis, part in parts.items()}


def _to_model(file: _File) -> Model:
    linear = file.linear
    direct: dict[str, RingModel | Relaxation] = {
        name: _ring(part)
        if isinstance(part, _Ring)
        else Relaxation(tuple(part.amplitudes), tuple(part.rates))
        for name, part in linear.direct.items()
    }
    return Model(
        linear=LinearModel(
            thermal=_ring(linear.thermal),
            regularisation=Regularisation(**linear.regularisation.model_dump()),
            deformation=_deformations(linear.deformation),
            direct=direct,
        ),
        sources=tuple(
            FictitiousSource(
                K=source.K,
                a=source.a,
                alpha=source.alpha,
                r0=source.r0,
                strengths=dict(source.strengths),
                regularisation=Regularisation(**source.regularisation.model_dump()),
                deformation=_deformations(source.deformation),
                driven=_deformations(source.driven),
            )
            for source in file.sources
        ),
        distances=tuple(tuple(row) for row in file.distances),
        sensors={name: (xyz[0], xyz[1], xyz[2]) for name, xyz in file.sensors.items()},
        reference_power_W=file.reference_power_W,
    )
