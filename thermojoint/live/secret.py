"""Secrets: never displayed, in files that only their owner can read."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.live.settings import Secret

#: Longest secret, bytes.
LONGEST = 4096


def read_secret(secret: Secret, where: str) -> str:
    """Return a secret: one line.

    Raises
    ------
    InputError
        The secret is missing, or others can read it.
    """
    if secret.variable is not None:
        value = os.environ.get(secret.variable, "")
        if not value:
            raise InputError(f"{where}: the variable {secret.variable} is not set; set it")
        return _line(value, f"{where}: variable {secret.variable}")
    path = _path_of(secret, where)
    if secret.file is not None:
        refuse_open_to_others(path, where)
    try:
        with path.open("rb") as file:
            content = file.read(LONGEST + 1)
        text = content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "no text"
        raise InputError(f"{where}: {path} is not readable ({why}); put the secret there") from None
    return _line(text, f"{where}: {path}")


def create_private(path: Path) -> None:
    """Create a file that only its owner can read, if it is missing.

    A file created by root belongs to the owner of the folder, because the service must write it.
    """
    if path.exists():
        return
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT, 0o600))
    if os.geteuid() == 0:
        folder = path.parent.stat()
        os.chown(path, folder.st_uid, folder.st_gid)


def refuse_open_to_others(path: Path, where: str, others: int = 0o077) -> None:
    """Refuse a file that others than its owner can read or write.

    Raises
    ------
    InputError
        The file is missing, or others can read it or write to it.
    """
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise InputError(
            f"{where}: {path} is not readable ({error.strerror}); put the secret there"
        ) from None
    if mode & others:
        raise InputError(f"{where}: others can read {path} (mode {mode:o}); chmod 600 {path}")


def _path_of(secret: Secret, where: str) -> Path:
    if secret.file is not None:
        return secret.file
    folder = os.environ.get("CREDENTIALS_DIRECTORY", "")
    if not folder:
        raise InputError(
            f"{where}: credential {secret.credential} needs systemd's LoadCredential=; give it, or "
            "a file"
        )
    return Path(folder) / str(secret.credential)


def _line(text: str, where: str) -> str:
    secret = text.strip()
    if not secret or len(secret) > LONGEST or "\n" in secret:
        raise InputError(f"{where}: a secret is one line, not empty; correct it")
    return secret
