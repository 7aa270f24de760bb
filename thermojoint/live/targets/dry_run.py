"""Every value that would be written into a control, from a table of offsets."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MICRO, MILLI
from thermojoint.live.targets.control import next_value
from thermojoint.live.targets.settings import TargetFile, writes_of

#: Columns of the table of writes.
COLUMNS = ("time_s", "axis", "node", "value", "unit")
_OFFSET, _SLOPE = re.compile(r"offset_(.+)_um"), re.compile(r"slope_(.+)_um_per_m")


def writes(given: TargetFile, lines: Iterable[str], where: str) -> Iterator[tuple[str, ...]]:
    """Yield the writes for a control whose values begin at 0, as `COLUMNS`.

    Writes are `TargetFile.every_s` apart from the first row on, each towards the values of the
    latest row, as long as a value changes. The rows are those of the CSV that `thermojoint
    compensate` writes, called `where` in messages.

    Raises
    ------
    InputError
        There is no row, a column is missing or of an axis or slope that the target does not have,
        times do not increase, a value is not a number or is beyond the range of the control.
    """
    every = writes_of(given, given.axes)
    values = dict.fromkeys((write[:2] for write in every), 0.0)
    first = None
    table = csv.DictReader(lines)
    for row, times in _with_validity(table, given.every_s, where):
        if first is None:
            _check_taken(given, table.fieldnames or (), where)
            first = times[0]
        goals = {}
        for axis, section in given.slopes.items():
            reference = _number(row, f"P0_{axis}_mm", where)
            if not abs(MILLI * reference - section.reference) <= 1e-6:
                raise InputError(
                    f"{where}: P0_{axis}_mm {reference:.9g} is not slopes.{axis}.reference_mm "
                    f"{section.reference_mm:.9g}; change one of them"
                )
        for quantity, axis, _ in every:
            is_slope = quantity is given.control.slope
            column = f"slope_{axis}_um_per_m" if is_slope else f"offset_{axis}_um"
            goals[quantity, axis] = MICRO * _number(row, column, where)
        for time in _write_times(first, given.every_s, times):
            before = dict(values)
            for quantity, axis, most in every:
                now, goal = before[quantity, axis], goals[quantity, axis]
                values[quantity, axis] = value = next_value(quantity, now, goal, most)
                if value != now:
                    node = given.node(quantity, axis)
                    yield f"{time:.15g}", axis, node, f"{value:.10g}", quantity.unit
            if values == before:
                break
    if first is None:
        raise InputError(f"{where}: no rows; give what 'compensate' writes")


def _check_taken(given: TargetFile, columns: Iterable[str], where: str) -> None:
    """Refuse columns of an axis or a slope that the target does not have; so does the service."""
    for column in columns:
        if (found := _OFFSET.fullmatch(column)) and found[1] not in given.axes:
            raise InputError(
                f"{where}: {column}: the target has no axis {found[1]}; add it to axes there, or "
                "leave it out of the offsets"
            )
        if (found := _SLOPE.fullmatch(column)) and found[1] not in given.slopes:
            raise InputError(
                f"{where}: {column}: the target has no slope of axis {found[1]}; add "
                f"[slopes.{found[1]}] there, or leave the slope out of the offsets"
            )


def _with_validity(
    rows: Iterable[Mapping[str, str]], every: float, where: str
) -> Iterator[tuple[Mapping[str, str], tuple[float, float]]]:
    """Yield the rows, each with the start and end (s) of its validity.

    The last row is valid for one write.
    """
    held: tuple[Mapping[str, str], float] | None = None
    for row in rows:
        time = _number(row, "time_s", where)
        if not (held[1] if held else -math.inf) < time < math.inf:
            raise InputError(f"{where}: time_s does not increase at {time:.9g}; order the rows")
        if held is not None:
            yield held[0], (held[1], time)
        held = row, time
    if held is not None:
        yield held[0], (held[1], held[1] + every)


def _write_times(first: float, every: float, times: tuple[float, float]) -> Iterator[float]:
    """Yield the times (s) of the writes between two times, the second one excluded."""
    # Rounding errors must neither drop a write nor repeat it.
    index = math.ceil((times[0] - first) / every - 1e-9)
    while (time := first + index * every) < times[1] - 1e-9 * every:
        yield time
        index += 1


def _number(row: Mapping[str, str], column: str, where: str) -> float:
    try:
        return float(row[column])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{where}: no {column} in every row; give what 'compensate' writes"
        ) from error
