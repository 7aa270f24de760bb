"""Observer of one machine as one HDF5 file, written as a whole and read back exactly.

Arrays are datasets, everything else is JSON in the attribute ``header``; the fingerprint is a
digest of both, so that a damaged file is never taken for a model.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
import pydantic

from estimator.joint_aware.filter_design import SteadyFilter
from estimator.joint_aware.observer_model import (
    SCHEMA,
    Band,
    Calibrated,
    Kind,
    ObserverModel,
)
from fesim.axes.condensation import TiedCondensations, Ties
from fesim.axes.guideway import GuideStations, Guideway
from fesim.case.drive_sections import BallScrewSection, ScaleSection
from fesim.case.joint_sections import JointSection
from fesim.case.thermal_sections import MaterialSection
from fesim.joint.conductance import ConductanceTable
from fesim.solid.condensation import ElasticCondensation, LoadInfluence
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_bytes
from thermojoint.reduced.axis_drive import AxisDrive, AxisDrives
from thermojoint.reduced.discrepancy import Discrepancy
from thermojoint.reduced.machine import Joint, Modes, MovingAxis

SCHEMA_VERSION = 8

#: Reads the kind; other values are refused.
KIND: pydantic.TypeAdapter[Kind] = pydantic.TypeAdapter(Kind)

#: Arrays of parts of the model that have more than arrays.
_MODES = (
    *("rates", "drive", "jump", "entry", "mean", "sensors", "start", "film", "factors", "tight"),
)
_WAY = ("temperature", "means", "running")
_TIES = ("springs", "compliance", "area", "reference")
_DRIVE = ("screw", "material", "scale")

#: A part of the model that consists of arrays.
Part = TypeVar(
    "Part", ElasticCondensation, LoadInfluence, Discrepancy, ConductanceTable, Band, SteadyFilter
)


def write_observer(model: ObserverModel, path: Path | str) -> None:
    """Write the model of a machine's observer, whole or not at all.

    Parameters
    ----------
    model : ObserverModel
        From `calibrate_joint_aware`.
    path : Path or str
        HDF5.
    """
    header, arrays = _header(model), _arrays(model)
    made = BytesIO()
    with h5py.File(made, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array)
        file.attrs["header"] = header
        file.attrs["fingerprint"] = _digest(header, arrays)
    write_bytes(Path(path), made.getvalue())


def read_observer(path: Path | str) -> ObserverModel:
    """Read a model written by `write_observer`.

    Parameters
    ----------
    path : Path or str
        HDF5.

    Raises
    ------
    InputError
        The file is missing, truncated, corrupted, of another version, or not a joint-aware model.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; calibrate a model with --kind joint-aware")
    try:
        with h5py.File(path, "r") as file:
            text, stated = str(file.attrs["header"]), str(file.attrs["fingerprint"])
            arrays = {name: np.asarray(file[name][()]) for name in _names(file)}
        header = json.loads(text)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: not a readable joint-aware model, perhaps truncated; calibrate it again"
        ) from error
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise InputError(f"{path}: no joint-aware model; calibrate one with --kind joint-aware")
    if header.get("schema_version") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: model of version {header.get('schema_version')}, expected {SCHEMA_VERSION}; "
            "calibrate it again"
        )
    if _digest(text, arrays) != stated:
        raise InputError(f"{path}: the model's values are damaged; calibrate it again")
    try:
        return _model(header, arrays)
    except (KeyError, ValueError, TypeError, pydantic.ValidationError) as error:
        raise InputError(f"{path}: not a whole joint-aware model; calibrate it again") from error


def fingerprint(model: ObserverModel) -> str:
    """Return the digest of a model, which ties states to it."""
    return _digest(_header(model), _arrays(model))


def _names(file: h5py.File) -> list[str]:
    names: list[str] = []
    file.visititems(
        lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
    )
    return names


def _digest(header: str, arrays: Mapping[str, Array]) -> str:
    digest = hashlib.sha256(header.encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.shape} {array.dtype.str}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _arrays(model: ObserverModel) -> dict[str, Array]:
    tables = {f"tables/{k}": joint.table for k, joint in enumerate(model.joints)}
    parts: dict[str, Any] = {
        "elastic": model.modes.elastic,
        "loads": model.modes.loads,
        **{name: table for name, table in tables.items() if table is not None},
        "remainder": model.discrepancy,
        "filter": model.filter,
        "band": model.band,
    }
    arrays = {f"modes/{name}": getattr(model.modes, name) for name in _MODES}
    for part, of in parts.items():
        arrays |= {f"{part}/{field.name}": getattr(of, field.name) for field in fields(of)}
    arrays |= {
        "held": model.held,
        "warm": model.warm,
        "power": model.power,
        "offset": model.offset,
        "first": model.first,
    }
    way = model.modes.way
    if way is not None:
        arrays |= {f"way/{name}": getattr(way, name) for name in _WAY}
        arrays |= {f"way/ties/{name}": getattr(way.elastic.ties, name) for name in _TIES}
        arrays |= {f"way/positions/{k}": each for k, each in enumerate(way.stations.positions)}
        arrays |= {f"way/place/{k}": each for k, each in enumerate(way.stations.place)}
        arrays |= {"way/thermal": way.elastic.thermal, "way/modulus": way.elastic.modulus}
    if (drives := model.modes.drives) is not None:
        arrays |= {"drives/heated": drives.heated, "drives/felt": drives.felt}
        for k, drive in enumerate(drives.each):
            if drive is not None:
                arrays[f"drives/{k}"] = drive.carried
    for k, axis in enumerate(model.moving_axes):
        arrays[f"strokes/{k}/asked"] = axis.asked
    for k, joint in enumerate(model.joints):
        arrays[f"joints/{k}"] = joint.conductivity
        if joint.opening is not None:
            arrays[f"openings/{k}"] = joint.opening
    return {name: np.asarray(array, dtype=np.float64) for name, array in arrays.items()}


def _header(model: ObserverModel) -> str:
    known = model.calibrated
    moving = [
        {
            "axis": axis.name,
            "along": axis.along,
            "reference_m": axis.reference,
            "odometer": axis.odometer,
        }
        for axis in model.moving_axes
    ]
    drives = model.modes.drives
    return json.dumps(
        {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "kind": model.kind,
            "step_s": model.step,
            "sensors": model.sensors,
            "axes": model.axes,
            "sources": model.sources,
            "loads": model.loads,
            "surfaces": model.surfaces,
            "joints": [joint.section.model_dump(mode="json") for joint in model.joints],
            "calibrated": {
                "duration_s": known.duration_s,
                "heat": known.heat,
                "temperatures": known.temperatures,
                # States of earlier models, and of those without axes or loads, keep them.
                **({"speeds_m_s": known.speeds} if known.speeds else {}),
                **({"load_factors": known.loads} if known.loads else {}),
            },
            "factors": model.factors,
            "strokes": moving,
            "drives": [] if drives is None else [_drive_header(one) for one in drives.each],
            "power_shares": dict(model.power_shares),
            # States of earlier models keep their fingerprint.
            **({"places_m": dict(model.places)} if model.places else {}),
            **({"displacement_of": model.displacement_of} if model.displacement_of else {}),
        },
        allow_nan=False,
    )


def _model(header: dict[str, Any], arrays: Mapping[str, Array]) -> ObserverModel:
    def part(name: str, of: type[Part]) -> Part:
        return of(**{field.name: arrays[f"{name}/{field.name}"] for field in fields(of)})

    def table(k: int) -> ConductanceTable | None:
        stored = f"tables/{k}/values" in arrays
        return part(f"tables/{k}", ConductanceTable) if stored else None

    known = header["calibrated"]
    return ObserverModel(
        modes=Modes(
            **{name: arrays[f"modes/{name}"] for name in _MODES},
            elastic=part("elastic", ElasticCondensation),
            loads=part("loads", LoadInfluence),
            way=_way(arrays) if header["strokes"] else None,
            drives=_drives(header["drives"], arrays) if header["strokes"] else None,
        ),
        held=arrays["held"],
        joints=tuple(
            Joint(
                JointSection.model_validate(section),
                arrays[f"joints/{k}"],
                arrays.get(f"openings/{k}"),
                table(k),
            )
            for k, section in enumerate(header["joints"])
        ),
        discrepancy=part("remainder", Discrepancy),
        filter=part("filter", SteadyFilter),
        band=part("band", Band),
        warm=arrays["warm"],
        power=arrays["power"],
        offset=arrays["offset"],
        first=arrays["first"],
        step=float(header["step_s"]),
        sensors=tuple(header["sensors"]),
        axes=tuple(header["axes"]),
        sources=tuple(header["sources"]),
        loads=tuple(header["loads"]),
        surfaces=tuple(header["surfaces"]),
        calibrated=Calibrated(
            known["duration_s"],
            known["heat"],
            {name: (low, high) for name, (low, high) in known["temperatures"].items()},
            tuple(map(float, known.get("speeds_m_s", ()))),
            tuple((float(low), float(high)) for low, high in known.get("load_factors", ())),
        ),
        factors={name: (value, spread) for name, (value, spread) in header["factors"].items()},
        kind=KIND.validate_python(header["kind"]),
        moving_axes=tuple(
            MovingAxis(
                str(stroke["axis"]),
                str(stroke["along"]),
                arrays[f"strokes/{k}/asked"],
                float(stroke["reference_m"]),
                bool(stroke.get("odometer", False)),
            )
            for k, stroke in enumerate(header["strokes"])
        ),
        power_shares=header.get("power_shares", {}),
        places={name: tuple(at) for name, at in header.get("places_m", {}).items()},
        displacement_of=header.get("displacement_of", ""),
    )


def _drive_header(drive: AxisDrive | None) -> dict[str, Any] | None:
    if drive is None:
        return None
    sections = {name: getattr(drive, name) for name in _DRIVE}
    given = {name: one.model_dump(mode="json") for name, one in sections.items() if one is not None}
    places = {"column": drive.column.tolist(), "seat": drive.seat.tolist()}
    return {"zero_m": drive.zero, "follows": drive.follows, **places, **given}


def _drives(headers: Sequence[dict[str, Any] | None], arrays: Mapping[str, Array]) -> AxisDrives:
    each = [
        None if header is None else _drive(header, arrays[f"drives/{k}"])
        for k, header in enumerate(headers)
    ]
    return AxisDrives(tuple(each), arrays["drives/heated"], arrays["drives/felt"])


def _drive(header: dict[str, Any], carried: Array) -> AxisDrive:
    screw, material, scale = (header.get(name) for name in _DRIVE)
    return AxisDrive(
        screw=None if screw is None else BallScrewSection.model_validate(screw),
        material=None if material is None else MaterialSection.model_validate(material),
        scale=None if scale is None else ScaleSection.model_validate(scale),
        zero=header["zero_m"],
        carried=carried,
        column=np.array(header["column"], dtype=np.int64),
        follows=int(header["follows"]),
        seat=np.array(header["seat"], dtype=np.int64),
    )


def _way(arrays: Mapping[str, Array]) -> Guideway:
    axes = range(sum(name.startswith("way/place/") for name in arrays))
    place = tuple(arrays[f"way/place/{k}"].astype(np.int64) for k in axes)
    ties = Ties(place=place, **{name: arrays[f"way/ties/{name}"] for name in _TIES})
    return Guideway(
        **{name: arrays[f"way/{name}"] for name in _WAY},
        stations=GuideStations(tuple(arrays[f"way/positions/{k}"] for k in axes), place),
        elastic=TiedCondensations(ties, arrays["way/thermal"], float(arrays["way/modulus"])),
    )
