"""Just-in-time compilation by Numba with a persistent cache.

Left to itself, Numba keeps machine code beside the source or in the user's home, and fails where
neither can be written: an installation of somebody else's, a service account. Here it goes into a
folder of the user's own, because it is executed when it is read back. Where there is none, every
process compiles for itself. A ``NUMBA_CACHE_DIR`` that is set goes before.

What is kept names the classes of its arguments, and cannot be read once one of them has moved to
another module. So every source has a folder of its own, and one that nobody used for long goes.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from shutil import rmtree
from typing import Any, ParamSpec, TypeVar, cast

import numba

from thermojoint.artefacts.own_folder import own_folder
from thermojoint.artefacts.source import source_digest

P = ParamSpec("P")
R = TypeVar("R")
#: Machine code of a source that nobody used for so long is dropped, s.
UNUSED = 30 * 86_400.0
_NAME = "machine-code"
#: Numba's settings, which have no types.
_CONFIG: Any = numba.config


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function` as machine code, made at its first call; it divides as NumPy does."""
    with _kept_in(_folder(function.__module__.partition(".")[0])):
        try:
            made = numba.njit(error_model="numpy", cache=True)(function)
        except RuntimeError:  # no place that can be written
            made = numba.njit(error_model="numpy")(function)
    return cast(Callable[P, R], made)


@cache
def _folder(package: str) -> Path | None:
    """Cache folder for compiled code; None if Numba has its own, or none is writable."""
    if _CONFIG.CACHE_DIR:
        return None
    folder = own_folder(f"{_NAME}-{_source(package)}")
    if folder is not None:
        with suppress(OSError):
            os.utime(folder)  # It is in use.
        _drop_unused(folder.parent)
    return folder


def _source(package: str) -> str:
    """Digest of a package, and of this one, whose classes it may use."""
    packages = sorted({package, __name__.partition(".")[0]})
    return hashlib.sha256("".join(map(source_digest, packages)).encode()).hexdigest()[:16]


def _drop_unused(place: Path) -> None:
    for folder in place.glob(f"{_NAME}*"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > UNUSED:
                rmtree(folder)


@contextmanager
def _kept_in(folder: Path | None) -> Iterator[None]:
    """Have Numba keep in `folder` what is declared here, and nothing else."""
    before = _CONFIG.CACHE_DIR
    _CONFIG.CACHE_DIR = str(folder) if folder else before
    try:
        yield
    finally:
        _CONFIG.CACHE_DIR = before
