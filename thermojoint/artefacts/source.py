"""Digests of the program's own source, so that caches are valid for one version only."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


@cache
def source_digest(package: str) -> str:
    """Return a digest of the paths and contents of all modules of one of our packages.

    Raises
    ------
    ModuleNotFoundError
        There is no such package: an empty digest would be valid for every source.
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
