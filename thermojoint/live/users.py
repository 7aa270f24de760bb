"""Users with roles, machines and hashed passwords, in a file readable by its owner only.

One line each: ``name:role:machines:scrypt$N$r$p$salt$hash``, machines separated by commas, salt and
hash in hexadecimal.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.live.rights import ALL_MACHINES, ROLES, Principal, Role
from thermojoint.live.secret import create_private, refuse_open_to_others

#: Cost of a hash: 16 MB, and about 50 ms.
_N, _R, _P = 1 << 14, 8, 1
_SHORTEST, _LONGEST = 8, 256
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")
_MACHINES = re.compile(r"[A-Za-z0-9_*?-]{1,64}(,[A-Za-z0-9_*?-]{1,64})*")
_HASH = re.compile(r"scrypt\$(\d{4,6})\$(\d{1,2})\$(\d{1,2})\$([0-9a-f]{32})\$([0-9a-f]{64})")
#: Number of unverified passwords, of all users together, that are checked in this time (s).
MOST_TRIALS, TRIALS_S = 20, 60.0


@dataclass(frozen=True)
class UserLine:
    """A user."""

    #: One of `thermojoint.live.rights.ROLES`.
    role: Role
    #: Hash of the password.
    password: str = field(repr=False)
    #: Names of machines, or patterns.
    machines: tuple[str, ...] = ALL_MACHINES


def checked_rights(name: str, role: str, machines: Sequence[str]) -> tuple[Role, tuple[str, ...]]:
    """Return role and machines of a user or a token.

    Raises
    ------
    InputError
        The name, the role or a machine's pattern is not allowed.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r}: a user's name is up to 64 letters, digits, ., - and _")
    known = next((one for one in ROLES if one == role), None)
    if known is None:
        raise InputError(f"{name}: no role {role!r}; give one of {', '.join(ROLES)}")
    if not _MACHINES.fullmatch(",".join(machines)):
        raise InputError(f"{name}: machines are names or patterns like mill-*; correct them")
    return known, tuple(machines)


def read_users(path: Path) -> dict[str, UserLine]:
    """Read a file of users.

    Raises
    ------
    InputError
        The file is missing or readable by others, or a line is malformed.
    """
    refuse_open_to_others(path, "users")
    users: dict[str, UserLine] = {}
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not readable ({error}); write it as UTF-8") from error
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        name, role, machines, password = line.split(":") if line.count(":") == 3 else 4 * ("",)
        where = f"{path}, line {number}"
        if name in users or not _HASH.fullmatch(password):
            raise InputError(f"{where}: not a user; write it with `thermojoint users`")
        try:
            known, patterns = checked_rights(name, role, machines.split(","))
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        users[name] = UserLine(known, password, patterns)
    return users


def hashed(password: str) -> str:
    """Return the hash of a password in the format of the file.

    Raises
    ------
    InputError
        The password is too short or too long.
    """
    if not _SHORTEST <= len(password) <= _LONGEST:
        raise InputError(f"password: give {_SHORTEST} to {_LONGEST} characters")
    salt = secrets.token_bytes(16)
    key = _derived(password, salt, _N, _R, _P)
    return f"scrypt${_N}${_R}${_P}${salt.hex()}${key.hex()}"


def _derived(password: str, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=n, r=r, p=p, maxmem=256 * n * r, dklen=32)


def is_password(password: str, stored_hash: str) -> bool:
    """Return whether a hash belongs to a password."""
    match = _HASH.fullmatch(stored_hash)
    if match is None or len(password) > _LONGEST:
        return False
    n, r, p = (int(number) for number in match.groups()[:3])
    key = _derived(password, bytes.fromhex(match[4]), n, r, p)
    return hmac.compare_digest(key, bytes.fromhex(match[5]))


def add_user(
    path: Path, name: str, role: str, password: str, machines: Sequence[str] = ALL_MACHINES
) -> None:
    """Add a user to a file, or replace the user of that name.

    Raises
    ------
    InputError
        Name, role, machines or password cannot be used, or the file cannot.
    """
    known, patterns = checked_rights(name, role, machines)
    users = read_users(path) if path.exists() else {}
    _write(path, users | {name: UserLine(known, hashed(password), patterns)})


def remove_user(path: Path, name: str) -> None:
    """Remove a user from a file.

    Raises
    ------
    InputError
        The file has no such user, or cannot be used.
    """
    users = read_users(path)
    if users.pop(name, None) is None:
        raise InputError(f"{path}: no user named {name!r}; list them with `thermojoint users`")
    _write(path, users)


def _write(path: Path, users: Mapping[str, UserLine]) -> None:
    """Write the file whole; only its owner can ever read it."""
    text = "".join(
        f"{name}:{user.role}:{','.join(user.machines)}:{user.password}\n"
        for name, user in users.items()
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    create_private(part)
    part.write_text(text, "utf-8")
    part.replace(path)


def principal_of(name: str, user: UserLine) -> Principal:
    """Return the rights of a user."""
    credential = hashlib.sha256(f"{name}:{user.password}".encode()).hexdigest()
    return Principal(name, user.role, user.machines, credential)


@dataclass(eq=False)
class PasswordCheck:
    """Check of passwords that slows down guessing."""

    users: Mapping[str, UserLine]
    _right: dict[str, bytes] = field(default_factory=dict)
    _trials: list[float] = field(default_factory=list)
    _key: bytes = field(default_factory=lambda: secrets.token_bytes(32))

    def principal(self, name: str, password: str, clock: float) -> Principal | None:
        """Return the rights of a user; None if the password is wrong or too many were tried.

        The time is that of the service's own clock, s.
        """
        user = self.users.get(name)
        stored_hash = user.password if user else f"scrypt${_N}${_R}${_P}${'0' * 32}${'0' * 64}"
        # A verified password is not hashed again the next time.
        mark = hmac.digest(self._key, f"{name}\0{password}\0{stored_hash}".encode(), "sha256")
        if user and hmac.compare_digest(self._right.get(name, b""), mark):
            return principal_of(name, user)
        self._trials = [trial for trial in self._trials if clock - trial < TRIALS_S]
        if len(self._trials) >= MOST_TRIALS:
            return None
        self._trials.append(clock)
        # An unknown name takes as long as a wrong password.
        if not is_password(password, stored_hash) or user is None:
            return None
        self._trials.pop()
        self._right[name] = mark
        return principal_of(name, user)
