"""A learned estimator from its model file, at the start or where a saved state stands."""

from __future__ import annotations

from pathlib import Path

from estimator.interface import READING_NOISE
from estimator.learned.estimator import Learned
from estimator.learned.saved_state import load_state
from thermojoint.artefacts.arrays import Array
from thermojoint.models.learned import read_learned


def started(
    path: Path, resume: Path | None = None, reading_noise: float = READING_NOISE
) -> tuple[Learned, Array]:
    """Return a learned estimator and the state to go on from.

    Parameters
    ----------
    path : Path
        A learned model.
    resume : Path, optional
        A saved state of an estimator of the same model.
    reading_noise : float
        Standard deviation of a displacement that is read, m.

    Raises
    ------
    InputError
        A file is unusable, or the state belongs to another model.
    """
    estimator = Learned(read_learned(path), reading_noise)
    if resume is None:
        return estimator, estimator.initial_state()
    return estimator, load_state(estimator, resume)
