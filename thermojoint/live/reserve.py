"""Room that a store holds in its own file, for the time in which the disk is full.

Overwriting blocks that a file has needs no space. The file has free pages, which SQLite takes
before it makes the file longer, and rows without content (table ``reserve``), which are deleted
when the disk is full and the free pages become few. The write-ahead log has its length already and
is begun anew each second meanwhile. A file beside the store that is deleted instead would give its
space to whatever fills the disk.
"""

from __future__ import annotations

import os
import sqlite3
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import NamedTuple

#: Size of a row, bytes: what is added or given up at once.
SLICE = 4 << 20
#: Bytes of a store per byte of its samples: pages are not filled to the last byte.
OVERHEAD = 1.4
_MARGIN = 4 * SLICE
#: The table of the rows without content.
RESERVE = "CREATE TABLE IF NOT EXISTS reserve (id INTEGER PRIMARY KEY, room BLOB NOT NULL);"


class Room(NamedTuple):
    """Room for a store."""

    #: The disk is full, up to a margin.
    full: bool = False
    #: What the file itself has, bytes.
    reserve: int = 0


def is_full(path: Path) -> bool:
    """Say whether the disk of a file is full, up to a margin."""
    return _free(path) < _MARGIN


def stay_within(store: sqlite3.Connection, log: int) -> None:
    """Make a connection write as little as it can: a full disk has no room for more.

    What is deleted is not overwritten, no temporary files are written, and the write-ahead log
    is begun anew from a size (bytes) on, but keeps that length.
    """
    store.execute("PRAGMA secure_delete = OFF")
    store.execute("PRAGMA temp_store = MEMORY")
    store.execute(f"PRAGMA wal_autocheckpoint = {log // 4096}")
    store.execute(f"PRAGMA journal_size_limit = {log}")


def lay_in(store: sqlite3.Connection, path: Path, size: int = 2 * SLICE) -> None:
    """Give a file free pages of a size (bytes) together, and its write-ahead log that length.

    On a full disk the store has what it had.
    """
    if not is_full(path):
        row = _grow(store, size)
        store.execute("DELETE FROM reserve WHERE id = ?", (row,))


def close(store: sqlite3.Connection, path: Path) -> None:
    """Close a store; on a full disk its write-ahead log stays: there is no room for another."""
    with ExitStack() as last:
        if path.exists() and is_full(path):
            # Whoever is last and may only read deletes nothing.
            uri = f"{path.absolute().as_uri()}?mode=ro"
            reader = last.enter_context(closing(sqlite3.connect(uri, uri=True)))
            with suppress(sqlite3.DatabaseError):
                reader.execute("SELECT count(*) FROM reserve").fetchone()
        store.close()


def tend(store: sqlite3.Connection, path: Path, wanted: float) -> Room:
    """Move the reserve of a store one slice towards what is wanted, and return the room.

    Parameters
    ----------
    store : Connection
        The only one that writes.
    path : Path
        Its file.
    wanted : float
        Size of the reserve, bytes; at most half of what the disk has left is taken.

    Raises
    ------
    sqlite3.OperationalError
        The reserve is used up, or another program holds the file.
    """
    full, size = is_full(path), _rows(store)
    if full:
        # All of the log is in the file afterwards, so that the next commit begins it anew.
        # It waits for room where the reserve was used up.
        with suppress(sqlite3.OperationalError):
            store.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        if _free_pages(store) < SLICE // 2:
            store.execute("DELETE FROM reserve WHERE id = (SELECT max(id) FROM reserve)")
    else:
        if size < min(wanted, (_free(path) + size) / 2.0):
            _grow(store, SLICE)
        # A row takes the free pages first, and then makes the file longer.
        if _free_pages(store) < SLICE // 2:
            lay_in(store, path, SLICE)
    return Room(full, _rows(store) + _free_pages(store))


def _grow(store: sqlite3.Connection, size: int) -> int:
    """Add a row of a size (bytes), and have its blocks written; return its number."""
    row = store.execute("INSERT INTO reserve (room) VALUES (zeroblob(?))", (size,)).lastrowid
    store.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
    return int(row or 0)


def _rows(store: sqlite3.Connection) -> int:
    """Return the size of the rows without content, bytes."""
    ((count,),) = store.execute("SELECT count(*) FROM reserve")
    return int(count * SLICE)


def _free_pages(store: sqlite3.Connection) -> int:
    """Return the size of the free pages of a file, bytes."""
    ((pages,),) = store.execute("PRAGMA freelist_count")
    ((size,),) = store.execute("PRAGMA page_size")
    return int(pages * size)


def _free(path: Path) -> int:
    """Return what the disk of a file has left, bytes."""
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize
