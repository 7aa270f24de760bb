"""Preparation of every process of the program before it loads the libraries.

Loading them creates several hundred thousand permanent objects. Python's garbage collector would
traverse them again and again, for a fifth of the time, and once more when the process ends, for a
tenth of the duration of a short one.

SciPy imports all parts of NumPy, including f2py (Fortran), which takes as long to load as
everything else that sparse matrices need; its spatial search imports its rotations. Loading of both
is deferred to their first use, which never comes.

A thread of OpenBLAS, NumPy's library of linear algebra, spins for 20 ms in wait of the next product
before it sleeps, also after its start. With small products it spins most of the time, and on a busy
computer it delays products; here it sleeps after 20 us.

Where Dask is installed, xarray loads it and its arrays with the first variable, to check whether
the variable is a Dask array; that takes as long as xarray itself. No command and none of their
child processes creates Dask arrays, and only a batch on a cluster needs Dask at all. A user's own
process keeps it.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import cast

_LATER = ("numpy.f2py", "scipy.spatial.transform")
#: Clock cycles, as a power of two, for which a thread of OpenBLAS spins before it sleeps.
_WAITING = ("OPENBLAS_THREAD_TIMEOUT", "16")
#: Objects created between two collections; collections of a generation per one of the next.
_COLLECTIONS = (50_000, 20, 20)


def prepare_process() -> None:
    """Collect garbage less often, and make imports of Dask fail, so that xarray does without it.

    Loading of unused modules is deferred to their first use. Threads of OpenBLAS spin for the time
    that the user's environment sets, else briefly.

    If xarray is loaded already, Dask stays importable: xarray may rely on it.
    """
    gc.set_threshold(*_COLLECTIONS)
    atexit.register(gc.freeze)
    os.environ.setdefault(*_WAITING)
    if _Later not in sys.meta_path:
        sys.meta_path.insert(0, _Later)
    if "xarray" in sys.modules:
        return
    # With None in place of a module, Python refuses to import it and what is in it. Its arrays have
    # no entry: SciPy takes one as loaded.
    sys.modules.setdefault("dask", cast(ModuleType, None))


def let_dask_load() -> None:
    """Make Dask importable again."""
    if "dask" in sys.modules and sys.modules["dask"] is None:
        del sys.modules["dask"]


class _Later:
    """Finder of the modules whose loading is deferred to their first use."""

    @staticmethod
    def find_spec(
        fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path, target) if fullname in _LATER else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec
