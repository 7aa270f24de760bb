"""State of an estimator as a file or as bytes: versioned, fingerprinted, with a checksum.

Both are read back bit for bit on any processor: JSON stores every double with enough digits. The
fingerprint is that of the model: a state is valid for its own model only.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.json_file import JsonKind, read_json, write_json

FILE = JsonKind(
    "thermojoint-estimator-state",
    3,
    "state",
    "saved by 'thermojoint estimate --save-state'",
    "start afresh",
)
#: Prefix of the bytes of a state; the digit is the version.
_MAGIC = b"TJS2"
_DIGEST = hashlib.sha256().digest_size


class SavedState(NamedTuple):
    """A state and the model that it belongs to."""

    #: Kind of the estimator, from the model file.
    schema: str
    #: Fingerprint of the model.
    fingerprint: str
    #: Additional JSON data of the kind; None for nothing.
    carried: Any
    #: The state.
    values: Array
    #: Ambient at which the machine was cold (`estimator.kind.Cold`), K; NaN if it is not used.
    cold: float = math.nan


def write_state(saved: SavedState, path: Path | str) -> None:
    """Write a state as JSON, whole or not at all.

    Raises
    ------
    InputError
        A value is infinite: an earlier sample was too large to be a measurement.
    """
    if np.isinf(saved.values).any():
        raise InputError(f"{path}: the state is not finite; correct the samples that led to it")
    body = {
        "model_schema": saved.schema,
        "fingerprint": saved.fingerprint,
        "carried": saved.carried,
        # Unknown values are NaN, which JSON lacks.
        "state": [None if math.isnan(value) else value for value in saved.values.tolist()],
    } | ({} if math.isnan(saved.cold) else {"cold_K": saved.cold})
    content = FILE.header | body | {"checksum": _checksum(body)}
    write_json(path, content, indent=None)


def read_state(path: Path | str) -> SavedState:
    """Read a state written by `write_state`.

    Raises
    ------
    InputError
        The file is missing, truncated, corrupted, no state, or of another version.
    """
    content = read_json(path, FILE)
    stated = content.pop("checksum", None)
    if stated != _checksum(content):
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    try:
        values = [math.nan if value is None else float(value) for value in content["state"]]
        return SavedState(
            str(content["model_schema"]),
            str(content["fingerprint"]),
            content["carried"],
            np.array(values),
            float(content.get("cold_K", math.nan)),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: the state's values are damaged; start afresh") from error


def as_bytes(fingerprint: str, values: Array) -> bytes:
    """Return a state as bytes: prefix, digests of model and numbers, numbers."""
    numbers = np.asarray(values).astype("<f8").tobytes()
    return _MAGIC + _digest(fingerprint.encode()) + _digest(numbers) + numbers


def from_bytes(data: bytes, fingerprint: str, where: str) -> Array:
    """Return the state from the bytes of `as_bytes`.

    Raises
    ------
    InputError
        The bytes are damaged, of another version, or of another model.
    """
    model, numbers = len(_MAGIC), len(_MAGIC) + _DIGEST
    own, stated, content = (
        data[model:numbers],
        data[numbers : numbers + _DIGEST],
        data[numbers + _DIGEST :],
    )
    if not data.startswith(_MAGIC) or stated != _digest(content) or len(content) % 8:
        raise InputError(f"{where}: the stored state is damaged; give another folder")
    if own != _digest(fingerprint.encode()):
        raise InputError(f"{where}: the stored state belongs to another model; give its folder")
    return np.frombuffer(content, dtype="<f8").copy()


def completed(values: Array, initial: Array) -> Array:
    """Return a state; one of an earlier version gets the initial values of its missing parts.

    Parts that a version adds to the state of a kind come at its end.
    """
    return np.concatenate((values, initial[values.size :]))


def _checksum(body: dict[str, Any]) -> str:
    return _digest(json.dumps(body, sort_keys=True).encode()).hex()


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()
