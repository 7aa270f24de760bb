"""A joint-aware estimator from its model file, at rest or where a saved state stands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from estimator.interface import READING_NOISE
from estimator.joint_aware.ageing import AgeingJointAware
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer
from estimator.joint_aware.saved_state import load_state
from thermojoint.artefacts.arrays import Array


def started(
    path: Path,
    resume: Path | None = None,
    ageing: Sequence[str] = (),
    touch_noise: float = READING_NOISE,
) -> tuple[JointAware | AgeingJointAware, Array]:
    """Return a joint-aware estimator and the state to go on from.

    Parameters
    ----------
    path : Path
        A joint-aware model.
    resume : Path, optional
        A saved state of an estimator of the same model.
    ageing : sequence of str
        Parameters that are learnt as it runs.
    touch_noise : float
        Standard deviation of a reading of the displacement, m.

    Raises
    ------
    InputError
        A file is unusable, the state belongs to another model, or something cannot age.
    """
    observer = JointAware(read_observer(path), touch_noise)
    estimator = AgeingJointAware(observer, tuple(ageing)) if ageing else observer
    if resume is None:
        return estimator, estimator.initial_state()
    return estimator, load_state(estimator, resume)
