"""Data checks of a log: exclusion of faulty sensors, and refusal of unusable logs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibrate.learning.rules import Cleaning
from calibrate.learning.speed_levels import held_levels
from calibrate.learning.thinning import DRIVES, Table
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_record import PAUSE
from thermojoint.artefacts.units import MEGA


@dataclass(frozen=True, eq=False)
class Cleaned:
    """A log to learn from."""

    #: Its rows; missing readings are replaced by the previous ones.
    table: Table
    #: Columns used as features, and columns to learn.
    sensors: tuple[str, ...]
    drives: tuple[str, ...]
    displacements: tuple[str, ...]
    #: One for each sensor that is excluded or repaired, and each column with spikes.
    faults: tuple[str, ...]
    #: Limitations of the log.
    warnings: tuple[str, ...]

    def at(self, name: str) -> Array:
        """Return a column, SI, shape (k,)."""
        return np.asarray(self.table.values[:, self.table.names.index(name)])


def clean(table: Table, displacements: tuple[str, ...], rules: Cleaning) -> Cleaned:
    """Return the usable data of a log.

    Raises
    ------
    InputError
        The log is too short, nothing warms the machine, no sensor is usable, or a displacement is
        constant, rarely read, has many spikes, or jumps.
    """
    names, length = table.names, longest_run(table, read_time(table))
    if length < rules.shortest:
        raise InputError(
            f"log: {length / 3600.0:.1f} h long; to learn from, give "
            f"{rules.shortest / 3600.0:.0f} h or more in one run"
        )
    if table.interval > rules.coarsest or len(table.times) < rules.fewest:
        raise InputError(
            f"log: {len(table.times)} samples, one every {table.interval / 60.0:.3g} min; to learn"
            f" from, give {rules.fewest} or more, one in {rules.coarsest / 60.0:.0f} min or faster"
        )
    slower = max(1.0, table.interval / rules.pace)
    rules = replace(rules, moved=slower * rules.moved, jump=slower * rules.jump)
    drives, warnings = _drives(table, rules)
    read = replace(table, values=_bridged(table, [names.index(name) for name in drives]))
    changes = _changes_of(read, drives, rules)
    faults: list[str] = []
    sensors: list[str] = []
    for k, column in enumerate(table.columns):
        if column.quantity != "temperature" or column.name in displacements:
            if table.spikes[k]:
                faults.append(_spikes_left_out(table, k))
            continue
        fault = _fault(table, k, changes, rules)
        if fault is None:
            sensors.append(column.name)
        else:
            faults.append(f"{column.name}: {fault}; left out")
        if fault is None and table.spikes[k]:
            faults.append(_spikes_left_out(table, k))
        if fault is None and table.missing[k]:
            faults.append(f"{column.name}: {int(table.missing[k])} readings missing; bridged")
    if not sensors and (faults or not drives):
        raise InputError(
            f"log: no usable temperature{'' if drives else ', speed or power'}"
            + (f" ({'; '.join(faults)})" if faults else "")
            + "; record some while the machine warms up"
            + (", or exclude them with --ignore to learn from speed or load alone") * bool(drives)
        )
    for name in displacements:
        _check_displacement(table, names.index(name), changes, rules)
    moved = [float(np.nanstd(table.values[:, names.index(name)])) for name in sensors]
    if not drives and max(moved, default=0.0) < rules.warms:
        raise InputError(
            "log: nothing warms the machine: no temperature moves by more than a few tenths of a "
            "kelvin and no speed is recorded; record a spindle test"
        )
    kept = [names.index(name) for name in (*sensors, *drives)]
    return Cleaned(
        replace(table, values=_bridged(table, kept)),
        tuple(sensors),
        tuple(drives),
        displacements,
        tuple(faults),
        tuple(warnings),
    )


def read_time(table: Table) -> Array:
    """Return the time for which the logger has been reading until each row, s, shape (k,).

    Pauses and the time between two runs do not count: unread values are not constant.
    """
    steps = np.diff(table.times, prepend=table.times[0])
    steps[list(table.starts)] = 0.0
    return _without_pauses(steps, table.interval)


def _without_pauses(steps: Array, interval: float) -> Array:
    return np.cumsum(np.where(steps > PAUSE * interval, 0.0, steps))


def longest_run(table: Table, times: Array) -> float:
    """Return how long the longest run of a log is, s, by the times (k,) of its rows."""
    return max(float(np.ptp(times[run])) for run in table.runs())


def _drives(table: Table, rules: Cleaning) -> tuple[list[str], list[str]]:
    """Return the columns that drive heat and vary, and warnings."""
    drives, warnings = [], []
    for k, column in enumerate(table.columns):
        if column.quantity not in DRIVES:
            continue
        values = table.values[:, k][np.isfinite(table.values[:, k])]
        largest = float(np.abs(values).max(initial=0.0))
        if not largest or float(np.ptp(values)) < rules.constant * largest:
            warnings.append(f"{column.name} is constant: its effect is not identifiable; left out")
            continue
        drives.append(column.name)
        levels = held_levels(np.abs(values) / largest, rules)[1]
        if column.quantity in ("speed", "feed") and len(levels) == 1:
            warnings.append(
                f"{column.name} has one level only: the effect of other speeds is extrapolated"
            )
    if not drives:
        warnings.append("no speed, power or load varies: only temperatures show the heat")
    return drives, warnings


def _changes_of(table: Table, drives: list[str], rules: Cleaning) -> Flags:
    """Return whether a drive changes at a row or next to it, or a gap ends there, shape (k,)."""
    changing = np.zeros(len(table.times), dtype=bool)
    for name in drives:
        values = np.abs(table.values[:, table.names.index(name)])
        least = rules.stepped * np.nanmax(values)
        step = np.abs(np.diff(values, prepend=values[0])) > least
        changing |= np.convolve(step, np.ones(1 + 2 * rules.beside), mode="same") > 0.0
    # During a gap anything may have changed.
    changing |= np.diff(table.times, prepend=-np.inf) > rules.gap * table.interval
    changing[list(table.starts)] = True
    return changing


def _changes_before(table: Table, there: Flags, changing: Flags, rules: Cleaning) -> Flags:
    """Return whether something has changed (k,) before or beside a reading, if it is `there`.

    A column that was not read for some time has a gap of its own.
    """
    steps = np.diff(table.times[there], prepend=-np.inf)
    usual = float(np.median(steps))
    changed = np.diff(np.cumsum(changing)[there], prepend=0) > 0
    if usual > rules.gap * table.interval:
        # What is beside a change in the rows is between two readings.
        changed = np.convolve(changed, np.ones(1 + 2 * rules.beside), mode="same") > 0.0
    return np.asarray((steps > rules.gap * max(table.interval, usual)) | changed)


def _fault(table: Table, k: int, changes: Flags, rules: Cleaning) -> str | None:
    """Return the reason why a sensor is unusable."""
    values = table.values[:, k]
    there = np.isfinite(values)
    share = float(table.missing[k]) / table.samples
    if there.mean() < 1.0 - rules.missing or share > rules.missing:
        return f"{100.0 * max(share, 1.0 - float(there.mean())):.0f} % of its readings are missing"
    seen = values[there]
    low, high = rules.possible
    if table.columns[k].unit != "K" and (seen.min() < low or seen.max() > high):
        worst = seen[np.argmax(np.abs(seen - np.median(seen)))]
        return f"reads {float(table.columns[k].from_si(worst)):g}, impossible for a machine tool"
    if float(np.ptp(seen)) < rules.still:
        return f"never moves by more than {rules.still:g} K"
    if table.spikes[k] > rules.spikes * table.samples:
        return f"{int(table.spikes[k])} spikes in {table.samples} samples"
    times, read = table.times[there], read_time(table)[there]
    # A pause of this sensor alone does not count either.
    read = _without_pauses(np.diff(read, prepend=read[0]), table.interval)
    still = _longest_still(seen, read, rules.unchanged)
    stuck = float(read[still.stop - 1] - read[still.start])
    if (
        stuck > max(rules.stuck * (read[-1] - read[0]), rules.shortest_stuck)
        and _expected(table, k, np.flatnonzero(there)[still]) > rules.shown * table.steps[k]
    ):
        return f"stuck at one value for {stuck / 60.0:.0f} min"
    jump = _jump(seen, _changes_before(table, there, changes, rules), float(table.steps[k]), rules)
    if jump is not None:
        row, size = jump
        hours = (times[row] - times[0]) / 3600.0
        return f"jumps by {size:+.1f} K {hours:.1f} h after the start, as if it had been moved"
    return None


def _longest_still(values: Array, times: Array, unchanged: float) -> slice:
    """Return the rows of the longest reading time with an unchanged value."""
    new = 1 + np.flatnonzero(np.abs(np.diff(values)) > unchanged)
    ends = np.concatenate(([0], new, [len(values)]))
    first = int(np.argmax(times[ends[1:] - 1] - times[ends[:-1]]))
    return slice(int(ends[first]), int(ends[first + 1]))


def _expected(table: Table, k: int, rows: NDArray[np.int64]) -> float:
    """Return how far a temperature should move in some rows by the share of the others, K."""
    others = [
        table.values[:, other]
        for other, column in enumerate(table.columns)
        if other != k and column.quantity == "temperature"
    ]
    shares = [_range(one[rows]) / size for one in others if (size := _range(one)) > 0.0]
    return float(np.median(shares or [1.0])) * _range(table.values[:, k])


def _range(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.ptp(there)) if there.size else 0.0


def _jump(
    values: Array, changing: Flags, display: float, rules: Cleaning
) -> tuple[int, float] | None:
    """Return row and size of a lasting jump within one interval, if there is one.

    It is larger than one step of the thermometer's display, K.
    """
    side = rules.side
    if len(values) < 4 * side:
        return None
    steps = np.where(changing[1:], 0.0, np.diff(values))
    usual = float(np.median(np.abs(steps))) + rules.least_usual
    least = max(rules.moved + display, rules.usual * usual)
    for row in np.argsort(-np.abs(steps))[: rules.candidates]:
        size = float(steps[row])
        if abs(size) < least:
            return None
        before = values[max(0, row + 1 - side) : row + 1]
        after = values[row + 1 : row + 1 + side]
        drift = side * float(np.median(np.concatenate((np.diff(before), np.diff(after)))))
        lasting = float(np.median(after) - np.median(before)) - drift
        quiet = max(float(np.ptp(before)), float(np.ptp(after[1:]))) if len(after) > 1 else 0.0
        if len(after) > side // 2 and lasting * np.sign(size) > rules.lasting * abs(size) > quiet:
            return int(row + 1), size
    return None


def _spikes_left_out(table: Table, k: int) -> str:
    count = int(table.spikes[k])
    spikes = f"{count} spikes; they are" if count > 1 else "1 spike; it is"
    return f"{table.columns[k].name}: {spikes} left out"


def _check_displacement(table: Table, k: int, changing: Flags, rules: Cleaning) -> None:
    column, values = table.columns[k], table.values[:, k]
    if table.spikes[k] > rules.spikes * table.samples:
        raise InputError(
            f"{column.name}: {int(table.spikes[k])} spikes in {table.samples} samples; check the "
            "probe and its cable, or leave these readings empty"
        )
    there, read = np.isfinite(values), read_time(table)
    of_runs = [read[run][there[run]] for run in table.runs()]
    hours = max((float(np.ptp(own)) for own in of_runs if own.size), default=0.0) / 3600.0
    if there.sum() < rules.fewest or hours < rules.shortest / 3600.0:
        raise InputError(
            f"{column.name}: {int(there.sum())} readings, {hours:.1f} h from the first to the last "
            f"in one run; give {rules.fewest} or more over {rules.shortest / 3600.0:.0f} h, or "
            "learn few readings beside the model of a machine like this one (--like)"
        )
    seen = values[there]
    size = float(np.ptp(seen))
    if size < rules.still_length:
        raise InputError(f"{column.name}: constant within {MEGA * size:.2g} um; nothing to learn")
    _check_zero(table, k, _changes_before(table, there, changing, rules), rules)


def _check_zero(table: Table, k: int, changed: Flags, rules: Cleaning) -> None:
    """Refuse a displacement that jumps, to stay, at a reading (n,) that is not `changed`."""
    there = np.isfinite(table.values[:, k])
    times, seen = table.times[there], table.values[there, k]
    side, steps = rules.side, np.where(changed, 0.0, np.diff(seen, prepend=seen[0]))
    # The machine moves between readings that are further apart than the rows.
    apart = float(np.median(np.diff(times)))
    jump = rules.jump * max(1.0, apart / max(table.interval, rules.pace))
    far = max(jump * float(np.ptp(seen)), rules.usual * float(np.median(np.abs(steps))))
    for row in np.argsort(-np.abs(steps))[: rules.candidates]:
        before, after = seen[max(0, row - side) : row], seen[row : row + side]
        lasting = abs(float(np.median(after) - np.median(before))) if len(before) else 0.0
        if abs(steps[row]) > far and lasting > rules.lasting * abs(steps[row]):
            hours, size = (times[row] - table.times[0]) / 3600.0, MEGA * steps[row]
            jumps = f"{table.columns[k].name}: jumps by {size:.1f} um {hours:.1f} h after the start"
            value, often = _often_reached(seen, (seen[row - 1], seen[row]))
            if often > rules.stretches:
                raise InputError(
                    f"{jumps}, from or to {MEGA * value:.4g} um, which it reaches {often} times, "
                    "as where nothing is read; leave these cells empty"
                )
            raise InputError(
                f"{jumps}, as if the probe had lost its zero; split the log there, into files "
                "whose times restart"
            )


def _often_reached(values: Array, either: tuple[float, float]) -> tuple[float, int]:
    """Return the one of two values to which values (k,) come more often, and how often."""
    counts = [int(np.count_nonzero(np.diff((values == one).astype(int)) > 0)) for one in either]
    return max(zip(either, counts, strict=True), key=lambda one: one[1])


def _bridged(table: Table, kept: list[int]) -> Array:
    """Return the values with the gaps of some columns filled by the previous value."""
    import pandas as pd

    values = table.values.copy()
    for run in table.runs():
        values[run, kept] = pd.DataFrame(values[run, kept]).ffill().bfill().to_numpy()
    middle = np.nanmedian(values[:, kept], axis=0)
    values[:, kept] = np.where(np.isnan(values[:, kept]), middle, values[:, kept])
    return values
