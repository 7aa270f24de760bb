"""Digests of the program's own source: what one source has made is found again by no other."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


@cache
def source_digest(package: str) -> str:
    """Return a digest of every module of one of our packages, and of where each stands.

    Parameters
    ----------
    package : str
        Its name in an import, as ``thermojoint.artefacts``.

    Raises
    ------
    ModuleNotFoundError
        If there is no such package: a digest of nothing would be the same for every source.
    """
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    modules = sorted(root.joinpath(*package.split(".")).rglob("*.py"))
    if not modules:
        raise ModuleNotFoundError(f"no package {package} in {root}", name=package)
    for path in modules:
        digest.update(f"{path.relative_to(root).as_posix()}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()
