"""A learned estimator's state as a file: written whole, read back bit for bit.

JSON; the model stays in its own file, of which the state carries the fingerprint.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from estimator.learned.estimator import Learned
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.json_file import JsonKind, read_json

FILE = JsonKind(
    "thermojoint-learned-state", 1, "state", "saved by a learned estimator", "start afresh"
)


def save_state(estimator: Learned, state: Array, path: Path) -> None:
    """Write a `state` of an estimator to `path`, whole or not at all."""
    fresh = bool(np.isnan(state[0]))
    if not fresh and not np.isfinite(state).all():
        raise InputError(f"{path}: the state is not finite; mend the samples that led to it")
    content = {
        **FILE.header,
        "model": estimator.model.digest,
        "state": None if fresh else state.tolist(),
    }
    write_text(Path(path), json.dumps(content, allow_nan=False) + "\n")


def load_state(estimator: Learned, path: Path) -> Array:
    """Read a state that `save_state` wrote for the same model.

    Raises
    ------
    InputError
        The file is missing, truncated, no such state, of another version or of another model.
    """
    content = read_json(path, FILE)
    if content.get("model") != estimator.model.digest:
        raise InputError(
            f"{path}: state of another model; start afresh, or use the model it was saved with"
        )
    values = content.get("state")
    if values is None:
        return estimator.initial_state()
    whole = isinstance(values, list) and len(values) == estimator.initial_state().size
    if not whole or not all(isinstance(one, float) and np.isfinite(one) for one in values):
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    return np.array(values)
