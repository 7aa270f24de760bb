"""Digests of a case: of its whole content, and of the data that its condensation depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fesim.case.axis_section import seats_of
from fesim.case.schema import Case, heated_by_drives
from fesim.solid.linear_solver import default_solver
from thermojoint.artefacts.errors import UnreadableError

#: Keys that only affect the joint's law (`fesim.setup.machine.with_laws`) or the loads, or are only
#: recorded. All other keys, including new ones, belong to the condensation.
_LAW = {
    "preload_MPa",
    "reference_pressure_MPa",
    "initial_opening_um",
    "gap",
    "roughness_um",
    "asperity_slope",
    "hardness_GPa",
    "normal_law",
    "back_burdekin",
    "conductance",
    "friction_coefficient",
    "tangential_stiffness_ratio",
    "running_friction_coefficient",
}
#: Position, drive and requested results of an axis.
_COURSE = {
    "position_mm",
    "file",
    "asked_mm",
    "reference_mm",
    "ball_screw",
    "scale",
    "zero_mm",
    "odometer",
}
_MARCH = {"duration_min", "coupling", "method", "tolerance_um", "tolerance_K"}
_LOADS = {"title", "heat_input", "ambient", "output", "volume"}
#: Sections, and keys of materials, that only affect the heat equation.
_HEAT = {
    "convection_W_m2K",
    "convection_factor",
    "radiation",
    "cavities",
    "sources",
    "drives",
    "held_temperatures",
    "initial_temperature",
    "candidates",
}
_THERMAL = {
    "conductivity_W_mK",
    "density_kg_m3",
    "heat_capacity_J_kgK",
    "conductivity_factor",
    "heat_capacity_factor",
    "expansion_factor",
}
_STRENGTH = {"reference_power_W", "count", "reading", "heat_input", "power_share"}
_TIGHTENING = {"force_kN", "file"}

#: Read once, as it takes longer than the rest of a digest.
_VERSION = version("thermojoint")

Digest = Callable[[Path], str]


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's content.

    Raises
    ------
    UnreadableError
        The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise UnreadableError(f"{path}: cannot be read; check its name") from error


def hashed(data: dict[str, Any], digest: Digest = file_digest) -> str:
    """Return the SHA-256 of a case's data and the program's version.

    Parameters
    ----------
    data : dict
        From `Case.model_dump`, whole or in part; the order matters. The content of its file
        replaces a path.
    digest : callable
        As for `case_id`.

    Raises
    ------
    UnreadableError
        A file cannot be read.
    """
    # Paths are the only values of a case that JSON does not support.
    text = json.dumps(data | {"version": _VERSION}, default=digest)
    return hashlib.sha256(text.encode()).hexdigest()


def case_id(case: Case, digest: Digest = file_digest) -> str:
    """Return a digest, 16 hexadecimal digits, of a case's content and the program's version.

    Parameters
    ----------
    case : Case
        Files are included by content, not by name.
    digest : callable
        From a path to the digest of the file's content; use a caching one for many cases.
    """
    return hashed(case.model_dump(), digest)[:16]


def condensation_key(case: Case, digest: Digest = file_digest) -> str:
    """Return the digest of everything that `set_up` uses except loads and joint laws.

    Cases with equal keys share one condensation: `fesim.setup.machine.with_laws` makes the set-up
    of one from that of another. Arguments as for `case_id`.
    """
    return hashed(_condensed(case), digest)


def shared_key(case: Case, digest: Digest = file_digest) -> str:
    """Return the digest of everything that cases with a common set-up in a batch share.

    That is their condensation; for machines with axes, whose set-up includes laws, positions and
    requested results, it is everything except the heat. Arguments as for `case_id`.
    """
    if not case.axes:
        return condensation_key(case, digest)
    held = case.model_dump(include={"joints", "axes", "volume", "march"})
    return hashed(_condensed(case) | held, digest)


def thermal_key(case: Case, digest: Digest = file_digest) -> str:
    """Return the digest of everything that the thermal modes depend on, for `fesim.cache`.

    Arguments as for `case_id`.
    """
    return hashed(_structure(case), digest)


def elasticity_key(case: Case, digest: Digest = file_digest) -> str:
    """Return the digest of everything that the elastic condensation depends on, for `fesim.cache`.

    Heat sources, conduction, convection and temperature probes are not part of it. Arguments as for
    `case_id`.
    """
    data = _structure(case)
    # Other data of bolts need no factorisation.
    data["bolts"] = [
        (name, bolt.model_dump(include={"head", "thread"})) for name, bolt in case.bolts.items()
    ]
    for section in _HEAT:
        del data[section]
    data["materials"] = {
        name: _without(section, _THERMAL) for name, section in data["materials"].items()
    }
    measured = set(dict(case.displacement or {}).values())
    data["probes"] = [(name, probe) for name, probe in data["probes"] if name in measured]
    return hashed(data, digest)


def load_patterns(case: Case) -> list[dict[str, Any]]:
    """Return the mechanical loads of a case without their histories, in order.

    For a weight this includes the densities.
    """
    densities = {name: section.density_kg_m3 for name, section in case.materials.items()}
    return [
        load.model_dump(exclude={"file"})
        | ({"densities": densities} if load.acceleration_m_s2 is not None else {})
        for load in case.loads.values()
    ]


def asked(case: Case) -> dict[str, Any]:
    """Return the requested force and stress outputs of a case, with positions."""
    places = {name: case.probes[name] for name in case.output.stress_probes if name in case.probes}
    return {"output": case.output.model_dump(exclude={"snapshots_s"}), "places": places}


def set_up_differently(one: Case, other: Case) -> str | None:
    """Return the first key that a set-up depends on and that differs between two cases.

    None if the other case may use the same set-up. Lengths of steps and forces of bolts are left
    out, as `fesim.simulate.simulate` compares those with the set-up itself.

    Parameters
    ----------
    one, other : Case
        Files are compared by name.
    """
    path = _first_difference(_used(one), _used(other))
    return None if path is None else ".".join(map(str, path))


def _used(case: Case) -> dict[str, Any]:
    """Data that a set-up contains: those of the condensation, joint laws, and motion of axes."""
    data = _condensed(case)
    del data["march"]["step_s"], data["seats"]
    data |= case.model_dump(include={"joints", "axes", "volume"})
    return data | {section: dict(data[section]) for section in ("bolts", "probes")}


def _first_difference(one: Any, other: Any) -> list[Any] | None:  # noqa: ANN401 - nested data
    """Path to the first difference of nested data; the order of names matters."""
    if isinstance(one, dict) and isinstance(other, dict) and list(one) == list(other):
        for key, value in one.items():
            if (rest := _first_difference(value, other[key])) is not None:
                return [key, *rest]
        return None
    return None if one == other and not isinstance(one, dict) else []


def _condensed(case: Case) -> dict[str, Any]:
    """Data that affect `set_up`, except loads and joint laws."""
    data = case.model_dump(exclude=_LOADS)
    data["march"] = _without(data["march"], _MARCH)
    # Lists of pairs if their order is that of the condensed rows and columns.
    data["joints"] = [(name, _without(joint, _LAW)) for name, joint in data["joints"].items()]
    sources = data["sources"].values()
    data["sources"] = {number: _without(source, _STRENGTH) for number, source in enumerate(sources)}
    data["drives"] = list(heated_by_drives(case).values())
    data["seats"] = [
        (name, None if name is None else data["probes"][name])
        for axis in case.axes.values()
        for name in seats_of(axis)
    ]
    data["held_temperatures"] = {
        name: {"profile": held["profile"]} for name, held in data["held_temperatures"].items()
    }
    data["axes"] = [(name, _without(axis, _COURSE)) for name, axis in data["axes"].items()]
    data["loads"] = load_patterns(case)
    data["bolts"] = [(name, _without(bolt, _TIGHTENING)) for name, bolt in data["bolts"].items()]
    data["output"] = case.output.model_dump(exclude={"snapshots_s"})
    data["probes"] = list(data["probes"].items())
    return data


def _structure(case: Case) -> dict[str, Any]:
    """Data that affect `set_up`, except loads, joint laws, outputs and the time step."""
    data = _condensed(case)
    del data["loads"], data["output"]
    data["march"] = {"solver": case.march.solver or default_solver()}
    return data


def _without(section: dict[str, Any], keys: set[str]) -> dict[str, Any]:
    return {key: value for key, value in section.items() if key not in keys}
