"""Detection of user files that shadow a package of this distribution."""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder

#: Other top-level packages of this distribution, with names that a user's script may have too.
BESIDE = ("calibrate", "estimator", "fesim", "meshes")


def check_not_hidden() -> None:
    """Check that an import of the other packages finds ours.

    Raises
    ------
    ImportError
        Another file or folder of that name comes first on the path.
    """
    for name in BESIDE:
        if hiding := _hiding(name):
            raise ImportError(f"{hiding} hides the package {name!r} of thermojoint; rename it")


def _hiding(name: str) -> str:
    """Path of the module that an import of `name` finds; empty if it is ours."""
    if (loaded := sys.modules.get(name)) is not None:
        place = getattr(loaded, "__file__", None)
    elif (spec := PathFinder.find_spec(name)) is not None:
        # A folder without `__init__.py` has search locations but no origin.
        place = spec.origin or next(iter(spec.submodule_search_locations or ()), None)
    else:  # an editable installation is found after the path
        return ""
    if place is None or place == f"{__file__.rpartition('thermojoint')[0]}{name}/__init__.py":
        return ""
    # Here, not above: importing it takes most of the time of this check.
    from pathlib import Path

    ours = Path(__file__).parents[1] / name / "__init__.py"
    return "" if Path(place).resolve() == ours.resolve() else str(place)
