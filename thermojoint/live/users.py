"""Users with roles and hashed passwords, in a file private to the service.

A line each: ``name:reads:scrypt$N$r$p$salt$hash``, the last two in hexadecimal.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from thermojoint.artefacts.errors import InputError
from thermojoint.live.secret import refuse_open_to_others

Role = Literal["reads", "writes"]
#: Cost of a hash: 16 MB, and about 50 ms.
_N, _R, _P = 1 << 14, 8, 1
_SHORTEST, _LONGEST = 8, 256
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")
_HASH = re.compile(r"scrypt\$(\d{4,6})\$(\d{1,2})\$(\d{1,2})\$([0-9a-f]{32})\$([0-9a-f]{64})")
#: Passwords not known to be right are checked so often in a time (s), of all users together.
MOST_TRIALS, TRIALS_S = 20, 60.0


@dataclass(frozen=True)
class UserLine:
    """One user.

    Attributes
    ----------
    role : str
        ``reads`` or ``writes``.
    password : str
        Hashed.
    """

    role: Role
    password: str

    def __repr__(self) -> str:
        return f"UserLine({self.role})"


def read_users(path: Path) -> dict[str, UserLine]:
    """Read a file of users.

    Raises
    ------
    InputError
        It is missing, open to others, or a line is none.
    """
    refuse_open_to_others(path, "users")
    users: dict[str, UserLine] = {}
    for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        name, _, rest = line.partition(":")
        role, _, password = rest.partition(":")
        if not _NAME.fullmatch(name) or role not in ("reads", "writes") or name in users:
            raise InputError(f"{path}, line {number}: no user; write it with --add-user")
        if not _HASH.fullmatch(password):
            raise InputError(f"{path}, line {number}: no hashed password; write it with --add-user")
        users[name] = UserLine(role, password)  # type: ignore[arg-type]
    return users


def hashed(password: str) -> str:
    """Return a password as the file keeps it.

    Raises
    ------
    InputError
        It is too short or too long.
    """
    if not _SHORTEST <= len(password) <= _LONGEST:
        raise InputError(f"password: give {_SHORTEST} to {_LONGEST} characters")
    salt = secrets.token_bytes(16)
    key = _derived(password, salt, _N, _R, _P)
    return f"scrypt${_N}${_R}${_P}${salt.hex()}${key.hex()}"


def _derived(password: str, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=n, r=r, p=p, maxmem=256 * n * r, dklen=32)


def is_password(password: str, kept: str) -> bool:
    """Say whether a password is the one that a hash was made of."""
    match = _HASH.fullmatch(kept)
    if match is None or len(password) > _LONGEST:
        return False
    n, r, p = (int(number) for number in match.groups()[:3])
    key = _derived(password, bytes.fromhex(match[4]), n, r, p)
    return hmac.compare_digest(key, bytes.fromhex(match[5]))


def add_user(path: Path, name: str, role: Role, password: str) -> None:
    """Add a user to a file, or give one another role and password; the file is its owner's alone.

    Raises
    ------
    InputError
        The name or the password is none, or the file is unusable.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r}: a user's name is up to 64 letters, digits, ., - and _")
    users = read_users(path) if path.exists() else {}
    users[name] = UserLine(role, hashed(password))
    text = "".join(f"{user}:{line.role}:{line.password}\n" for user, line in users.items())
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(text)
    part.replace(path)


@dataclass(eq=False)
class Gate:
    """Lets users in, and nobody try for long.

    Attributes
    ----------
    users : mapping of str to UserLine
    """

    users: Mapping[str, UserLine]
    _right: dict[str, bytes] = field(default_factory=dict)
    _trials: list[float] = field(default_factory=list)
    _key: bytes = field(default_factory=lambda: secrets.token_bytes(32))

    def role_of(self, name: str, password: str, clock: float) -> Role | None:
        """Return what a user may do; None if the password is wrong or too many were tried.

        Parameters
        ----------
        name, password : str
        clock : float
            The service's own clock, s.
        """
        user = self.users.get(name)
        # A login that was right costs nothing the next time.
        mark = hmac.digest(self._key, f"{name}\0{password}".encode(), "sha256")
        if user and hmac.compare_digest(self._right.get(name, b""), mark):
            return user.role
        self._trials = [trial for trial in self._trials if clock - trial < TRIALS_S]
        if len(self._trials) >= MOST_TRIALS:
            return None
        self._trials.append(clock)
        # As long for a name that is not there.
        kept = user.password if user else f"scrypt${_N}${_R}${_P}${'0' * 32}${'0' * 64}"
        if not is_password(password, kept) or user is None:
            return None
        self._trials.pop()
        self._right[name] = mark
        return user.role
