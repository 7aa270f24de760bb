"""Just-in-time compilation by Numba with a persistent cache.

By default Numba stores machine code next to the source or in the user's home, and fails if neither
is writable: a read-only installation, a service account. Here it is stored in a folder that belongs
to the user alone, because it is executed when it is loaded. Without such a folder every process
compiles anew. ``NUMBA_CACHE_DIR``, if set, takes precedence.

Cached code refers to the classes of its arguments and cannot be loaded after one of them has moved
to another module. Every version of the source therefore has its own folder; folders that have not
been used for long are deleted.
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
#: Machine code that has not been used for this time is deleted, s.
UNUSED = 30 * 86_400.0
_NAME = "machine-code"
#: Numba's settings, which have no type annotations.
_CONFIG: Any = numba.config
#: Compiled functions are not passed as values.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that is compiled at its first call, with NumPy's rules for division."""
    return _compiled(function, _OPTIONS)


def compiled_part(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that is called by compiled functions only.

    It has no Python wrapper: a call from Python ends the process, and `tests/fesim/test_jit.py`
    searches for such calls. With a hundred arrays among the arguments, compiling a wrapper takes
    six times as long as compiling the function itself.
    """
    return _compiled(function, {**_OPTIONS, "no_cpython_wrapper": True})


def _compiled(function: Callable[P, R], options: dict[str, Any]) -> Callable[P, R]:
    with _kept_in(_folder(function.__module__.partition(".")[0])):
        try:
            made = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no writable folder
            made = numba.njit(**options)(function)
    return cast(Callable[P, R], made)


@cache
def _folder(package: str) -> Path | None:
    """Cache folder for compiled code; None if Numba has its own, or none is writable."""
    if _CONFIG.CACHE_DIR:
        return None
    folder = own_folder(f"{_NAME}-{_source(package)}")
    if folder is not None:
        with suppress(OSError):
            os.utime(folder)  # mark as in use
        _drop_unused(folder.parent)
    return folder


def _source(package: str) -> str:
    """Digest of the source of a package, and of this one, whose classes the code may use."""
    packages = sorted({package, __name__.partition(".")[0]})
    return hashlib.sha256("".join(map(source_digest, packages)).encode()).hexdigest()[:16]


def _drop_unused(place: Path) -> None:
    for folder in place.glob(f"{_NAME}*"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > UNUSED:
                rmtree(folder)


@contextmanager
def _kept_in(folder: Path | None) -> Iterator[None]:
    """Make Numba store the functions declared in the block in `folder`."""
    before = _CONFIG.CACHE_DIR
    _CONFIG.CACHE_DIR = str(folder) if folder else before
    try:
        yield
    finally:
        _CONFIG.CACHE_DIR = before
