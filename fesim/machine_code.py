"""Functions compiled to machine code by Numba, kept from run to run where there is a place.

Left to itself, Numba keeps machine code beside the source or in the user's home, and fails where
neither can be written: an installation of somebody else's, a service account. Here it goes into a
folder of the user's own, because it is executed when it is read back. Where there is none, every
process compiles for itself. A ``NUMBA_CACHE_DIR`` that is set goes before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

from artefacts.own_folder import own_folder

P = ParamSpec("P")
R = TypeVar("R")
#: Numba's settings, which have no types.
_CONFIG: Any = numba.config


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function` as machine code, made at its first call; it divides as NumPy does."""
    with _kept_in(_folder()):
        try:
            made = numba.njit(error_model="numpy", cache=True)(function)
        except RuntimeError:  # no place that can be written
            made = numba.njit(error_model="numpy")(function)
    return cast(Callable[P, R], made)


@cache
def _folder() -> Path | None:
    return None if _CONFIG.CACHE_DIR else own_folder("machine-code")


@contextmanager
def _kept_in(folder: Path | None) -> Iterator[None]:
    """Have Numba keep in `folder` what is declared here, and nothing else."""
    before = _CONFIG.CACHE_DIR
    _CONFIG.CACHE_DIR = str(folder) if folder else before
    try:
        yield
    finally:
        _CONFIG.CACHE_DIR = before
