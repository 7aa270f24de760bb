"""The model file: a calibrated `Model` as JSON with its units and provenance.

The classes of `thermojoint.models.parameters` define the content and its validation; numbers are
read back bit for bit.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.json_file import JsonKind, parse_json, read_json, validated
from thermojoint.models.parameters import STRICT, Model, Relaxation
from thermojoint.models.sensors import HEAT_SENSORS

FILE = JsonKind(
    "thermojoint-model", 3, "model", "written by 'thermojoint calibrate'", "calibrate again"
)
#: Kind of estimator: the one of the paper.
KIND = "fchs"
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
    "c, d, e, f, rates, leak": "s-1",
    "C, D": "m",
    "E, F": "m s-1",
    "reference_power_W": "W",
    "duration_s": "s",
    "temperatures": "K",
    "max_abs_error_K": "K",
    "max_abs_error_um": "um",
}


@dataclass(frozen=True)
class Provenance:
    """Provenance of a model and quality of its fit.

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

    __pydantic_config__ = STRICT

    case: str
    versions: dict[str, str] = field(default_factory=dict)
    max_abs_error_K: dict[str, float] = field(default_factory=dict)
    max_abs_error_um: dict[str, float] = field(default_factory=dict)
    reports: dict[str, str] = field(default_factory=dict)
    at_bound: dict[str, list[str]] = field(default_factory=dict)


_MODEL: TypeAdapter[Model] = TypeAdapter(Model)
_PROVENANCE: TypeAdapter[Provenance] = TypeAdapter(Provenance)


def write_model(model: Model, path: Path | str, provenance: Provenance) -> None:
    """Write a model, whole or not at all.

    Parameters
    ----------
    model : Model
        Tables 1-3.
    path : Path or str
        JSON to write.
    provenance : Provenance
        Its provenance, e.g. from `calibrate.provenance.provenance_of`.

    Raises
    ------
    InputError
        The model is invalid: a value is not finite or out of range, or a sensor or an axis is
        missing.
    """
    content = {
        **FILE.header,
        "kind": KIND,
        "units": UNITS,
        "provenance": _PROVENANCE.dump_python(provenance, mode="json"),
        **_MODEL.dump_python(model, mode="json"),
    }
    try:
        text = json.dumps(content, indent=2, allow_nan=False)
    except ValueError as error:
        raise InputError(
            f"{path}: the model has a value that is not finite; nothing written"
        ) from error
    where = f"{path} (to be written)"
    _parsed(parse_json(text, FILE, where), where)
    write_text(Path(path), text + "\n")


def read_model(path: Path | str) -> Model:
    """Read a model.

    Parameters
    ----------
    path : Path or str
        JSON written by `write_model`.

    Raises
    ------
    InputError
        The file is missing, truncated, of another version, has an unknown key, a value that is not
        finite or out of range, or lacks a sensor or an axis.
    """
    return _read(path)[0]


def read_provenance(path: Path | str) -> Provenance:
    """Read the provenance of a model; raises as `read_model`.

    Parameters
    ----------
    path : Path or str
        JSON written by `write_model`.
    """
    return _read(path)[1]


def _read(path: Path | str) -> tuple[Model, Provenance]:
    return _parsed(read_json(path, FILE), str(path))


def _parsed(content: dict[str, Any], where: str) -> tuple[Model, Provenance]:
    kind = content.pop("kind", None)
    if kind != KIND:
        raise InputError(f"{where}: a model of kind {kind!r}, expected {KIND!r}; give such a model")
    if content.pop("units", None) != UNITS:
        raise InputError(f"{where}: units differ from {UNITS}; convert the values")
    provenance = validated(
        _PROVENANCE, content.pop("provenance", None), f"{where}: provenance", "correct it"
    )
    model = validated(_MODEL, content, where, "correct it", {"RingModel", "Relaxation"})
    _check_consistent(model, where)
    return model, provenance


def _check_consistent(model: Model, where: str) -> None:
    """Raise InputError unless sensors, axes, distances and spectra fit together."""
    for role in (*HEAT_SENSORS, *model.linear.direct):
        if role not in model.sensors:
            raise InputError(f"{where}: sensors: {role!r} is missing; give its position in m")
    if not model.linear.direct:
        raise InputError(f"{where}: linear.direct: no sensor at the joint; give at least T1")
    for name, part in model.linear.direct.items():
        if isinstance(part, Relaxation) and len(part.amplitudes) != len(part.rates):
            raise InputError(f"{where}: linear.direct.{name}: as many amplitudes as rates needed")
    axes = set(model.linear.deformation)
    if not axes:
        raise InputError(f"{where}: linear.deformation: no axis; calibrate at least one")
    for index, source in enumerate(model.sources):
        if set(source.deformation) != axes:
            raise InputError(f"{where}: sources.{index}.deformation: axes differ from {axes}")
    shape = [len(row) for row in model.distances]
    if shape != [len(model.linear.direct)] * len(model.sources):
        raise InputError(f"{where}: distances: one row per source, one column per sensor needed")
