"""How far an estimate can be used: good, uncertain or bad, by its status."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Reasons that leave a value good: a run longer than the calibration is what a service is for, and
#: a reading of the displacement that was refused changes nothing.
HARMLESS = frozenset({"ok", "beyond-time", "reading-refused"})


class Quality(IntEnum):
    """How far a value can be used; the number is what a history keeps."""

    GOOD = 0
    UNCERTAIN = 1
    BAD = 2

    @property
    def word(self) -> str:
        """``good``, ``uncertain`` or ``bad``."""
        return self.name.lower()


def quality_of(status: str, displacement: Array) -> Quality:
    """Return the quality of an estimate that has just come.

    Parameters
    ----------
    status : str
        In words: ``ok``, or reasons with what they are of: ``sensor-distrusted:T1,T2``.
    displacement : ndarray, shape (axes,)
        m; a value that is not finite is no estimate.
    """
    if not np.isfinite(displacement).all():
        return Quality.BAD
    return Quality.UNCERTAIN if reasons_of(status) - HARMLESS else Quality.GOOD


def reasons_of(status: str) -> set[str]:
    """Return the reasons of a status in words, without the channels they are of."""
    return {word.partition(":")[0] for word in status.split()}
