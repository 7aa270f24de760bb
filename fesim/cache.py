"""Disk cache of condensations, keyed by a digest of everything they depend on.

An entry is one file, named after a digest of everything it depends on: the case without loads and
joint laws, the content of its mesh, this program's source and the versions of the numerical
libraries. Entries therefore never become stale. An entry is written completely or not at all and
never changed, so that any number of processes may read and write at once. It is verified on reading
(zip files contain checksums); a damaged entry counts as missing.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.files import DAMAGED_ARCHIVE, whole_file
from thermojoint.artefacts.own_folder import user_cache
from thermojoint.artefacts.source import source_digest

#: Folder of the entries; ``off`` for none. Default: the system's folder for user caches.
VARIABLE = "THERMOJOINT_CACHE"

#: Age at which an unfinished file of a killed process is deleted, s.
ABANDONED = 86_400.0

#: Total size of entries above which the least recently used ones are deleted, bytes.
LIMIT = 10_000_000_000

_LIBRARIES = ("numpy", "scipy", "scikit-fem", "meshio")
_SOURCES = ("thermojoint.artefacts", "meshes", "fesim")

#: Names of entries; other files in the folder are left alone.
_NAME = 64 * "[0-9a-f]"

T = TypeVar("T")
Arrays = dict[str, NDArray[np.float64]]


def remembered(
    kind: type[T], key: str | None, make: Callable[[], T], also: str = "", limit: int = LIMIT
) -> T:
    """Return a dataclass of arrays and numbers: the one stored under a key, or a new one.

    Parameters
    ----------
    kind : type
        The dataclass.
    key : str or None
        Digest of everything it depends on except the program; None for no caching.
    make : callable
        Computes it.
    also : str, optional
        Further dependencies.
    limit : int, optional
        Limit on the total size of entries, bytes.
    """
    if key is None:
        return make()
    name = f"{kind.__name__} {key} {also}"
    arrays = load(name)
    if arrays is not None:
        return kind(
            **{field: array if array.ndim else array.item() for field, array in arrays.items()}
        )
    made = make()
    store(name, {field: np.asarray(value) for field, value in vars(made).items()}, limit)
    return made


def folder() -> Path | None:
    """Return the folder of the entries, or None if there is no cache."""
    given = os.environ.get(VARIABLE, "")
    if given.lower() == "off":
        return None
    return Path(given) if given else user_cache()


def load(key: str) -> Arrays | None:
    """Return the arrays stored under a key, or None."""
    place = folder()
    if place is None:
        return None
    path = _path(place, key)
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = dict(content)
    except DAMAGED_ARCHIVE:
        return None
    with suppress(OSError):
        os.utime(path)  # mark as the most recently used one
    return arrays


def store(key: str, arrays: Mapping[str, NDArray[np.float64]], limit: int = LIMIT) -> None:
    """Store arrays under a key.

    If the folder is not writable or the disk is full, the next run computes them again.
    """
    place = folder()
    if place is None:
        return
    contents: dict[str, Any] = dict(arrays)
    with suppress(OSError):
        with whole_file(_path(place, key)) as part, part.open("wb") as file:
            np.savez(file, **contents)
        _trim(place, limit)


@cache
def program() -> str:
    """Return a digest of this program's source and its libraries' versions."""
    digest = hashlib.sha256()
    for name in _LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    for package in _SOURCES:
        digest.update(source_digest(package).encode())
    return digest.hexdigest()


def _path(place: Path, key: str) -> Path:
    return place / f"{hashlib.sha256(f'{program()} {key}'.encode()).hexdigest()}.npz"


def _trim(place: Path, limit: int) -> None:
    for path in place.glob(f".{_NAME}.*.npz"):
        with suppress(OSError):
            if path.stat().st_mtime < time.time() - ABANDONED:
                path.unlink()
    entries = []
    for path in place.glob(f"{_NAME}.npz"):
        with suppress(OSError):  # another process may delete it
            status = path.stat()
            entries.append((status.st_mtime, status.st_size, path))
    size = sum(entry[1] for entry in entries)
    for _, taken, path in sorted(entries)[:-1]:
        if size <= limit:
            return
        with suppress(OSError):
            path.unlink()
        size -= taken
