"""Tokens of programs: named, with a role and machines, for a limited time, revoked one by one."""

from __future__ import annotations

import secrets
import sqlite3
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from thermojoint.artefacts.errors import InputError
from thermojoint.live.access_store import digest_of
from thermojoint.live.rights import ALL_MACHINES, Principal
from thermojoint.live.users import checked_rights

_SELECT = "SELECT name, role, machines, digest, expires, used FROM tokens"
#: Shortest interval at which the time of the last use is written, s.
_USED_S = 60.0


@dataclass(frozen=True)
class Token:
    """A token without its secret."""

    principal: Principal
    #: Time of expiry, s since 1970.
    expires: float
    #: Time of the last use, to a minute; s since 1970.
    used: float | None


def add_token(
    store: sqlite3.Connection,
    name: str,
    role: str,
    span: tuple[float, float],
    machines: Sequence[str] = ALL_MACHINES,
) -> str:
    """Create a token, and return its secret, which is not stored anywhere.

    `span` is the times of creation and expiry, s since 1970; `machines` are names or patterns.

    Raises
    ------
    InputError
        Name, role or machines are not allowed, or there is already a token of this name.
    """
    known, patterns = checked_rights(name, role, machines)
    secret = f"tj_{secrets.token_urlsafe(32)}"
    try:
        store.execute(
            "INSERT INTO tokens VALUES (?, ?, ?, ?, ?, ?, NULL)",
            (name, digest_of(secret), known, ",".join(patterns), *span),
        )
    except sqlite3.IntegrityError as error:
        raise InputError(f"{name}: a token of this name exists; revoke it first") from error
    return secret


def revoke_token(store: sqlite3.Connection, name: str) -> None:
    """Revoke a token; sessions begun with it end as well.

    Raises
    ------
    InputError
        There is no such token.
    """
    if not store.execute("DELETE FROM tokens WHERE name = ?", (name,)).rowcount:
        raise InputError(f"no token named {name!r}; list them with `thermojoint tokens`")


def tokens_in(store: sqlite3.Connection) -> list[Token]:
    """Return all tokens, including expired ones."""
    return [_token(row) for row in store.execute(f"{_SELECT} ORDER BY name")]


def token_of(store: sqlite3.Connection, digest: str, now: float) -> Principal | None:
    """Return the rights of a token by its digest; None if it is unknown or has expired."""
    found = store.execute(f"{_SELECT} WHERE digest = ? AND expires > ?", (digest, now)).fetchone()
    if found is None:
        return None
    token = _token(found)
    if token.used is None or now - token.used > _USED_S:
        # If the disk is full, the token is accepted although its use cannot be written.
        with suppress(sqlite3.OperationalError):
            store.execute("UPDATE tokens SET used = ? WHERE digest = ?", (now, digest))
    return token.principal


def _token(row: Sequence[object]) -> Token:
    name, role, machines, digest, expires, used = row
    principal = Principal(name, role, tuple(str(machines).split(",")), digest)  # type: ignore[arg-type]
    return Token(principal, expires, used)  # type: ignore[arg-type]
