"""Sensors of the generalised models: their roles, and their positions in a response."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, takewhile
from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, shown_point, unknown_name
from thermojoint.artefacts.response import probes_of
from thermojoint.models.parameters import Model

if TYPE_CHECKING:
    import xarray as xr

#: Near the heat source: ΔT = T_a - T_b (Eqs. 1-6).
HEAT_SENSORS = ("a", "b")
#: At the joint: one for each fictitious source (Eq. 16), of which the paper has two.
JOINT_SENSORS = ("T1", "T2")
ROLES = (*HEAT_SENSORS, *JOINT_SENSORS)

#: Largest distance between a probe and the model's sensor that it represents, m.
SAME_PLACE = 1e-6


def joint_sensors(probes: Collection[str]) -> tuple[str, ...]:
    """Return the sensors at the joint among the names of probes: T1, T2 ... without a gap."""
    return tuple(takewhile(probes.__contains__, (f"T{i}" for i in count(1))))


def named_sensors(probes: Collection[str]) -> tuple[str, ...]:
    """Return a, b, T1, T2 ... if the probes are named so; otherwise nothing."""
    joint = joint_sensors(probes)
    return (*HEAT_SENSORS, *joint) if joint and set(HEAT_SENSORS) <= set(probes) else ()


@dataclass(frozen=True)
class Readings:
    """Input of the estimator of Figure 5."""

    #: Shape (k,): s.
    times: Array
    #: Shape (k,): T_a - T_b, K.
    delta_T: Array
    #: Shape (k, n): T1, T2, ... above the current ambient, K.
    temperatures: Array


def readings(
    response: xr.Dataset,
    joint: Sequence[str] = JOINT_SENSORS,
    roles: Mapping[str, str] | None = None,
    noise: Mapping[str, Array] | None = None,
) -> Readings:
    """Return the temperatures of a response that the estimator reads.

    Parameters
    ----------
    response : xarray.Dataset
        See `thermojoint.artefacts.response`. Its temperatures are relative to the initial ambient;
        ``ambient``, if present, is subtracted from those at the joint.
    joint : sequence of str
        Roles of the sensors at the joint.
    roles : mapping, optional
        Role ("a", "b", "T1", ...) to the name of the probe; by default the same.
    noise : mapping, optional
        Role to noise on its temperature, K, shape (k,).

    Raises
    ------
    InputError
        A probe is missing, or noise is given for an unknown role.
    """
    rise, above = _rises(response, (*HEAT_SENSORS, *joint), roles, noise)
    joined = np.stack([rise[role] for role in joint], axis=1)
    if above is not None:
        joined = joined - above[:, None]
    return Readings(response["time"].to_numpy(), rise["a"] - rise["b"], joined)


def rises(
    response: xr.Dataset,
    roles: Mapping[str, str] | None = None,
    noise: Mapping[str, Array] | None = None,
) -> Array:
    """Return a, b, T1 and T2 above the current ambient, K, shape (k, 4); as `readings`."""
    rise, above = _rises(response, ROLES, roles, noise)
    table = np.stack([rise[role] for role in ROLES], axis=1)
    return table if above is None else table - above[:, None]


def _rises(
    response: xr.Dataset,
    wanted: Sequence[str],
    roles: Mapping[str, str] | None,
    noise: Mapping[str, Array] | None,
) -> tuple[dict[str, Array], Array | None]:
    """Return the temperature above the initial ambient by role, and the ambient if present."""
    names = dict(roles or {})
    added = dict(noise or {})
    for role in (*names, *added):
        if role not in wanted:
            raise unknown_name("sensor role", role, wanted, "validation")
    known = probes_of(response)
    signals = {}
    for role in wanted:
        name = names.get(role, role)
        if name not in known:
            raise unknown_name("probe", name, known, f"response, role {role}")
        temperature = response["temperature"].isel(probe=known.index(name)).to_numpy()
        signals[role] = temperature + added.get(role, 0.0)
    return signals, response["ambient"].to_numpy() if "ambient" in response else None


def roles_in(response: xr.Dataset, model: Model) -> dict[str, str]:
    """Return sensor role to the name of the probe in a response.

    The probe with the role's name, or the probe at the position of the model's sensor if that
    differs.

    Raises
    ------
    InputError
        A role has no probe.
    """
    names = probes_of(response)
    roles = {}
    for role in (*HEAT_SENSORS, *model.linear.direct):
        if "probe_position" not in response or role not in model.sensors:
            roles[role] = role  # its existence is checked on reading
            continue
        apart = response["probe_position"].to_numpy() - np.asarray(model.sensors[role])
        distance = np.linalg.norm(apart, axis=1)
        if role in names and distance[names.index(role)] <= SAME_PLACE:
            roles[role] = role
        elif distance.min() <= SAME_PLACE:
            roles[role] = names[int(distance.argmin())]
        else:
            raise InputError(
                f"response: no probe at sensor {role!r} of the model, "
                f"{shown_point(model.sensors[role])} m; the nearest, "
                f"{names[int(distance.argmin())]!r}, is {distance.min():.3g} m away"
            )
    return roles
