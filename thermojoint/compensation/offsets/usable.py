"""Rules for usable estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.interface import Status
from estimator.quality import LOST, reasons_of
from thermojoint.artefacts.arrays import Array

#: Reasons that make an estimate unusable where the settings name none: what was never calibrated,
#: and a start of which little is known.
UNUSABLE = ("beyond-temperature", "unsettled")


@dataclass(frozen=True)
class Trust:
    """Conditions for using an estimate.

    Attributes
    ----------
    unusable : tuple of str
        Reasons of a status (`estimator.interface.Status`) that make an estimate unusable.
    widest_band : float
        Half a band of 95 % that is wider makes it unusable, m; infinite if the band does not count.
    oldest : float
        An estimate that is older is unusable, s.
    """

    unusable: tuple[str, ...]
    widest_band: float
    oldest: float


def usable(trust: Trust, age: float, band: Array, status: str) -> bool:
    """Say whether an estimate may move an axis; one of bad quality never does.

    Parameters
    ----------
    trust : Trust
    age : float
        s.
    band : ndarray, shape (axes,)
        Half its bands, m; NaN for an estimator that knows none.
    status : str
        In words: ``ok``, or reasons with what they are of: ``sensor-distrusted:T1,T2``.
    """
    return (
        age <= trust.oldest
        and not (reasons_of(status) & {LOST, *trust.unusable})
        and not bool(np.any(band > trust.widest_band))
    )


def known_reasons() -> Sequence[str]:
    """Return every reason that a status can have."""
    return (~Status(0)).reasons
