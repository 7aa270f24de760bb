"""What every process of the program does before it loads the libraries.

Loading them makes several hundred thousand objects, all of which stay. Python's collector of
garbage would look through them again and again, for a fifth of the time, and once more when the
process ends, for a tenth of that of a short one.

SciPy asks NumPy for all of its parts, among them the translator from Fortran, which takes as long
to load as all else that sparse matrices need; its spatial search brings its rotations along. Both
are loaded when something of them is used: never.

A thread of OpenBLAS, NumPy's library of linear algebra, waits actively for 20 ms for another
product before it sleeps, and so it does when it is started. Beside small products that is most of
its time, and on a busy computer products wait for it; here it sleeps after 20 us.

Where Dask is installed, xarray loads it and its arrays with the first variable, to ask whether it
is one; that takes as long as xarray itself. No command and none of their child processes makes
one, and only a batch on a cluster needs Dask at all. A user's own process keeps it.
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
#: For OpenBLAS: it waits actively for so many clock cycles, as a power of two.
_WAITING = ("OPENBLAS_THREAD_TIMEOUT", "16")
_NAMES = ("dask", "dask.array")
#: Objects made between two collections, and collections of a generation between two of the next.
_COLLECTIONS = (50_000, 20, 20)


def prepare_process() -> None:
    """Collect garbage less often, and let imports of Dask fail: xarray finds no arrays of it then.

    Modules that nothing uses are loaded when something of them is used. Threads of OpenBLAS wait as
    the user's environment says, or little.

    Where xarray is loaded, Dask stays: xarray may have found it already, and would miss it.
    """
    gc.set_threshold(*_COLLECTIONS)
    atexit.register(gc.freeze)
    os.environ.setdefault(*_WAITING)
    if _Later not in sys.meta_path:
        sys.meta_path.insert(0, _Later)
    if "xarray" in sys.modules:
        return
    for name in _NAMES:
        # None in place of a module is Python's own way to say that it cannot be imported.
        sys.modules.setdefault(name, cast(ModuleType, None))


def let_dask_load() -> None:
    """Let Dask be imported after all."""
    for name in _NAMES:
        if name in sys.modules and sys.modules[name] is None:
            del sys.modules[name]


class _Later:
    """Finder of the modules that are loaded when something of them is used."""

    @staticmethod
    def find_spec(
        fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path, target) if fullname in _LATER else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec
