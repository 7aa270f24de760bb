"""Every value that would be written into a control, from a table of offsets."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MICRO
from thermojoint.live.targets.control import next_value
from thermojoint.live.targets.settings import TargetFile

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
        A column is missing, a value is no number or beyond the range of the control.
    """
    offset, most = given.control.offset, MICRO * given.largest_step_um
    values = dict.fromkeys(given.axes, 0.0)
    for row in csv.DictReader(lines):
        for axis, now in values.items():
            try:
                metres = MICRO * float(row[f"offset_{axis}_um"])
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(
                    f"{where}: no offset_{axis}_um in every row; give what 'compensate' writes"
                ) from error
            values[axis] = next_value(offset, now, metres, most)
            if values[axis] != now:
                node, value = given.node(offset, axis), f"{values[axis]:.10g}"
                yield row["time_s"], axis, node, value, offset.unit
