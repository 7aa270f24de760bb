"""Folder of matplotlib's font cache for users without a writable home."""

from __future__ import annotations

import os
from pathlib import Path

#: Environment variable to its default below the home folder.
_FOLDERS = {"XDG_CONFIG_HOME": ".config", "XDG_CACHE_HOME": ".cache"}


def find_place() -> None:
    """Give matplotlib a cache folder if it has none; else it would search for fonts in every run.

    Call this before matplotlib is imported; child processes inherit the folder.
    """
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 - it raises where nobody knows the home
    usual = [Path(os.environ.get(name) or home / below) for name, below in _FOLDERS.items()]
    if "MPLCONFIGDIR" in os.environ or all(_can_be_made(place / "matplotlib") for place in usual):
        return
    # Here, not above: importing it takes longer than the check.
    from thermojoint.artefacts.own_folder import own_folder

    if folder := own_folder("matplotlib"):
        os.environ["MPLCONFIGDIR"] = str(folder)


def _can_be_made(folder: Path) -> bool:
    nearest = next((place for place in (folder, *folder.parents) if place.exists()), None)
    return (
        folder.is_absolute()
        and nearest is not None
        and nearest.is_dir()
        and os.access(nearest, os.W_OK)
    )
