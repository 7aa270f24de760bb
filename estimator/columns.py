"""Columns of a log as samples, in the order of the estimator's channels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log

Sample = tuple[float, ...]


def samples_of(names: Sequence[str], pieces: Iterable[Log]) -> Iterator[Sample]:
    """Yield (time, columns in SI) of a log.

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
        for time, values in zip(piece.times.tolist(), piece.values[:, at].tolist(), strict=True):
            yield (time, *values)
