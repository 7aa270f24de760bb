"""Store of tokens and sessions: one SQLite file, written by the service and by its commands."""

from __future__ import annotations

import sqlite3
from hashlib import sha256
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.live.disk_reserve import RESERVE, is_full, limit_writes
from thermojoint.live.secret import create_private

#: Name of the file in the folder of a service.
NAME = "access.sqlite"
#: Reserve for a full disk, bytes: hundreds of sessions.
RESERVE_SIZE = 1 << 18
#: Longest time for which the service waits for a command that writes, s.
_PATIENCE_S = 0.5
_TABLES = """
CREATE TABLE IF NOT EXISTS tokens (
  name TEXT PRIMARY KEY, digest TEXT NOT NULL UNIQUE, role TEXT NOT NULL, machines TEXT NOT NULL,
  created REAL NOT NULL, expires REAL NOT NULL, used REAL);
CREATE TABLE IF NOT EXISTS sessions (
  digest TEXT PRIMARY KEY, credential TEXT NOT NULL, expires REAL NOT NULL);
"""


def open_access(folder: Path) -> sqlite3.Connection:
    """Open or create the store in the folder of a service; only its owner can read it.

    Raises
    ------
    InputError
        The store is damaged, or the folder cannot be written to.
    """
    path = folder / NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        create_private(path)
        store = sqlite3.connect(
            path, isolation_level=None, timeout=_PATIENCE_S, check_same_thread=False
        )
        store.execute("PRAGMA journal_mode = WAL")
        store.execute("PRAGMA synchronous = NORMAL")
        limit_writes(store, RESERVE_SIZE)
        store.executescript(_TABLES + RESERVE)
    except (sqlite3.Error, OSError) as error:
        if folder.exists() and is_full(path):
            raise InputError(f"{path}: the disk is full ({error}); make room on it") from error
        raise InputError(
            f"{path}: cannot be used ({error}); restore it, or remove it to end all tokens"
        ) from error
    return store


def digest_of(text: str) -> str:
    """Return the SHA-256 of a token, which is stored in its place."""
    return sha256(text.encode("utf-8", "replace")).hexdigest()
