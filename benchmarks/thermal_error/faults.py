"""Faults of thermometers, added to a log: those of a workshop's wiring within a year."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermojoint.artefacts.arrays import Array

Columns = dict[str, Array]

#: The sensor that fails: the one nearest to the source, on which most methods lean.
SENSOR = "a_degC"
#: When it fails, and when a passing fault is over, as parts of the run.
FROM, TO = 0.4, 0.6


def stuck(columns: Columns) -> Columns:
    """Return a log whose sensor repeats one reading from some moment on."""
    values = columns[SENSOR].copy()
    first = _at(values, FROM)
    values[first:] = values[first]
    return columns | {SENSOR: values}


def spikes(columns: Columns) -> Columns:
    """Return a log whose sensor reads 40 K more in every 150th sample from some moment on."""
    values = columns[SENSOR].copy()
    values[_at(values, FROM) :: 150] += 40.0
    return columns | {SENSOR: values}


def offset(columns: Columns) -> Columns:
    """Return a log whose sensor reads 3 K more from some moment on: it was moved, or rewired."""
    values = columns[SENSOR].copy()
    values[_at(values, FROM) :] += 3.0
    return columns | {SENSOR: values}


def dropout(columns: Columns) -> Columns:
    """Return a log whose sensor reads nothing for a fifth of the run."""
    values = columns[SENSOR].copy()
    values[_at(values, FROM) : _at(values, TO)] = np.nan
    return columns | {SENSOR: values}


FAULTS: dict[str, Callable[[Columns], Columns]] = {
    "stuck": stuck,
    "spikes": spikes,
    "offset": offset,
    "dropout": dropout,
}


def _at(values: Array, part: float) -> int:
    return int(part * values.size)
