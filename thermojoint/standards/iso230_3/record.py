"""Record of a test: displacements, tilts, temperatures and speed against time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.response import axes_of, columns_of, probes_of
from thermojoint.artefacts.tables.clock import tells_date
from thermojoint.standards.iso230_3.targets import driven, read_at

if TYPE_CHECKING:
    import xarray as xr

Quantity = Literal["displacement", "tilt", "temperature"]
#: Names of rotations about the axes of a response.
TURNS = {"x": "A", "y": "B", "z": "C"}
#: Largest number of temperatures taken from a response by default: it may have hundreds of
#: candidates.
MOST_PROBES = 6
#: Celsius' zero, K.
_ICE = 273.15
#: Share of the largest magnitude of a measured speed that is no motion but its jitter.
STANDSTILL = 0.01
#: An axis with a smaller displacement (m) or rotation (rad) counts as unmoved, e.g. across a plane
#: of symmetry.
STILL = 1e-12


@dataclass(frozen=True, eq=False)
class Record:
    """A recorded test."""

    #: Shape (n,): s, strictly increasing.
    times: Array
    #: Channel to displacement, m, shape (n,); NaN for a missing reading.
    displacements: Mapping[str, Array]
    #: Channel to temperature, °C or K above the start, shape (n,); NaN for a missing reading.
    temperatures: Mapping[str, Array]
    #: Channel to angle, rad, shape (n,); see `with_tilts`.
    tilts: Mapping[str, Array] = field(default_factory=dict)
    #: Shape (n,): speed or heat input, 0 at standstill.
    drive: Array | None = None
    #: Candidate columns for the drive, if it is ambiguous.
    drives: tuple[str, ...] = ()
    #: Time of the first sample, s since 1970; NaN for a clock without a date.
    began: float = math.nan
    #: Tilt to the distance of its two probes, m.
    distances: Mapping[str, float] = field(default_factory=dict)

    @property
    def channels(self) -> dict[Quantity, Mapping[str, Array]]:
        """The channels of every quantity."""
        return {
            "displacement": self.displacements,
            "tilt": self.tilts,
            "temperature": self.temperatures,
        }


def response_record(
    response: xr.Dataset, axes: Mapping[str, str] | None = None, probes: list[str] | None = None
) -> Record:
    """Return the record of a response, simulated or measured.

    Parameters
    ----------
    response : xarray.Dataset
        A response (`thermojoint.artefacts.response`).
    axes : mapping, optional
        Channel of the record to axis of the response; default every axis that moves, by its name.
        While an axis of the machine moves, a channel ``NAMEP1``, ``NAMEP2`` for each target
        (`thermojoint.standards.iso230_3.targets`).
    probes : list of str, optional
        Default the first `MOST_PROBES`. The ambient is added if it changes.

    Raises
    ------
    InputError
        An axis or a probe is missing, no displacement changes, or several axes move.
    """
    places = read_at(response)
    if axes is None:
        moved = np.max([np.abs(one.displacement).max(axis=0) for one in places], axis=0) > STILL
        axes = {name: name for name, moves in zip(axes_of(response), moved, strict=True) if moves}
        if not axes:
            raise InputError("response: no displacement in it changes; give one where something is")
    chosen = probes_of(response)[:MOST_PROBES] if probes is None else probes
    temperatures = dict(zip(chosen, columns_of(response, "temperature", chosen).T, strict=True))
    if "ambient" in response and bool(response["ambient"].any()):
        temperatures["ambient"] = response["ambient"].to_numpy().astype(float)
    known = axes_of(response)
    for axis in axes.values():
        if axis not in known:
            raise unknown_name("axis", axis, known, "response")
    return Record(
        times=response["time"].to_numpy().astype(float),
        displacements={
            f"{channel}{one.mark}": one.displacement[:, known.index(axis)]
            for one in places
            for channel, axis in axes.items()
        },
        temperatures=temperatures,
        tilts={
            f"{TURNS[axis]}{one.mark}": about
            for one in places
            if one.rotation is not None
            for axis, about in zip(known, one.rotation.T, strict=True)
            if np.abs(about).max() > STILL
        },
        drive=driven(response),
    )


def log_record(
    log: Log,
    displacements: Mapping[str, str] | None = None,
    temperatures: list[str] | None = None,
    speed: str | None = None,
) -> Record:
    """Return the record of a machine's log; its time is counted from the first sample.

    Parameters
    ----------
    log : Log
        One run.
    displacements : mapping, optional
        Channel of the record to column of the log; default every length but positions of axes, by
        its name without unit.
    temperatures : list of str, optional
        Columns; default every temperature.
    speed : str, optional
        Column that is 0 at standstill; default the speed, if there is exactly one;
        of several it is ambiguous.

    Raises
    ------
    InputError
        A column is missing or has another quantity, there are several runs, there is no
        displacement, or two columns have the same name but for the unit.
    """
    if len(log.starts) > 1:
        raise InputError("log: time restarts within it; give the file of one test")
    moved = [one.name for one in log.columns if one.is_displacement]
    wanted = _by_base(log, moved) if displacements is None else displacements
    if not wanted:
        raise InputError("log: no displacement; rename its column to end in _um, _mm or _m")
    speeds = log.of("speed")
    if speed is None and len(speeds) == 1:
        speed = speeds[0]
    unnamed = speeds if speed is None else []
    return Record(
        times=log.times - log.times[0],
        displacements={name: _column(log, column, "length") for name, column in wanted.items()},
        temperatures={
            base: _celsius(log, name)
            for base, name in _by_base(
                log, log.of("temperature") if temperatures is None else temperatures
            ).items()
        },
        drive=None if speed is None else _without_jitter(log.at(speed)),
        drives=tuple(unnamed),
        began=float(log.times[0]) if tells_date(float(log.times[0])) else math.nan,
    )


def _without_jitter(speed: Array) -> Array:
    """Return a measured speed (n,) that is zero up to `STANDSTILL` of its largest magnitude."""
    size = np.abs(np.nan_to_num(speed))
    return np.where(size > STANDSTILL * size.max(initial=0.0), speed, 0.0)


def _by_base(log: Log, names: Iterable[str]) -> dict[str, str]:
    """Return columns by their name without unit, which is the name of a channel."""
    found: dict[str, str] = {}
    for name in names:
        base = log.columns[log.index(name)].base
        if base in found:
            raise InputError(
                f"log: columns {found[base]!r} and {name!r} would both be {base!r}; rename one "
                "with --column"
            )
        found[base] = name
    return found


def _column(log: Log, name: str, quantity: str) -> Array:
    column = log.columns[log.index(name)]
    if column.quantity != quantity:
        raise InputError(f"log: column {column.name!r} is a {column.quantity}, not a {quantity}")
    return log.at(name)


def _celsius(log: Log, name: str) -> Array:
    """Return temperatures in display units: °C, or K if the log has K."""
    values = _column(log, name, "temperature")
    return values if log.columns[log.index(name)].unit == "K" else values - _ICE


def with_second(record: Record, second: Record) -> Record:
    """Return the record with the displacements of the same run at a second point, ``NAME2``.

    Raises
    ------
    InputError
        The times or dates differ, or a name exists already.
    """
    same = record.times.shape == second.times.shape and np.allclose(
        record.times, second.times, rtol=1e-9, atol=1e-6
    )
    if not same:
        raise InputError("second point: read at other times than the first; give the same run")
    if abs(second.began - record.began) > record.times[-1]:
        raise InputError("second point: read on another day than the first; give the same run")
    added = {f"{name}2": values for name, values in second.displacements.items()}
    for name in added:
        if name in record.displacements:
            raise InputError(f"second point: a channel {name!r} is there already; rename it")
    return replace(record, displacements={**record.displacements, **added})


def with_tilts(record: Record, pairs: Mapping[str, tuple[str, str]], distance: float) -> Record:
    """Return the record with tilts from pairs of parallel displacements.

    A small rotation of a body changes the displacements of two points at a distance l by the angle
    times l: tilt = (first - second) / l. The order of a pair defines the sign.

    Parameters
    ----------
    record : Record
    pairs : mapping
        Name of the tilt to (first, second) channel.
    distance : float
        l, m, between the two points, across the displacement.

    Raises
    ------
    InputError
        A channel is missing, a name is one of the record, or the distance is not positive.
    """
    if not 0.0 < distance < np.inf:
        raise InputError(f"distance of the sensors: {distance:g} m; give a positive length")
    tilts, distances = dict(record.tilts), dict(record.distances)
    for name, pair in pairs.items():
        if name in tilts or name in record.displacements:
            raise InputError(f"tilt {name}: the record has such a channel; give it another name")
        for channel in pair:
            if channel not in record.displacements:
                raise unknown_name("displacement", channel, record.displacements, f"tilt {name}")
        first, second = (record.displacements[channel] for channel in pair)
        tilts[name], distances[name] = (first - second) / distance, distance
    return replace(record, tilts=tilts, distances=distances)
