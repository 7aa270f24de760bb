"""Quality of an estimate: good, uncertain or bad, from its status."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Reasons that leave a value good: a service is meant to run longer than the calibration, and a
#: refused displacement reading changes nothing.
HARMLESS = frozenset({"ok", "beyond-time", "reading-refused"})
#: Reason that makes a value bad.
LOST = "readings-lost"


class Quality(IntEnum):
    """Quality of a value; the number is stored in a history."""

    GOOD = 0
    UNCERTAIN = 1
    BAD = 2

    @property
    def word(self) -> str:
        """``good``, ``uncertain`` or ``bad``."""
        return self.name.lower()


def quality_of(status: str, displacement: Array) -> Quality:
    """Return the quality of a new estimate.

    Parameters
    ----------
    status : str
        In words: ``ok``, or reasons with the channels concerned: ``sensor-distrusted:T1,T2``.
    displacement : ndarray, shape (axes,)
        m; a value that is not finite is bad.
    """
    reasons = reasons_of(status)
    if LOST in reasons or not np.isfinite(displacement).all():
        return Quality.BAD
    return Quality.UNCERTAIN if reasons - HARMLESS else Quality.GOOD


def reasons_of(status: str) -> set[str]:
    """Return the reasons of a status in words, without the channels."""
    return {word.partition(":")[0] for word in status.split()}
