"""Persistent store in one SQLite file (WAL): samples, states, read positions of the sources.

One transaction contains the samples of a moment, their estimates, and the read position of each
source. After a kill a source thus continues after the last stored sample, and no sample counts
twice.
A commit only appends to the ``journal``. A state, which may be a hundred times larger than a
sample, is stored at intervals (a checkpoint), together with the samples since the last one as one
chunk of the history. At a start the samples of the journal after the last checkpoint run through
the estimator again: it is a pure function, so the estimates are the same.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import TypeAdapter

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.live.disk_reserve import RESERVE, is_full, limit_writes
from thermojoint.live.publication import Layout

SCHEMA_VERSION = 2
#: File locked by the service that uses a folder; it contains the number of its process.
_LOCK = "lock"
#: Number of passes of moving the log: each pass has less to move.
_PASSES = 2
#: Longest time for which a writer waits for another one, s.
_BUSY_TIMEOUT_S = 10.0
#: Size of the write-ahead log from which a commit moves it, bytes.
_LARGEST_WAL = 64_000_000
#: Number of entries of the journal, and of chunks of a past era, deleted at once.
MOST_PRUNED, _MOST_CHUNKS = 5_000, 50
_LAYOUT = TypeAdapter(Layout)
_ADD_SAMPLE = "INSERT INTO journal (era, number, row, status, rest) VALUES (?, ?, ?, ?, ?)"
#: A state that waited for a new store does not replace a newer one.
_PUT_STATE = (
    "INSERT INTO states VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET number = excluded.number, "
    "state = excluded.state, rest = excluded.rest WHERE excluded.number >= number"
)
#: Axes removed from the settings keep their last values.
_PUT_RECEIVED = (
    "INSERT INTO received VALUES (?, ?, ?) ON CONFLICT DO UPDATE SET at = excluded.at, "
    "content = json_patch(content, excluded.content)"
)
#: Statement to add a chunk of `_chunk`; condition for a sample of the journal in no chunk yet.
_ADD_CHUNK = (
    "INSERT INTO chunks (era, first, last, number, count, rows, status) "
    "VALUES (?, ?, ?, ?, ?, ?, ?)"
)
IN_NO_CHUNK = (
    "(journal.number > "
    "coalesce((SELECT states.number FROM states WHERE states.era = journal.era), 0))"
)
_TABLES = """
CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS eras (
  id INTEGER PRIMARY KEY, machine TEXT NOT NULL, model TEXT NOT NULL, layout TEXT NOT NULL,
  begun REAL NOT NULL);
CREATE TABLE IF NOT EXISTS journal (
  id INTEGER PRIMARY KEY AUTOINCREMENT, era INTEGER NOT NULL, number INTEGER NOT NULL,
  row BLOB NOT NULL, status TEXT NOT NULL, rest TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS states (
  era INTEGER PRIMARY KEY, number INTEGER NOT NULL, state BLOB NOT NULL, rest TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS chunks (
  id INTEGER PRIMARY KEY, era INTEGER NOT NULL, first REAL NOT NULL, last REAL NOT NULL,
  number INTEGER NOT NULL, count INTEGER NOT NULL, rows BLOB NOT NULL, status TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS chunks_by_time ON chunks (era, first);
CREATE TABLE IF NOT EXISTS holes (
  id INTEGER PRIMARY KEY, machine TEXT NOT NULL, since REAL NOT NULL, until REAL NOT NULL,
  why TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS holes_by_machine ON holes (machine, since);
CREATE TABLE IF NOT EXISTS events (
  id INTEGER PRIMARY KEY, time REAL NOT NULL, machine TEXT, kind TEXT NOT NULL,
  text TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS events_by_time ON events (time);
CREATE TABLE IF NOT EXISTS received (
  machine TEXT PRIMARY KEY, at REAL NOT NULL, content TEXT NOT NULL);
"""


class StoredSample(NamedTuple):
    """A processed sample."""

    #: Era of its machine: `era_of`.
    era: int
    #: Number of the sample, counted from 1.
    number: int
    #: Values from `thermojoint.live.publication.as_row`.
    row: bytes
    #: Status in words.
    status: str
    #: Everything else that the next sample depends on, with the read position: JSON.
    rest: str


@dataclass(frozen=True)
class Checkpoint:
    """A state, and the samples since the last checkpoint."""

    #: As in `StoredSample`, for the last sample; the same for `number` and `rest`.
    era: int
    number: int
    #: State of the estimator.
    state: bytes
    rest: str
    #: Shape (n, layout.width): the samples since the last checkpoint, n may be 0.
    rows: Array
    #: Status of each sample.
    status: tuple[str, ...]


class Event(NamedTuple):
    """An event; one line of the log."""

    time: float
    machine: str | None
    kind: str
    text: str


class Gap(NamedTuple):
    """A time span (s since 1970) without samples of a machine, and its reason."""

    machine: str
    since: float
    until: float
    why: str


class ReceivedOffsets(NamedTuple):
    """Last values received by the control of a machine, under any model and settings."""

    machine: str
    #: Time of reception, s since 1970.
    at: float
    #: State of the compensation output: JSON.
    content: str


@dataclass(frozen=True)
class Batch:
    """Content of one transaction."""

    samples: Sequence[StoredSample] = ()
    checkpoints: Sequence[Checkpoint] = ()
    events: Sequence[Event] = ()
    gaps: Sequence[Gap] = ()
    received: Sequence[ReceivedOffsets] = ()


@dataclass(frozen=True)
class StoredEra:
    """Stored data of an era."""

    era: int
    #: Columns of each sample.
    layout: Layout
    #: Number of samples at the last checkpoint.
    number: int
    #: State of the estimator at the checkpoint; None before the first.
    state: bytes | None
    #: As in `StoredSample`, at the checkpoint.
    rest: str
    #: The samples since the checkpoint, in order.
    later: tuple[StoredSample, ...]

    @property
    def newest(self) -> str:
        """What the next sample depends on besides the state: `rest` of the last sample."""
        return self.later[-1].rest if self.later else self.rest


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder for one service: two would store every sample twice.

    Raises
    ------
    InputError
        Another service has locked it.
    """
    with (folder / _LOCK).open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(occupied(folder)) from error
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield


def occupied(folder: Path) -> str:
    """Return what is said of a folder that another service has locked."""
    return f"{folder}: another service runs on it; stop that one, or give another folder"


def is_locked(folder: Path) -> bool:
    """Return whether a service runs on a folder."""
    if not (folder / _LOCK).exists():
        return False
    try:
        with locked(folder):
            return False
    except InputError:
        return True


def send_sighup(folder: Path) -> bool:
    """Send SIGHUP to the service that runs on a folder; return whether one does."""
    process = lock_owner(folder)
    if process is not None:
        os.kill(process, signal.SIGHUP)
    return process is not None


def lock_owner(folder: Path) -> int | None:
    """Return the process of the service that runs on a folder; None without one."""
    return int((folder / _LOCK).read_text()) if is_locked(folder) else None


def open_store(path: Path, durable: bool = False) -> sqlite3.Connection:
    """Open the store, an SQLite file in an existing folder, or create it.

    If it is durable, every commit is on the disk before it returns (``synchronous = FULL``).
    Otherwise a kill loses nothing, but a power cut may lose the last moments.

    Raises
    ------
    InputError
        The file is not a store, or of another version.
    """
    with _as_store(path):
        store = sqlite3.connect(
            path, isolation_level=None, check_same_thread=False, timeout=_BUSY_TIMEOUT_S
        )
        store.execute("PRAGMA journal_mode = WAL")
        store.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
        # The service moves the log itself: commits that do so, from this size on, take longer.
        limit_writes(store, _LARGEST_WAL)
        store.executescript(_TABLES + RESERVE)
        store.execute(
            "INSERT OR IGNORE INTO meta VALUES ('schema_version', ?)", (str(SCHEMA_VERSION),)
        )
        _check_version(store, path)
    path.chmod(0o640)
    return store


def check_store(path: Path) -> None:
    """Refuse a store that `open_store` would refuse; a missing store is accepted.

    Raises
    ------
    InputError
        The file is not a store, or of another version.
    """
    if path.exists():
        with (
            _as_store(path),
            closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as store,
        ):
            _check_version(store, path)


@contextmanager
def _as_store(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.DatabaseError as error:
        if path.parent.exists() and is_full(path):
            raise InputError(f"{path}: the disk is full ({error}); make room on it") from error
        raise InputError(
            f"{path}: no store of this service ({error}); give another folder"
        ) from error


def _check_version(store: sqlite3.Connection, path: Path) -> None:
    (version,) = store.execute("SELECT value FROM meta WHERE name = 'schema_version'").fetchone()
    if version != str(SCHEMA_VERSION):
        raise InputError(
            f"{path}: store of version {version}, expected {SCHEMA_VERSION}; give another folder"
        )


def identity_of(path: Path) -> tuple[int, ...] | None:
    """Return the inode numbers of a store's file and its log; None if one is missing."""
    try:
        return tuple(path.with_name(path.name + suffix).stat().st_ino for suffix in ("", "-wal"))
    except FileNotFoundError:
        return None


def era_of(store: sqlite3.Connection, machine: str, model: str, layout: Layout, now: float) -> int:
    """Return the era of a machine: a new one if its model or layout has changed, else the last.

    `model` identifies the model, `layout` names the stored values; `now` is in s since 1970.
    """
    content = layout_text(layout)
    last = store.execute(
        "SELECT id, model, layout FROM eras WHERE machine = ? ORDER BY id DESC LIMIT 1", (machine,)
    ).fetchone()
    if last and last[1:] == (model, content):
        return int(last[0])
    return new_era(store, machine, model, layout, now)


def new_era(store: sqlite3.Connection, machine: str, model: str, layout: Layout, now: float) -> int:
    """Begin a new era of a machine in any case; parameters as for `era_of`."""
    made = store.execute(
        "INSERT INTO eras (machine, model, layout, begun) VALUES (?, ?, ?, ?)",
        (machine, model, layout_text(layout), now),
    )
    return int(made.lastrowid or 0)


def era_before(store: sqlite3.Connection, era: int) -> tuple[int | None, bool]:
    """Return the previous era with samples, and whether the estimator's state continues from it.

    The state continues if only the axes of the control have changed, on which it does not depend.
    """
    machine, model, content = store.execute(
        "SELECT machine, model, layout FROM eras WHERE id = ?", (era,)
    ).fetchone()
    last = store.execute(
        "SELECT id, model, layout FROM eras WHERE machine = ? AND id < ? AND (id IN "
        "(SELECT era FROM states) OR id IN (SELECT era FROM journal)) ORDER BY id DESC LIMIT 1",
        (machine, era),
    ).fetchone()
    if last is None:
        return None, False
    before, now = layout_from(last[2]), layout_from(content)
    return int(last[0]), last[1] == model and replace(
        before, controls=now.controls, lines=now.lines
    ) == now


def stored_eras(store: sqlite3.Connection, eras: Iterable[int]) -> dict[int, StoredEra]:
    """Return the stored data of some eras."""
    states = {
        era: (number, state, rest)
        for era, number, state, rest in store.execute("SELECT era, number, state, rest FROM states")
    }
    later: dict[int, list[StoredSample]] = {}
    for row in store.execute("SELECT era, number, row, status, rest FROM journal ORDER BY id"):
        taken = StoredSample(*row)
        if taken.number > states.get(taken.era, (0,))[0]:
            later.setdefault(taken.era, []).append(taken)
    layouts = dict(store.execute("SELECT id, layout FROM eras"))
    return {
        era: StoredEra(
            era,
            layout_from(layouts[era]),
            *states.get(era, (0, None, "{}")),
            tuple(later.get(era, ())),
        )
        for era in eras
    }


def last_received(store: sqlite3.Connection) -> dict[str, ReceivedOffsets]:
    """Return the values that the control of each machine received last."""
    rows = store.execute("SELECT machine, at, content FROM received")
    return {row[0]: ReceivedOffsets(*row) for row in rows}


def commit(store: sqlite3.Connection, batch: Batch) -> int:
    """Store a batch in one transaction; return the number of the journal's last entry."""
    store.execute("BEGIN IMMEDIATE")
    try:
        for statement, rows in (
            (_ADD_SAMPLE, batch.samples),
            (_PUT_STATE, [(one.era, one.number, one.state, one.rest) for one in batch.checkpoints]),
            (_ADD_CHUNK, [_chunk(one) for one in batch.checkpoints if len(one.rows)]),
            ("INSERT INTO events (time, machine, kind, text) VALUES (?, ?, ?, ?)", batch.events),
            ("INSERT INTO holes (machine, since, until, why) VALUES (?, ?, ?, ?)", batch.gaps),
            (_PUT_RECEIVED, batch.received),
        ):
            store.executemany(statement, rows)
        store.execute("COMMIT")
    except BaseException:
        # On a full disk SQLite has rolled back already.
        if store.in_transaction:
            store.execute("ROLLBACK")
        raise
    (last,) = store.execute("SELECT max(id) FROM journal").fetchone()
    return int(last or 0)


def _chunk(checkpoint: Checkpoint) -> tuple[object, ...]:
    count = len(checkpoint.rows)
    return (
        checkpoint.era,
        float(checkpoint.rows[0, 0]),
        float(checkpoint.rows[-1, 0]),
        checkpoint.number - count + 1,
        count,
        np.ascontiguousarray(checkpoint.rows, dtype="<f8").tobytes(),
        json.dumps(_runs(checkpoint.status)),
    )


def _runs(words: Sequence[str]) -> list[tuple[int, str]]:
    """Return each change of the status: (first row, words)."""
    return [(k, word) for k, word in enumerate(words) if k == 0 or words[k - 1] != word]


def expanded_runs(runs: Sequence[tuple[int, str]], count: int) -> list[str]:
    """Return the status of each row of a chunk."""
    ends = [*(first for first, _ in runs[1:]), count]
    return [word for (first, word), end in zip(runs, ends, strict=True) for _ in range(first, end)]


def prune(
    store: sqlite3.Connection, journal_until: int, eras: Iterable[int], oldest: float, now: float
) -> None:
    """Delete data no longer needed in small portions, because commits wait meanwhile.

    Of the journal, whose entries up to `journal_until` are in a checkpoint of every machine, up to
    `MOST_PRUNED` entries are deleted. Entries in no checkpoint are kept: their machine has another
    model since a kill, or is not served. The history of some eras, gaps and events are kept for a
    time `oldest`, s, before `now`, s since 1970.
    """
    store.execute("BEGIN IMMEDIATE")
    _move_ended_eras(store, journal_until)
    store.execute(
        "DELETE FROM journal WHERE id IN "
        f"(SELECT id FROM journal WHERE id <= ? AND NOT {IN_NO_CHUNK} ORDER BY id LIMIT ?)",
        (journal_until, MOST_PRUNED),
    )
    # The condition on `first` uses the index: otherwise every chunk of an era would be read.
    store.executemany(
        "WITH bound(at) AS (SELECT max(first) - ?2 FROM chunks WHERE era = ?1) "
        "DELETE FROM chunks WHERE era = ?1 AND first < (SELECT at FROM bound) "
        "AND last < (SELECT at FROM bound)",
        [(era, oldest) for era in eras],
    )
    store.execute("DELETE FROM events WHERE time < ?", (now - oldest,))
    store.execute("DELETE FROM holes WHERE until < ?", (now - oldest,))
    _prune_era(store, now - oldest, now)
    store.execute("COMMIT")


def _move_ended_eras(store: sqlite3.Connection, until: int) -> None:
    """Move samples of ended eras into chunks: a later era has a state, so no checkpoint will."""
    ended = store.execute(
        f"SELECT id, era, number, row, status FROM journal WHERE id <= ? AND {IN_NO_CHUNK} AND "
        "EXISTS (SELECT 1 FROM eras AS own JOIN eras AS next ON next.machine = own.machine AND "
        "next.id > own.id JOIN states ON states.era = next.id WHERE own.id = journal.era) "
        "ORDER BY era, number LIMIT ?",
        (until, MOST_PRUNED),
    ).fetchall()
    for era, samples in groupby(ended, key=itemgetter(1)):
        ids, _, numbers, rows, words = zip(*samples, strict=True)
        table = np.array([np.frombuffer(row, dtype="<f8") for row in rows])
        store.execute(_ADD_CHUNK, _chunk(Checkpoint(era, numbers[-1], b"", "", table, words)))
        store.executemany("DELETE FROM journal WHERE id = ?", [(one,) for one in ids])


def _prune_era(store: sqlite3.Connection, before: float, now: float) -> None:
    """Delete part of an era that has no samples between two times (s since 1970).

    That its successor began before them is not enough: the clock may have been behind then.
    """
    over = store.execute(
        "SELECT one.id FROM eras AS one JOIN eras AS next "
        "ON next.machine = one.machine AND next.id > one.id AND next.begun < ?1 "
        "WHERE NOT EXISTS "
        "(SELECT 1 FROM chunks WHERE era = one.id AND first BETWEEN ?1 AND ?2) LIMIT 1",
        (before, now),
    ).fetchone()
    if over is None:
        return
    deleted = store.execute(
        "DELETE FROM chunks WHERE id IN (SELECT id FROM chunks WHERE era = ? LIMIT ?)",
        (*over, _MOST_CHUNKS),
    )
    if deleted.rowcount < _MOST_CHUNKS:
        for table, key in (("states", "era"), ("journal", "era"), ("eras", "id")):
            store.execute(f"DELETE FROM {table} WHERE {key} = ?", over)


def checkpoint_wal(path: Path) -> None:
    """Move the write-ahead log into the file by a separate connection, while others write."""
    with closing(sqlite3.connect(path, timeout=_BUSY_TIMEOUT_S)) as own:
        for _ in range(_PASSES):
            own.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()


def layout_text(layout: Layout) -> str:
    """Return a layout as JSON; of its details, what earlier versions stored as well."""
    details = [(channel.name, channel.unit) for channel in layout.details]
    return json.dumps(asdict(layout) | {"details": details}, sort_keys=True)


def layout_from(text: str) -> Layout:
    """Return the layout from the JSON of `layout_text`."""
    return _LAYOUT.validate_python(json.loads(text))
