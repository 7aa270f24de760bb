"""Authentication: users by password, programs by token, browsers by their session."""

from __future__ import annotations

import secrets
import sqlite3
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.live.access_store import NAME as ACCESS
from thermojoint.live.access_store import RESERVE_SIZE, digest_of, open_access
from thermojoint.live.audit import NAME, Audit
from thermojoint.live.disk_reserve import preallocate
from thermojoint.live.rights import Principal
from thermojoint.live.secret import read_secret
from thermojoint.live.settings import Service
from thermojoint.live.tokens import token_of, tokens_in
from thermojoint.live.users import PasswordCheck, principal_of, read_users

#: Smallest length of a token of the settings: so many random characters cannot be guessed.
SHORTEST_TOKEN = 32


@dataclass(eq=False)
class Accounts:
    """Users, tokens and sessions of a service, and its audit log."""

    #: `thermojoint.live.access_store`.
    store: sqlite3.Connection
    audit: Audit
    #: Users' file; read again whenever it changes.
    users_file: Path | None = None
    #: Token of the settings, by its digest.
    given: Mapping[str, Principal] = field(default_factory=dict)
    passwords: PasswordCheck = field(default_factory=lambda: PasswordCheck({}))
    _read: int = -1

    def check_log_in(self) -> None:
        """Refuse an HTTP server where no one could log in."""
        if not (self.given or self.users_file or tokens_in(self.store)):
            raise InputError("http: no one could log in; name a token or a file of users")

    def by_password(self, name: str, password: str) -> Principal | None:
        """Return the rights of a user; None if the password is wrong."""
        self._refresh()
        return self.passwords.principal(name, password, time.monotonic())

    def by_token(self, token: str) -> Principal | None:
        """Return the rights of a token; None if it is unknown, revoked or expired."""
        return self._by_digest(digest_of(token))

    def by_session(self, ticket: str) -> Principal | None:
        """Return the rights of a session; None if it, its user or its token has ended."""
        if not ticket:
            return None
        row = self.store.execute(
            "SELECT credential FROM sessions WHERE digest = ? AND expires > ?",
            (digest_of(ticket), time.time()),
        ).fetchone()
        return None if row is None else self.by_credential(row[0])

    def by_credential(self, credential: str) -> Principal | None:
        """Return the present rights of a credential; None if it has ended."""
        self._refresh()
        for name, user in self.passwords.users.items():
            found = principal_of(name, user)
            if found.credential == credential:
                return found
        return self._by_digest(credential)

    def begin(self, principal: Principal, lasts: float) -> str:
        """Return the ticket of a new session that lasts for a time (s).

        The browser gets a random ticket; the store has its SHA-256 and the credential of the
        session, so that a log-out ends the session on the server.
        """
        ticket, now = secrets.token_urlsafe(32), time.time()
        session = digest_of(ticket), principal.credential, now + lasts
        self.store.execute("DELETE FROM sessions WHERE expires <= ?", (now,))
        self.store.execute("INSERT INTO sessions VALUES (?, ?, ?)", session)
        return ticket

    def end(self, ticket: str) -> None:
        """End a session."""
        self.store.execute("DELETE FROM sessions WHERE digest = ?", (digest_of(ticket),))

    def _by_digest(self, digest: str) -> Principal | None:
        return self.given.get(digest) or token_of(self.store, digest, time.time())

    def _refresh(self) -> None:
        """Read the users again if their file has changed; a damaged file changes nothing."""
        if self.users_file is None:
            return
        with suppress(OSError, InputError):
            changed = self.users_file.stat().st_mtime_ns
            if changed != self._read:
                self.passwords.users = read_users(self.users_file)
                self._read = changed


def audit_of(service: Service) -> Audit:
    """Return the audit log of a service."""
    section = service.given.audit
    service.folder.mkdir(parents=True, exist_ok=True)
    largest = round(1e6 * section.largest_mb)
    return Audit(service.folder / NAME, largest, 86400.0 * section.keep_days)


def accounts_of(service: Service) -> Accounts:
    """Open users, tokens and sessions of a service.

    Raises
    ------
    InputError
        The users' file, the token of the settings or the store cannot be used.
    """
    http = service.given.http
    given = {}
    if http is not None and http.token is not None:
        token = read_secret(http.token, "http.token")
        given = {digest_of(token): Principal("http.token", credential=checked(token))}
    users = service.users_file
    passwords = PasswordCheck({} if users is None else read_users(users))
    store = open_access(service.folder)
    with suppress(sqlite3.OperationalError):
        preallocate(store, service.folder / ACCESS, RESERVE_SIZE)
    return Accounts(store, audit_of(service), users, given, passwords)


def checked(token: str) -> str:
    """Return the digest of a token of the settings.

    Raises
    ------
    InputError
        The token is too short, or contains characters that a header cannot.
    """
    if len(token) < SHORTEST_TOKEN or not token.isascii() or len(token.split()) != 1:
        raise InputError(
            f"http.token: a token has at least {SHORTEST_TOKEN} letters and digits; make one: "
            "openssl rand -hex 32"
        )
    return digest_of(token)
