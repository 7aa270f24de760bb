"""The schema in a file's header, in any format."""

from __future__ import annotations

import json
from pathlib import Path

from thermojoint.artefacts.errors import InputError

#: First bytes of HDF5 files, including NetCDF 4.
HDF5 = b"\x89HDF\r\n\x1a\n"


def schema_of(path: Path | str) -> str:
    """Return the schema that a file states: JSON under ``schema``, HDF5 as an attribute.

    In HDF5 it may also be part of the JSON in the attribute ``header``.

    Raises
    ------
    InputError
        The file is missing, of another format or truncated, or states no schema.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give another name")
    with path.open("rb") as file:
        header = _in_hdf5(path) if file.read(len(HDF5)) == HDF5 else _in_json(path)
    stated = header.get("schema") if isinstance(header, dict) else None
    if not isinstance(stated, str):
        raise InputError(f"{path}: does not say what it is; give a file of this program")
    return stated


def states(path: Path | str, schema: str) -> bool:
    """Whether a file states this schema; False for an unreadable file."""
    try:
        return schema_of(path) == schema
    except (InputError, OSError):
        return False


def _in_json(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}: not valid JSON at line {error.lineno}, perhaps truncated; make it again"
        ) from error
    except (UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: neither JSON nor HDF5; give a file of this program") from error


def _in_hdf5(path: Path) -> object:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            attributes = file.attrs
            if "header" in attributes:
                return json.loads(attributes["header"])
            return {"schema": str(attributes["schema"])} if "schema" in attributes else {}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: not readable, perhaps truncated; make it again") from error
