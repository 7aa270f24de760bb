"""Displacements that are repeated from one reading to the next.

A control that reads a probe now and then writes the last result into every row of its log. Such a
row is no reading: the machine has moved on since.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.log_record import Record

#: In the report on a log, in place of a reading.
REPEATED = "repeated from the last reading"
#: A value is held if it stands in so many rows at least, and a column if it is left so many times
#: by a new reading, of so many steps of its display, in this part of all changes. A display that
#: follows the machine is left by one step, or again in the next rows.
_ROWS, _VALUES, _STEPS, _PART = 3, 3, 2.0, 0.7
#: Finest step of a display, and the largest displacement, m.
_FINEST, _LARGEST = 1e-12, 1e6


def is_held(values: Array) -> bool:
    """Whether values (k,), m, NaN where missing, are repeated from one reading to the next."""
    seen = values[np.isfinite(values)]
    changes = np.abs(np.diff(seen))
    at = np.flatnonzero(changes)
    rows = np.diff(at, prepend=-1)
    new = (rows >= _ROWS) & (changes[at] > (_STEPS - 0.5) * _display_step(seen))
    return bool(new.sum() >= max(_VALUES, _PART * len(at)))


def _display_step(values: Array) -> float:
    """Return the largest length of which the differences of values (k,) are multiples, m."""
    whole = np.rint(np.clip(values, -_LARGEST, _LARGEST) / _FINEST).astype(np.int64)
    return _FINEST * float(np.gcd.reduce(np.diff(whole)))


def without_repeats(pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the pieces of a log with NaN, and in the report, where a held displacement repeats.

    A column that is held in one piece is also taken to be held in later ones.

    Parameters
    ----------
    pieces : iterable of Log
        In the order of time.
    """
    last: dict[str, float] = {}
    for piece in pieces:
        values, counts = piece.values.copy(), Counter[tuple[str, str]]()
        for k, column in enumerate(piece.columns):
            read = np.flatnonzero(np.isfinite(values[:, k]))
            if column.is_displacement and (column.name in last or is_held(values[:, k])):
                seen = values[read, k]
                repeats = read[np.diff(seen, prepend=last.get(column.name, np.nan)) == 0.0]
                last[column.name] = float(seen[-1]) if seen.size else last[column.name]
                values[repeats, k] = np.nan
                counts[column.name, REPEATED] = len(repeats)
        records = tuple(_counted(record, counts) for record in piece.records[:1])
        yield replace(piece, values=values, records=(*records, *piece.records[1:]))


def _counted(record: Record, counts: Counter[tuple[str, str]]) -> Record:
    return replace(record, missing=Counter(record.missing) + counts) if counts else record
