"""Private cache folders, below the user's cache or the system's temporary folder.

A service account may have no home folder, or one without write permission; a folder in a shared
place may belong to another user. Files in a folder of `own_folder` were written by this user.
"""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from platformdirs import user_cache_path

#: A folder must have room for this many bytes (full disk, quota).
_LEAST_ROOM = 1 << 16


def user_cache() -> Path | None:
    """Return the folder for this user's caches of the program; None for a user without a home."""
    place = user_cache_path("thermojoint", appauthor=False)
    # If the home is unknown, "~" remains in the path.
    return place if place.is_absolute() else None


def own_folder(name: str) -> Path | None:
    """Return an existing, writable folder that belongs to this user alone, or None.

    It is below `user_cache` if possible, else below the temporary folder.
    """
    try:
        temporary = Path(tempfile.gettempdir()) / f"thermojoint-{os.geteuid()}"
    except OSError:
        temporary = None
    for place in (user_cache(), temporary):
        if place is not None and _usable(place / name):
            return place / name
    return None


def _usable(folder: Path) -> bool:
    """Create a folder if it is missing; return whether it belongs to this user and has room."""
    user = os.geteuid()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Links are not followed: anybody can create one in the temporary folder.
        status, above = folder.lstat(), folder.parent.stat()
        if not stat.S_ISDIR(status.st_mode) or not status.st_uid == above.st_uid == user:
            return False
        if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return False
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_LEAST_ROOM))
    except OSError:
        return False
    return True
