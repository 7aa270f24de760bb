"""A joint-aware estimator's state as a file: written whole, read back bit for bit.

JSON; the model stays in its own file, of which the state carries the fingerprint.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from artefacts.arrays import Array
from artefacts.errors import InputError
from artefacts.files import write_text
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import fingerprint

SCHEMA = "thermojoint-joint-aware-state"
SCHEMA_VERSION = 1


def save_state(estimator: JointAware, state: Array, path: Path) -> None:
    """Write a `state` of an estimator to `path`, whole or not at all."""
    fresh = math.isnan(float(state[0]))
    content = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "model": fingerprint(estimator.model),
        "fresh": fresh,
        # Before the first sample the first two entries are NaN, which JSON does not know.
        "state": state[2:].tolist() if fresh else state.tolist(),
    }
    write_text(path, json.dumps(content, allow_nan=False) + "\n")


def load_state(estimator: JointAware, path: Path) -> Array:
    """Read a state that `save_state` wrote for the same model.

    Raises
    ------
    InputError
        The file is missing, truncated, no such state, of another version or of another model.
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
        raise InputError(f"{path}: not a joint-aware estimator's state; give one that it saved")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: state of version {content.get('schema_version')}, expected {SCHEMA_VERSION}; "
            "start afresh"
        )
    if content.get("model") != fingerprint(estimator.model):
        raise InputError(
            f"{path}: state of another model; start afresh, or use the model it was saved with"
        )
    values, fresh = content.get("state"), bool(content.get("fresh"))
    size = estimator.initial_state().size - (2 if fresh else 0)
    if (
        not isinstance(values, list)
        or len(values) != size
        or not all(isinstance(one, float) and math.isfinite(one) for one in values)
    ):
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    found = np.array(values)
    return np.concatenate([[np.nan, np.nan], found]) if fresh else found
