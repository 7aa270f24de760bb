"""Sessions of browsers, kept by the service: logging out ends them there.

The browser has a random ticket, the store its SHA-256 and the credential that began the session.
"""

from __future__ import annotations

import secrets
import sqlite3

from thermojoint.live.access_store import digest_of


def begin_session(store: sqlite3.Connection, credential: str, now: float, lasts: float) -> str:
    """Return the ticket of a new session of a credential that lasts for a time (s)."""
    ticket = secrets.token_urlsafe(32)
    store.execute("DELETE FROM sessions WHERE expires <= ?", (now,))
    store.execute(
        "INSERT INTO sessions VALUES (?, ?, ?)", (digest_of(ticket), credential, now + lasts)
    )
    return ticket


def credential_of(store: sqlite3.Connection, ticket: str, now: float) -> str | None:
    """Return the credential that began a session; None if it has ended or never was."""
    row = store.execute(
        "SELECT credential FROM sessions WHERE digest = ? AND expires > ?",
        (digest_of(ticket), now),
    ).fetchone()
    return None if row is None else str(row[0])


def end_session(store: sqlite3.Connection, ticket: str) -> None:
    """End a session."""
    store.execute("DELETE FROM sessions WHERE digest = ?", (digest_of(ticket),))
