"""A joint-aware estimator's state as a file: written whole, read back bit for bit.

JSON; the model stays in its own file, of which the state carries the fingerprint.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from estimator.joint_aware.ageing import AgeingJointAware
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import fingerprint
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.json_file import JsonKind, read_json

FILE = JsonKind(
    "thermojoint-joint-aware-state",
    2,
    "state",
    "saved by a joint-aware estimator",
    "start afresh",
)


def save_state(estimator: JointAware | AgeingJointAware, state: Array, path: Path) -> None:
    """Write a `state` of an estimator to `path`, whole or not at all."""
    content = {
        **FILE.header,
        "model": fingerprint(estimator.model),
        "ageing": _ageing(estimator),
        # What is not known yet is NaN, which JSON does not have.
        "state": [None if math.isnan(value) else value for value in state.tolist()],
    }
    write_text(path, json.dumps(content, allow_nan=False) + "\n")


def load_state(estimator: JointAware | AgeingJointAware, path: Path) -> Array:
    """Read a state that `save_state` wrote for the same model.

    Raises
    ------
    InputError
        The file is missing, truncated, no such state, of another version, of another model, or
        learnt of other parameters.
    """
    content = read_json(path, FILE)
    if content.get("model") != fingerprint(estimator.model):
        raise InputError(
            f"{path}: state of another model; start afresh, or use the model it was saved with"
        )
    learnt = content.get("ageing")
    if learnt != _ageing(estimator):
        names = ",".join(map(str, learnt)) if isinstance(learnt, list) else ""
        raise InputError(
            f"{path}: saved with {f'--ageing {names}' if names else 'no --ageing'}; give the same"
        )
    values = content.get("state")
    if (
        not isinstance(values, list)
        or len(values) != estimator.initial_state().size
        or not all(one is None or (isinstance(one, float) and math.isfinite(one)) for one in values)
    ):
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    return np.array([math.nan if one is None else one for one in values])


def _ageing(estimator: JointAware | AgeingJointAware) -> list[str]:
    return list(estimator.ageing) if isinstance(estimator, AgeingJointAware) else []
