"""A log of a machine: time, temperatures, displacements, speed and load in SI.

`thermojoint.artefacts.log_file` reads one from CSV.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.log_record import Record, merged
from thermojoint.artefacts.quantities import Column, place_of


@dataclass(frozen=True, eq=False, repr=False)
class Log(Described):
    """Samples of a machine, in SI.

    Attributes
    ----------
    times : ndarray, shape (k,)
        s, increasing within every run; since 1970 if the clock has a date.
    columns : tuple of Column
        The measured quantities.
    values : ndarray, shape (k, columns)
        In SI, absolute temperatures in K; NaN where a reading is missing.
    starts : tuple of int
        First sample of each run. Consecutive files belong to one run while the clock continues;
        where it restarts, a new run starts an unknown time later.
    records : tuple of Record
        Report on each file that was read; empty for a log in memory.
    """

    times: Array
    columns: tuple[Column, ...]
    values: Array
    starts: tuple[int, ...] = (0,)
    records: tuple[Record, ...] = ()

    def _facts(self) -> dict[str, str]:
        hours = sum(np.ptp(run.times) for run in self.runs()) / 3600.0
        return {
            "samples": str(len(self.times)),
            "runs": f"{len(self.starts)}, {hours:.3g} h in all",
            "columns": ", ".join(self.names),
        }

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(column.name for column in self.columns)

    def of(self, quantity: str) -> tuple[str, ...]:
        """Return the names of the columns of a quantity.

        Parameters
        ----------
        quantity : str
            Its name, e.g. ``temperature``.
        """
        return tuple(column.name for column in self.columns if column.quantity == quantity)

    def at(self, name: str) -> Array:
        """Return a column in SI, shape (k,).

        Parameters
        ----------
        name : str
            With or without its unit.
        """
        return np.asarray(self.values[:, self.index(name)])

    def index(self, name: str) -> int:
        """Return the index of a column.

        Parameters
        ----------
        name : str
            With or without its unit, or with another unit of the same quantity: ``T1_degC`` is
            also ``T1 [°F]``.

        Raises
        ------
        InputError
            The column is unknown, or two columns share the name without its unit.
        """
        for known in (self.names, tuple(column.base for column in self.columns)):
            if known.count(name) == 1:
                return known.index(name)
        if (place := place_of(name, self.names)) is not None:
            return place.at
        raise unknown_name("column", name, self.names, "log")

    def runs(self) -> Iterator[Log]:
        """Yield every run as a separate log."""
        for first, end in zip(self.starts, (*self.starts[1:], len(self.times)), strict=True):
            yield self.part(slice(first, end))

    def with_order(self, columns: Sequence[Column]) -> Log:
        """Return the log with its columns in the order of others; as it is if they are others.

        Parameters
        ----------
        columns : sequence of Column
            Columns of another log.
        """
        if self.columns == tuple(columns) or {*self.columns} != {*columns}:
            return self
        at = [self.columns.index(column) for column in columns]
        return replace(self, columns=tuple(columns), values=self.values[:, at])

    def part(self, samples: slice) -> Log:
        """Return some consecutive samples of a log.

        Parameters
        ----------
        samples : slice
            Without a step.
        """
        first, end, _ = samples.indices(len(self.times))
        inside = tuple(start - first for start in self.starts if first < start < end)
        return replace(
            self, times=self.times[first:end], values=self.values[first:end], starts=(0, *inside)
        )


def runs_in(pieces: Iterable[Log]) -> Iterator[Log]:
    """Split pieces, which may be whole logs, into pieces of one run each."""
    for piece in pieces:
        yield from piece.runs()


def joined(pieces: Iterable[Log]) -> Log:
    """Join pieces in the order of time into one log; a new run starts where time restarts.

    Raises
    ------
    InputError
        There are no samples, or the columns of a piece differ from those of the first.
    """
    kept: list[Log] = []
    starts: list[int] = []
    rows = 0
    for piece in pieces:
        if kept and piece.columns != kept[0].columns:
            other = sorted({*piece.names} ^ {*kept[0].names}) or ["in another order"]
            raise InputError(
                f"log: a file has other columns than the first ({', '.join(other)}); rename them"
            )
        first = not kept or not piece.times[0] > kept[-1].times[-1]
        starts += [rows + start for start in piece.starts[0 if first else 1 :]]
        rows += len(piece.times)
        kept.append(piece)
    if not kept:
        raise InputError("log: no samples; give a CSV with a header and rows")
    return Log(
        np.concatenate([part.times for part in kept]),
        kept[0].columns,
        np.concatenate([part.values for part in kept]),
        tuple(starts),
        merged(record for part in kept for record in part.records),
    )
