"""Is a file a joint-aware model? Without loading what runs one."""

from __future__ import annotations

import json
from pathlib import Path

SCHEMA = "thermojoint-joint-aware-model"
#: What every HDF5 file begins with.
SIGNATURE = b"\x89HDF\r\n\x1a\n"


def is_observer(path: Path) -> bool:
    """Whether a file says that it is a joint-aware model; what cannot be read is none."""
    try:
        with Path(path).open("rb") as file:
            if file.read(len(SIGNATURE)) != SIGNATURE:
                return False
        import h5py

        with h5py.File(path, "r") as content:
            return json.loads(content.attrs["header"]).get("schema") == SCHEMA
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError):
        return False
