"""Dask left unloaded in the program's own processes.

Where Dask is installed, xarray loads it and its arrays with the first variable, to ask whether it
is one; that takes as long as xarray itself. No command and none of their child processes makes
one, and only a batch on a cluster needs Dask at all. A user's own process keeps it.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import cast

_NAMES = ("dask", "dask.array")


def leave_dask_unloaded() -> None:
    """Let later imports of Dask fail, which tells xarray that there are no such arrays.

    Where xarray is loaded, Dask stays: xarray may have found it already, and would miss it.
    """
    if "xarray" in sys.modules:
        return
    for name in _NAMES:
        # None in place of a module is Python's own way to say that it cannot be imported.
        sys.modules.setdefault(name, cast(ModuleType, None))


def let_dask_load() -> None:
    """Undo `leave_dask_unloaded`."""
    for name in _NAMES:
        if name in sys.modules and sys.modules[name] is None:
            del sys.modules[name]
