"""Reserve of space in a store's own file, for times when the disk is full.

Overwriting the blocks of a file needs no space. The file has free pages, which SQLite uses before
it extends the file, and rows without content (table ``reserve``), which are deleted when the disk
is full and the free pages become few. The write-ahead log already has its full length and is
restarted every second meanwhile. A separate reserve file, once deleted, would give its space to
the program that fills the disk.
"""

from __future__ import annotations

import os
import sqlite3
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import NamedTuple

#: Size of a row, bytes, by which the reserve grows or shrinks.
SLICE = 4 << 20
#: Bytes of a store per byte of its samples: pages are not filled to the last byte.
OVERHEAD = 1.4
_MARGIN = 4 * SLICE
#: The table of the rows without content.
RESERVE = "CREATE TABLE IF NOT EXISTS reserve (id INTEGER PRIMARY KEY, room BLOB NOT NULL);"


class DiskSpace(NamedTuple):
    """Space for a store."""

    #: Whether the disk is full, up to a margin.
    full: bool = False
    #: Reserve in the file itself, bytes.
    reserve: int = 0


def is_full(path: Path) -> bool:
    """Return whether the disk of a file is full, up to a margin."""
    return _free_space(path) < _MARGIN


def limit_writes(store: sqlite3.Connection, log: int) -> None:
    """Make a connection write as little as possible, because the disk may be full.

    Deleted content is not overwritten, no temporary files are written, and the write-ahead log is
    restarted when it reaches a size (bytes), but keeps that length.
    """
    store.execute("PRAGMA secure_delete = OFF")
    store.execute("PRAGMA temp_store = MEMORY")
    store.execute(f"PRAGMA wal_autocheckpoint = {log // 4096}")
    store.execute(f"PRAGMA journal_size_limit = {log}")


def preallocate(store: sqlite3.Connection, path: Path, size: int = 2 * SLICE) -> None:
    """Give a file free pages with a total size (bytes), and its write-ahead log that length.

    On a full disk the store stays as it was.
    """
    if not is_full(path):
        row = _add_row(store, size)
        store.execute("DELETE FROM reserve WHERE id = ?", (row,))


def close(store: sqlite3.Connection, path: Path) -> None:
    """Close a store; on a full disk its write-ahead log is kept: there is no room for a new one."""
    with ExitStack() as last:
        if path.exists() and is_full(path):
            # SQLite does not delete the log if the last connection is read-only.
            uri = f"{path.absolute().as_uri()}?mode=ro"
            reader = last.enter_context(closing(sqlite3.connect(uri, uri=True)))
            with suppress(sqlite3.DatabaseError):
                reader.execute("SELECT count(*) FROM reserve").fetchone()
        store.close()


def adjust_reserve(store: sqlite3.Connection, path: Path, wanted: float) -> DiskSpace:
    """Adjust the reserve of a store by one slice towards the wanted size; return the space.

    The size is in bytes; at most half of the free space of the disk is used. No other connection
    writes.

    Raises
    ------
    sqlite3.OperationalError
        The reserve is used up, or another program locks the file.
    """
    full, size = is_full(path), _reserve_size(store)
    if full:
        # Afterwards the whole log is in the file, so that the next commit restarts it. If the
        # reserve was used up, the log waits for space.
        with suppress(sqlite3.OperationalError):
            store.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        if _free_pages(store) < SLICE // 2:
            store.execute("DELETE FROM reserve WHERE id = (SELECT max(id) FROM reserve)")
    else:
        if size < min(wanted, (_free_space(path) + size) / 2.0):
            _add_row(store, SLICE)
        # A row uses the free pages first, and then extends the file.
        if _free_pages(store) < SLICE // 2:
            preallocate(store, path, SLICE)
    return DiskSpace(full, _reserve_size(store) + _free_pages(store))


def _add_row(store: sqlite3.Connection, size: int) -> int:
    """Add a row of a size (bytes) and write its blocks to the file; return its number."""
    row = store.execute("INSERT INTO reserve (room) VALUES (zeroblob(?))", (size,)).lastrowid
    store.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
    return int(row or 0)


def _reserve_size(store: sqlite3.Connection) -> int:
    """Return the size of the rows without content, bytes."""
    ((count,),) = store.execute("SELECT count(*) FROM reserve")
    return int(count * SLICE)


def _free_pages(store: sqlite3.Connection) -> int:
    """Return the size of the free pages of a file, bytes."""
    ((pages,),) = store.execute("PRAGMA freelist_count")
    ((size,),) = store.execute("PRAGMA page_size")
    return int(pages * size)


def _free_space(path: Path) -> int:
    """Return the free space on the disk of a file, bytes."""
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize
