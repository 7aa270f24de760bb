"""File of a march's state, bit-exact and valid for the same machine only.

It contains a fingerprint of everything that the state depends on. Outputs (probes, candidates, the
displacement, snapshots, the title), the heat input and the duration may differ. If only heat is
simulated, there is no displacement, and the state contains joints that have not moved.
"""

from __future__ import annotations

import hashlib
import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fesim.case.identity import file_digest
from fesim.case.schema import Case
from fesim.march.machine import FURTHER, State
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import DAMAGED_ARCHIVE, whole_file

SCHEMA = "thermojoint-march-state"
SCHEMA_VERSION = 12

_RECORDING = {"title", "heat_input", "displacement", "probes", "candidates", "output", "volume"}
_ARRAYS = (
    "temperature",
    "gap",
    "slip",
    "pressure",
    "change",
    "differences",
    "frozen",
    "turning",
    "drive",
    "course",
)


def fingerprint(case: Case) -> str:
    """Return a digest of all that a state depends on; files are included by content."""
    data = case.model_dump(exclude=_RECORDING)
    data["deforms"] = case.displacement is not None
    del data["march"]["duration_min"]
    for source in data["sources"].values():
        del source["heat_input"]
    # Probes are only recorded, except those that the temperature of a scale follows.
    follows = [axis.scale.follows for axis in case.axes.values() if axis.scale is not None]
    data["followed"] = [case.probes[name].model_dump() for name in follows if name is not None]
    # Contact elements are numbered joint by joint, and drives axis by axis, so the order of both
    # matters.
    for section in ("joints", "axes"):
        data[section] = list(data[section].items())
    data["version"] = version("thermojoint")
    # Paths are the only values of a case that JSON does not support.
    text = json.dumps(data, sort_keys=True, default=file_digest)
    return hashlib.sha256(text.encode()).hexdigest()


def save_state(state: State, case: Case, path: Path) -> None:
    """Write the state of a march of `case` to `path` (npz), completely or not at all."""
    arrays: dict[str, Any] = {name: getattr(state, name) for name in _ARRAYS}
    header = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "case": fingerprint(case),
        "index": state.index,
        "model": state.model,
        "parts": state.parts,
    }
    with whole_file(Path(path)) as part, part.open("wb") as file:
        # An open file, since np.savez adds a suffix to names.
        np.savez(file, header=np.array(json.dumps(header)), **arrays)


def load_state(path: Path, case: Case) -> State:
    """Read a state that `save_state` wrote for the same machine.

    Raises
    ------
    InputError
        The file is missing, truncated, not a state, of another version or of another machine.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a state saved by a simulation")
    try:
        with np.load(path, allow_pickle=False) as content:
            header = json.loads(str(content["header"]))
            arrays = {name: content[name] for name in _ARRAYS if name in content}
    except (*DAMAGED_ARCHIVE, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: not a readable state, perhaps truncated; start afresh"
        ) from error
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise InputError(f"{path}: not a march's state; give a file saved by a simulation")
    if header.get("schema_version") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: state of version {header.get('schema_version')}, expected {SCHEMA_VERSION}; "
            "start afresh"
        )
    if header.get("case") != fingerprint(case):
        raise InputError(
            f"{path}: state of another structure, material, joint, ambient, step length or program "
            "version; start afresh, or use the case it was saved with"
        )
    index: Any = header.get("index")
    model: Any = header.get("model")
    parts: Any = header.get("parts")
    count = arrays["pressure"].size if "pressure" in arrays else 0
    shapes: dict[str, tuple[int, ...]] = {
        "gap": (3, count),
        "slip": (2, count),
        "change": (3, count),
        "differences": (FURTHER, 3 * count),
        "frozen": (7, count),
        "turning": (3, count),
    }
    shapes |= {name: (arrays[name].size,) for name in ("drive", "course") if name in arrays}
    usable = (
        arrays.keys() == set(_ARRAYS)
        and isinstance(index, int)
        and isinstance(model, str)
        and isinstance(parts, int)
        and index >= 0
        and parts >= 0
        and all(arrays[name].shape == shape for name, shape in shapes.items())
        and all(array.dtype == np.float64 for array in arrays.values())
        and all(bool(np.isfinite(array).all()) for array in arrays.values())
    )
    if not usable:
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    return State(index=index, model=model, parts=parts, **arrays)
