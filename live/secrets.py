"""Secrets: read where they are kept, never from the service's file, never shown."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from artefacts.errors import InputError
from live.settings import Secret

_LARGEST = 4096


def secret_in(secret: Secret, base: Path, where: str) -> str:
    """Return a secret.

    Parameters
    ----------
    secret : Secret
        Where it is kept.
    base : Path
        Where paths begin.
    where : str
        For error messages, which never show the secret.

    Raises
    ------
    InputError
        It is not there, empty, or a file that others may read.
    """
    if secret.variable is not None:
        found = os.environ.get(secret.variable, "")
    elif secret.credential is not None:
        folder = os.environ.get("CREDENTIALS_DIRECTORY")
        if folder is None or Path(secret.credential).name != secret.credential:
            raise InputError(
                f"{where}: no credential {secret.credential!r}; add LoadCredential= to the unit"
            )
        found = _content(Path(folder) / secret.credential, where)
    else:
        path = base / str(secret.file)
        refuse_open_to_others(path, where)
        found = _content(path, where)
    found = found.rstrip("\r\n")
    if not found:
        raise InputError(f"{where}: the secret is empty; put it where the file says")
    return found


def refuse_open_to_others(path: Path, where: str) -> None:
    """Refuse a file that is not its owner's alone (a group may read it).

    Raises
    ------
    InputError
        It is missing, or others may read it or write to it.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise InputError(f"{where}: {path}: cannot be read; give a file with the secret") from error
    if mode & (stat.S_IRWXO | stat.S_IWGRP):
        raise InputError(f"{where}: {path}: others may read it or write to it; run chmod 600 on it")


def _content(path: Path, where: str) -> str:
    try:
        with path.open(encoding="utf-8") as file:
            return file.read(_LARGEST)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: {path}: cannot be read; give a file with the secret") from error
