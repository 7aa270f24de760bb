"""The estimator's state as a file: written whole, read back bit for bit, refused by another model.

JSON; Python writes a double with as many digits as bring it back exactly.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path

import numpy as np

from artefacts.errors import InputError
from artefacts.files import write_text
from estimator.fchs.stream import Estimator

SCHEMA = "thermojoint-estimator-state"
SCHEMA_VERSION = 1


def fingerprint(estimator: Estimator) -> str:
    """Return a digest of every coefficient: a state means nothing to any other estimator."""
    digest = hashlib.sha256(repr((estimator.axes, estimator.dt_s)).encode())
    for bank in estimator.banks:
        for array in (bank.poles, bank.drive, bank.gain, bank.double, bank.constant, bank.slope):
            digest.update(repr(array.shape).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def save_state(estimator: Estimator, state: np.ndarray, path: Path) -> None:
    """Write `state` to `path`, whole or not at all.

    Raises
    ------
    InputError
        A value is not finite: a sample before was too large to be a measurement.
    """
    time = float(state[0])
    if math.isinf(time) or not np.isfinite(state[1:]).all():
        raise InputError(f"{path}: the state is not finite; mend the samples that led to it")
    content = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "estimator": fingerprint(estimator),
        "time_s": None if math.isnan(time) else time,
        "values": state[1:].tolist(),
    }
    write_text(path, json.dumps(content, allow_nan=False) + "\n")


def load_state(estimator: Estimator, path: Path) -> np.ndarray:
    """Read a state that `save_state` wrote for the same estimator.

    Raises
    ------
    InputError
        The file is missing, truncated, no state, of another version or of another estimator.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a state saved by the estimator")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: not a readable state, perhaps truncated; start afresh"
        ) from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError(f"{path}: not an estimator state; give a file saved by the estimator")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: state of version {content.get('schema_version')}, expected {SCHEMA_VERSION}; "
            "start afresh"
        )
    if content.get("estimator") != fingerprint(estimator):
        raise InputError(
            f"{path}: state of another model, sampling interval or run length; start afresh, or "
            "use the model it was saved with"
        )
    time, values = content.get("time_s"), content.get("values")
    numbers = values if isinstance(values, list) else []
    usable = len(numbers) == estimator.n_state - 1 and all(
        isinstance(value, float) and math.isfinite(value) for value in numbers
    )
    fresh = time is None
    if not usable or not (fresh or (isinstance(time, float) and math.isfinite(time))):
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    return np.array([math.nan if fresh else time, *numbers])
