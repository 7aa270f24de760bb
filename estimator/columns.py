"""Columns of a log as samples, in the order of the estimator's channels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import place_of

Sample = tuple[float, ...]


def samples_of(
    names: Sequence[str], pieces: Iterable[Log], optional: Sequence[str] = ()
) -> Iterator[Sample]:
    """Yield (time, columns in SI) of a log; NaN for optional ones that it does not have.

    Raises
    ------
    InputError
        A column is missing, or time restarts.
    """
    last = -math.inf
    for piece in pieces:
        if not piece.times[0] > last:
            raise InputError("log: time restarts; estimate each run by itself")
        last = float(piece.times[-1])
        at = [piece.index(name) for name in names]
        values = piece.values[:, at]
        for name in optional:
            known = place_of(name, piece.names)
            one = piece.values[:, known.at] if known else np.full(len(values), np.nan)
            values = np.column_stack((values, one))
        for time, row in zip(piece.times.tolist(), values.tolist(), strict=True):
            yield (time, *row)


def named_in(names: Sequence[str], log: Log) -> list[tuple[str, str]]:
    """Return the names that a log has, in any unit, each with the name of its column there."""
    places = ((name, place_of(name, log.names)) for name in names)
    return [(name, log.names[place.at]) for name, place in places if place is not None]
