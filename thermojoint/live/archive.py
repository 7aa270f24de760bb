"""Read-only access to the store, with a separate connection for each short read."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from heapq import merge
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.live.publication import Columns, Layout, Publication, columns_of, fitted, from_row
from thermojoint.live.store import IN_NO_CHUNK, Event, Gap, expanded_runs, layout_from

#: Largest number of rows in one answer.
MOST_ROWS = 20_000


#: Eras of a machine, oldest first, with the layout of each.
Eras = Mapping[int, Layout]


@dataclass(frozen=True)
class History:
    """Samples of a machine in a time span, oldest first."""

    #: Of the last era; NaN where an earlier one lacks a value.
    layout: Layout
    #: The samples whose number is a multiple of `every`.
    columns: Columns
    #: Shape (n,): numbers of the samples, counted from 1 in each era.
    numbers: NDArray[np.int64]
    status: tuple[str, ...]
    #: Times without samples within the span.
    gaps: tuple[Gap, ...]
    #: Thinning factor; 1 if nothing was left out.
    every: int


@dataclass(frozen=True)
class Archive:
    """The store of a service, read only; may be used from any thread."""

    #: The SQLite file.
    path: Path

    def history(self, machine: str, since: float, until: float, at_most: int) -> History:
        """Return the samples of a machine between two times (s since 1970), thinned.

        Raises
        ------
        InputError
            No such machine.
        """
        at_most = max(1, min(at_most, MOST_ROWS))
        with self._reading() as store:
            eras, layout = _eras(store, machine)
            recent = _journal(store, eras, layout)
            total = _count(store, eras, (since, until))
            total += sum(bool(since <= row[0] <= until) for _, row, _ in recent)
            every = max(1, -(-total // at_most))
            chunks = _chunks(store, eras, layout, (since, until))
            parts = [_thinned(*chunk, every) for chunk in chunks]
            parts += [
                (np.array([number]), row[None, :], [status])
                for number, row, status in recent
                if number % every == 0
            ]
            gaps = tuple(
                Gap(*row)
                for row in store.execute(
                    "SELECT machine, since, until, why FROM holes "
                    "WHERE machine = ? AND until >= ? AND since <= ? ORDER BY since",
                    (machine, since, until),
                )
            )
        rows = np.concatenate([np.empty((0, layout.width)), *(rows for _, rows, _ in parts)])
        numbers = np.concatenate([np.empty(0, dtype=np.int64), *(number for number, _, _ in parts)])
        words = [word for _, _, run in parts for word in run]
        inside = np.flatnonzero((rows[:, 0] >= since) & (rows[:, 0] <= until))
        inside = inside[np.argsort(rows[inside, 0], kind="stable")]
        return History(
            layout,
            columns_of(layout, rows[inside]),
            numbers[inside],
            tuple(words[k] for k in inside),
            gaps,
            every,
        )

    def samples(
        self, machine: str, span: tuple[float, float], at_most: int, newest_first: bool
    ) -> list[Publication]:
        """Return the first samples of a machine within two times (s since 1970), or the last.

        Raises
        ------
        InputError
            No such machine.
        """
        since, until = span
        with self._reading() as store:
            eras, layout = _eras(store, machine)
            rows = _in_order(store, eras, layout, span, newest_first)
            within = (one for one in rows if since <= one[1][0] <= until)
            return [
                from_row(machine, number, layout, row, status)
                for number, row, status in islice(within, at_most)
            ]

    def latest(self, machine: str) -> Publication | None:
        """Return the newest stored publication of a machine; None before the first sample.

        Raises
        ------
        InputError
            No such machine.
        """
        newest = self.samples(machine, (-math.inf, math.inf), 1, newest_first=True)
        return newest[0] if newest else None

    def checkpointed(self, machine: str, era: int) -> Publication | None:
        """Return the last sample of an era in a checkpoint; None before the first."""
        with self._reading() as store:
            last = store.execute(
                "SELECT number, count, rows, chunks.status, layout FROM chunks "
                "JOIN eras ON eras.id = era WHERE era = ? ORDER BY first DESC LIMIT 1",
                (era,),
            ).fetchone()
        if last is None:
            return None
        number, count, rows, status, layout = last
        return from_row(
            machine,
            number + count - 1,
            layout_from(layout),
            np.frombuffer(rows, dtype="<f8").reshape(count, -1)[-1],
            json.loads(status)[-1][1],
        )

    def events(
        self,
        machine: str | None,
        since: float,
        until: float,
        at_most: int,
        seen: Callable[[str | None], bool] = lambda machine: True,
    ) -> list[Event]:
        """Return events, newest first: of one machine and of the service, or all.

        Only events are returned whose machine is `seen`; None stands for the service.
        """
        with self._reading() as store:
            rows = store.execute(
                "SELECT time, machine, kind, text FROM events WHERE time BETWEEN ? AND ? "
                "AND (?3 IS NULL OR machine IS NULL OR machine = ?3) ORDER BY time DESC, id DESC",
                (since, until, machine),
            )
            visible = (Event(*row) for row in rows if seen(row[1]))
            return list(islice(visible, max(1, min(at_most, MOST_ROWS))))

    def begun(self, machine: str) -> float:
        """Return the time since which a machine runs with its model, s since 1970.

        Raises
        ------
        InputError
            No such machine.
        """
        with self._reading() as store:
            last = store.execute(
                "SELECT begun FROM eras WHERE machine = ? ORDER BY id DESC LIMIT 1", (machine,)
            ).fetchone()
        if last is None:
            raise _unknown(machine)
        return float(last[0])

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        uri = f"{self.path.absolute().as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, uri=True, isolation_level=None, timeout=5.0)) as store:
            store.execute("PRAGMA temp_store = MEMORY")
            store.execute("BEGIN")
            yield store
            store.execute("COMMIT")


def _unknown(machine: str) -> InputError:
    return InputError(f"history: no machine named {machine!r}; take one of the service file")


def _eras(store: sqlite3.Connection, machine: str) -> tuple[Eras, Layout]:
    """Return the eras of a machine, and the layout of the last one."""
    eras = store.execute(
        "SELECT id, layout FROM eras WHERE machine = ? ORDER BY id", (machine,)
    ).fetchall()
    if not eras:
        raise _unknown(machine)
    layouts = {era: layout_from(text) for era, text in eras}
    return layouts, layouts[eras[-1][0]]


def _journal(store: sqlite3.Connection, eras: Eras, layout: Layout) -> list[tuple[int, Array, str]]:
    """Return number, row and status of the samples that are in no chunk yet."""
    marks = ",".join("?" * len(eras))
    found = store.execute(
        f"SELECT era, number, row, status FROM journal WHERE era IN ({marks}) AND {IN_NO_CHUNK} "
        "ORDER BY id",
        tuple(eras),
    )
    return [
        (number, fitted(np.frombuffer(row, dtype="<f8")[None], eras[era], layout)[0], status)
        for era, number, row, status in found
    ]


def _count(store: sqlite3.Connection, eras: Iterable[int], span: tuple[float, float]) -> int:
    """Return the number of samples of the chunks in a span.

    A chunk may be much longer than the span: a backlog that was read at once is one chunk.
    """
    (since, until), eras = span, tuple(eras)
    marks = ",".join("?" * len(eras))
    whole = "first >= ? AND last <= ?"
    (count,) = store.execute(
        f"SELECT coalesce(sum(count), 0) FROM chunks WHERE era IN ({marks}) AND {whole}",
        (*eras, since, until),
    ).fetchone()
    parts = store.execute(
        f"SELECT count, rows FROM chunks WHERE era IN ({marks}) "
        f"AND first <= ? AND last >= ? AND NOT ({whole})",
        (*eras, until, since, since, until),
    )
    for number, rows in parts:
        times = np.frombuffer(rows, dtype="<f8").reshape(number, -1)[:, 0]
        count += np.count_nonzero((times >= since) & (times <= until))
    return int(count)


def _chunks(
    store: sqlite3.Connection,
    eras: Eras,
    layout: Layout,
    span: tuple[float, float],
    order: str = "ASC",
) -> Iterator[tuple[int, Array, list[str]]]:
    """Yield first number, rows and status of each row of the chunks that reach into a span."""
    marks = ",".join("?" * len(eras))
    for era, number, count, rows, status in store.execute(
        f"SELECT era, number, count, rows, status FROM chunks WHERE era IN ({marks}) "
        f"AND first <= ? AND last >= ? ORDER BY first {order}",
        (*eras, span[1], span[0]),
    ):
        table = np.frombuffer(rows, dtype="<f8").reshape(count, -1)
        yield number, fitted(table, eras[era], layout), expanded_runs(json.loads(status), count)


def _in_order(
    store: sqlite3.Connection,
    eras: Eras,
    layout: Layout,
    span: tuple[float, float],
    newest_first: bool,
) -> Iterator[tuple[int, Array, str]]:
    """Yield number, row and status of samples in order, including some outside the span."""
    step, order = (-1, "DESC") if newest_first else (1, "ASC")
    # After a set-back clock the samples of two eras overlap.
    each = [{era: own} for era, own in eras.items()]
    recent = [_journal(store, era, layout)[::step] for era in each]
    stored = [
        (
            (first + k, rows[k], words[k])
            for first, rows, words in _chunks(store, era, layout, span, order)
            for k in range(len(rows))[::step]
        )
        for era in each
    ]
    yield from merge(*recent, *stored, key=lambda one: one[1][0], reverse=newest_first)


def _thinned(
    first: int, rows: Array, words: list[str], every: int
) -> tuple[NDArray[np.int64], Array, list[str]]:
    numbers = first + np.arange(len(rows), dtype=np.int64)
    at = np.flatnonzero(numbers % every == 0)
    return numbers[at], rows[at], [words[k] for k in at]
