"""Runs of a measured log as responses for calibration."""

from __future__ import annotations

import warnings
from collections.abc import Container, Mapping, Sequence

import numpy as np
import xarray as xr

from calibrate.joint_aware.readings import check_cold
from calibrate.learning.thinning import spikes_of
from estimator.measured import temperatures_among
from fesim.axes.axis import gone_along
from fesim.case.schema import Case
from fesim.setup.loads import source_power
from fesim.solid.elasticity import DIRECTIONS
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.log_record import are_pauses
from thermojoint.artefacts.response import make_response

#: Fraction of the samples in which a reading other than a displacement may be missing.
MOST_MISSING = 0.2
#: Least number of readings of a displacement in a run, the first one, its zero, included.
LEAST_READ = 3
#: After a pause a machine is cold if its largest rise is less than this share of that before.
COOLED = 0.1


def runs_of(log: Log, case: Case, displacement: Sequence[str]) -> dict[str, xr.Dataset]:
    """Return every run of a log as a response.

    A run starts at rest: its first readings are those of the cold machine. Its displacement is
    relative to the first reading of each axis. One ends where time restarts, and at a pause in
    which the machine has cooled. Samples with a missing reading are left out, but displacements may
    be read now and then, each at times of its own: they are NaN in other samples. Spikes of a
    temperature or a displacement (`calibrate.learning.thinning.without_spikes`) are missing
    readings, with a warning, as is given of a displacement that is first read on a warm machine.

    Parameters
    ----------
    log : Log
        With a temperature for each probe of the case that is a sensor and for each held surface
        whose temperature changes, one power, W, for all sources together, and the displacements;
        the ``ambient``, if it was measured; the factor of a load that changes, ``cut_percent``; for
        a case with an axis its position, ``y_pos_mm``, and its odometer, ``y_way_mm``.
    case : Case
        The machine.
    displacement : sequence of str
        Columns named after the axis and the unit: ``x_um``.

    Raises
    ------
    InputError
        A column is missing, a temperature has two, a run starts warm, too many readings are
        missing, or a displacement is read too rarely.
    """
    # Along an axis a displacement changes within a sample.
    log = _without_spikes(log, () if case.axes else displacement)
    moved = {_axis(log, name): log.at(name) for name in displacement}
    sensed = _temperatures(log, case.probes)
    held = [name for name, one in case.held_temperatures.items() if one.file is not None]
    surfaces = _temperatures(log, held)
    if not sensed:
        known = ", ".join(f"{name}_degC" for name in case.probes) or "none"
        raise InputError(f"log: no temperature of a probe of the case; these would be {known}")
    power = _power(log, case)
    loads = {
        name: log.at(f"{name}_percent")
        for name, load in case.loads.items()
        if load.file is not None
    }
    places = {name: log.at(f"{name}_pos_mm") for name in case.axes}
    ways = {name: log.at(f"{name}_way_mm") for name, axis in case.axes.items() if axis.odometer}
    room = _temperatures(log, ["ambient"]).get("ambient")
    if room is None:
        warnings.warn(
            "log: no ambient_degC: it is taken as that of the start of each run; record it, as an "
            "estimate needs it",
            stacklevel=2,
        )
    needed = [
        *(sensed | surfaces).items(),
        ("heat", power),
        *loads.items(),
        *((f"position of {name}", read) for name, read in places.items()),
        *((f"way of {name}", read) for name, read in ways.items()),
        *([] if room is None else [("ambient", room)]),
    ]
    there = np.array([np.isfinite(read) for _, read in needed])
    whole = np.asarray(there.all(axis=0))
    starts = _starts(log, _largest_rise(np.array([*sensed.values()]), room, whole), whole)
    ends = (*starts[1:], len(log.times))
    heat = power / sum(source_power(source) for source in case.sources.values())
    runs = {}
    for number, (first, end) in enumerate(zip(starts, ends, strict=True), 1):
        where, kept = f"run {number}", np.flatnonzero(whole[first:end]) + first
        count = end - first
        if len(kept) < max(2, (1.0 - MOST_MISSING) * count):
            worst, _ = needed[int(np.argmin(there[:, first:end].sum(axis=1)))]
            raise InputError(
                f"{where}: {count - len(kept)} of {count} samples lack a reading, most often of "
                f"{worst}; give rows with all readings, at whatever interval"
            )
        # A held surface may begin at any temperature.
        begin = np.array([read[kept[0]] for read in sensed.values()])
        cold = float(np.median(begin) if room is None else room[kept[0]])
        check_cold(begin - cold, list(sensed), where)
        runs[where] = _response(
            log.times[kept],
            {
                axis: _from_first(read[kept], heat[kept], f"{where}: {axis}_um")
                for axis, read in moved.items()
            },
            {name: read[kept] - cold for name, read in (sensed | surfaces).items()},
            heat[kept],
            None if room is None else room[kept] - cold,
        )
        if loads:
            under = {name: read[kept] for name, read in loads.items()}
            runs[where] = _with(runs[where], "load_factor", "load", under, "1")
        if places:
            at = {name: read[kept] for name, read in places.items()}
            runs[where] = _with(runs[where], "axis_position", "moving_axis", at, "m")
        if ways:
            gone = {name: gone_along(read) for name, read in at.items()}
            gone |= {name: read[kept] for name, read in ways.items()}
            runs[where] = _with(runs[where], "axis_way", "moving_axis", gone, "m")
    return runs


def _largest_rise(sensed: Array, room: Array | None, whole: Flags) -> Array:
    """Largest difference (n,) of p temperatures (p, n) from a cold machine, K; 0 if not `whole`."""
    cold = np.median(sensed[:, np.argmax(whole)]) if room is None else room
    return np.where(whole, np.abs(sensed - cold).max(axis=0), 0.0)


def _from_first(moved: Array, heat: Array, where: str) -> Array:
    """Displacement (k,) of a run relative to its first reading, m; NaN where it was not read.

    Warns of a first reading under `heat` (k,): nothing tells what the machine does at once from the
    zero of the readings.

    Raises
    ------
    InputError
        There are too few readings.
    """
    read = np.flatnonzero(np.isfinite(moved))
    if read.size < LEAST_READ:
        raise InputError(
            f"{where}: {read.size} readings in rows with all others; a run needs {LEAST_READ}"
        )
    if heat[1 : read[0] + 1].any():
        warnings.warn(
            f"{where}: its first reading is after the first heat; begin with one of the cold "
            "machine",
            stacklevel=3,
        )
    return np.asarray(moved - moved[read[0]])


def _starts(log: Log, rise: Array, whole: Flags) -> list[int]:
    """Return the rows at which a run starts: where time restarts, and cold after a pause.

    What the heat was in a pause is unknown; a value after it would count for all of it.

    Parameters
    ----------
    log : Log
        n rows.
    rise : ndarray, shape (n,)
        Largest difference of a temperature from that of the cold machine, K.
    whole : ndarray of bool, shape (n,)
        Whether all readings of a row are there.
    """
    starts: list[int] = []
    for first, end in zip(log.starts, (*log.starts[1:], len(log.times)), strict=True):
        starts.append(first)
        for row in (first + after for after in _after_pauses(log.times[first:end])):
            there = np.flatnonzero(whole[row:end])
            if there.size and rise[row + there[0]] < COOLED * rise[starts[-1] : row].max():
                starts.append(row)
    return starts


def _after_pauses(times: Array) -> list[int]:
    """Return the rows of a run that follow a pause, from its times (n,), s."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if steps.size else 0.0
    return (np.flatnonzero(are_pauses(steps, usual)) + 1).tolist()


def _with(
    run: xr.Dataset, variable: str, over: str, columns: Mapping[str, Array], unit: str
) -> xr.Dataset:
    """Return a run with one more variable, of a column for each name along `over`."""
    values = (("time", over), np.column_stack([*columns.values()]), {"units": unit})
    return run.assign({variable: values}).assign_coords({over: list(columns)})


def _without_spikes(log: Log, still: Sequence[str]) -> Log:
    """Return a log with NaN for spikes of temperatures, and of the displacements `still`."""
    cleaned, counts = spikes_of(log, {log.columns[log.index(name)].name for name in still})
    for name, count in counts.items():
        warnings.warn(f"log: {name}: samples with a spike, left out: {count}", stacklevel=3)
    return cleaned


def _response(
    times: Array,
    moved: dict[str, Array],
    sensed: dict[str, Array],
    heat: Array,
    room: Array | None,
) -> xr.Dataset:
    displacement = np.zeros((len(times), len(DIRECTIONS)))
    for axis, read in moved.items():
        displacement[:, DIRECTIONS.index(axis)] = read
    values = {
        "heat_input": heat,
        "temperature": np.column_stack([*sensed.values()]),
        "displacement": np.nan_to_num(displacement),
    }
    if room is not None:
        values["ambient"] = room
    run = make_response(
        values,
        {"time": times - times[0], "probe": list(sensed), "axis": list(DIRECTIONS)},
    )
    # Only a measured displacement has gaps.
    run = run.assign(displacement=run["displacement"].copy(data=displacement))
    return run.assign_attrs(displacement_from="its first readings")


def _temperatures(log: Log, names: Container[str]) -> dict[str, Array]:
    """Temperature columns of a log with one of the given names, by name."""
    columns = temperatures_among(log.columns, names, "log")
    return {base: log.at(column.name) for base, column in columns.items()}


def _axis(log: Log, name: str) -> str:
    """The axis of a displacement column."""
    column = log.columns[log.index(name)]
    if column.quantity != "length" or column.base not in DIRECTIONS:
        raise InputError(
            f"--displacement {name}: with --case it is named after its axis; map it to x_um, y_um "
            "or z_um"
        )
    return column.base


def _power(log: Log, case: Case) -> Array:
    """Total heat of all sources, W; a motor power, of which only a share is heat, is left out."""
    told = {f"{name}_power" for name, one in case.sources.items() if one.power_share is not None}
    names = [name for name in log.of("power") if log.columns[log.index(name)].base not in told]
    if len(names) != 1:
        present = ", ".join(names) or "none"
        raise InputError(
            f"log: one column of the heat in W is needed, e.g. heat_W; found {present}"
        )
    return log.at(names[0])
