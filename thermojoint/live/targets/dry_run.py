"""Every value that would be written into a control, from a table of offsets."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MICRO, MILLI
from thermojoint.live.targets.control import next_value
from thermojoint.live.targets.settings import TargetFile, writes_of

#: Columns of the table of writes.
COLUMNS = ("time_s", "axis", "node", "value", "unit")


def writes(given: TargetFile, lines: Iterable[str], where: str) -> Iterator[tuple[str, ...]]:
    """Yield the writes for a control whose values begin at 0, as `COLUMNS`.

    Parameters
    ----------
    given : TargetFile
    lines : iterable of str
        Offsets as `thermojoint compensate` writes them (CSV).
    where : str
        Their name in messages.

    Raises
    ------
    InputError
        There is no row, a column is missing, a value is no number or beyond the range of the
        control.
    """
    every = writes_of(given, given.axes)
    values = dict.fromkeys((write[:2] for write in every), 0.0)
    row: Mapping[str, str] = {}
    for row in csv.DictReader(lines):
        _number(row, "time_s", where)
        for axis, section in given.slopes.items():
            reference = _number(row, f"P0_{axis}_mm", where)
            if not abs(MILLI * reference - section.reference) <= 1e-6:
                raise InputError(
                    f"{where}: P0_{axis}_mm {reference:.9g} is not slopes.{axis}.reference_mm "
                    f"{section.reference_mm:.9g}; change one of them"
                )
        for quantity, axis, most in every:
            is_slope = quantity is given.control.slope
            column = f"slope_{axis}_um_per_m" if is_slope else f"offset_{axis}_um"
            now, goal = values[quantity, axis], MICRO * _number(row, column, where)
            values[quantity, axis] = value = next_value(quantity, now, goal, most)
            if value != now:
                node = given.node(quantity, axis)
                yield row["time_s"], axis, node, f"{value:.10g}", quantity.unit
    if not row:
        raise InputError(f"{where}: no rows; give what 'compensate' writes")


def _number(row: Mapping[str, str], column: str, where: str) -> float:
    try:
        return float(row[column])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{where}: no {column} in every row; give what 'compensate' writes"
        ) from error
