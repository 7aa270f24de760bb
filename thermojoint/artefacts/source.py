"""Digests of the program's own source: what one source has made is found again by no other."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


@cache
def source_digest(package: str) -> str:
    """Return a digest of every module of a package at the top, and of where each stands."""
    found = hashlib.sha256()
    root = Path(__file__).parents[2]
    for path in sorted((root / package).rglob("*.py")):
        found.update(f"{path.relative_to(root).as_posix()}\n".encode())
        found.update(path.read_bytes())
    return found.hexdigest()
