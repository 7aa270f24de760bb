"""Structures in files, through meshio."""

from __future__ import annotations

from pathlib import Path

from meshes.structure import Structure


def read_structure(path: Path) -> Structure:
    """Placeholder."""
    raise NotImplementedError(path)
