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
from artefacts.json_file import JsonKind, read_json
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import fingerprint

FILE = JsonKind(
    "thermojoint-joint-aware-state",
    1,
    "state",
    "saved by a joint-aware estimator",
    "start afresh",
)


def save_state(estimator: JointAware, state: Array, path: Path) -> None:
    """Write a `state` of an estimator to `path`, whole or not at all."""
    fresh = math.isnan(float(state[0]))
    content = {
        **FILE.header,
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
    content = read_json(path, FILE)
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
