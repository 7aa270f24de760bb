"""A joint-aware estimator from its model file, at rest or where a saved state stands."""

from __future__ import annotations

from pathlib import Path

from artefacts.arrays import Array
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer
from estimator.joint_aware.saved_state import load_state


def started(path: Path, resume: Path | None = None) -> tuple[JointAware, Array]:
    """Return a joint-aware estimator and the state to go on from.

    Parameters
    ----------
    path : Path
        A joint-aware model.
    resume : Path, optional
        A saved state of an estimator of the same model.

    Raises
    ------
    InputError
        A file is unusable, or the state belongs to another model.
    """
    estimator = JointAware(read_observer(path))
    if resume is None:
        return estimator, estimator.initial_state()
    return estimator, load_state(estimator, resume)
