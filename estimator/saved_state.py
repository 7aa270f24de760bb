"""An estimator's state as a file: written whole, read back bit for bit, on any processor.

The file holds the assembled estimator beside its state, so that a run goes on with the very
coefficients it began with. JSON; Python writes a double with as many digits as bring it back
exactly.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from estimator.fchs.estimator import Fchs
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.json_file import JsonKind, read_json
from thermojoint.models.assembly_file import as_content, from_content

FILE = JsonKind("thermojoint-estimator-state", 2, "state", "saved by the estimator", "start afresh")


def save_state(estimator: Fchs, state: Array, path: Path | str) -> None:
    """Write an estimator and its state, whole or not at all.

    Parameters
    ----------
    estimator : Fchs
        With all that was fitted.
    state : ndarray
        What its last sample returned, or its initial state.
    path : Path or str
        JSON to write.

    Raises
    ------
    InputError
        A value is not finite: a sample before was too large to be a measurement.
    """
    fresh = math.isnan(float(state[0]))
    if not fresh and not np.isfinite(state).all():
        raise InputError(f"{path}: the state is not finite; mend the samples that led to it")
    content = {
        **FILE.header,
        "estimator": as_content(estimator.assembly),
        "state": None if fresh else state.tolist(),
    }
    write_text(Path(path), json.dumps(content, allow_nan=False) + "\n")


def load_state(path: Path | str) -> tuple[Fchs, Array]:
    """Read an estimator and its state, saved here or elsewhere.

    Parameters
    ----------
    path : Path or str
        JSON written by `save_state`.

    Raises
    ------
    InputError
        The file is missing, truncated, no state, of another version, or was changed.
    """
    content = read_json(path, FILE)
    estimator = Fchs(from_content(content.get("estimator"), f"{path}: estimator"))
    values = content.get("state")
    if values is None:
        return estimator, estimator.initial_state()
    usable = isinstance(values, list) and len(values) == estimator.initial_state().size
    if not usable or not all(isinstance(one, float) and math.isfinite(one) for one in values):
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    return estimator, np.array(values)
