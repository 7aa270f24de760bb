"""Private cache folders, below the user's cache or the system's temporary folder.

A service account may have no home, or one that it cannot write; a folder in a common place may
belong to somebody else. What is read back from a folder of `own_folder` was written by this user.
"""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from platformdirs import user_cache_path

#: A folder in which this much cannot be written (a full disk, a quota) is no place, bytes.
_LEAST_ROOM = 1 << 16


def user_cache() -> Path | None:
    """Return where this user's caches of the program belong; None for a user without a home."""
    place = user_cache_path("thermojoint", appauthor=False)
    # Where nobody knows the home, "~" stands in the path as it is.
    return place if place.is_absolute() else None


def own_folder(name: str) -> Path | None:
    """Return a folder that exists, belongs to this user alone and can be written.

    Parameters
    ----------
    name : str
        Its last part.

    Returns
    -------
    Path or None
        Below `user_cache` where that is possible, else below the temporary folder; None if nothing
        can be written anywhere.
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
    """Make a folder if it is missing; say whether it is this user's alone and has room."""
    user = os.geteuid()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Not what a link leads to: in the temporary folder anybody can put one.
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
