"""Rules for usable estimates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.interface import Status
from estimator.quality import LOST, reasons_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MICRO

#: Default reasons that make an estimate unusable: temperatures beyond the calibration, and an
#: unknown start.
UNUSABLE = ("beyond-temperature", "unsettled")


@dataclass(frozen=True)
class Trust:
    """Conditions for using an estimate."""

    #: Reasons of a status (`estimator.interface.Status`) that make an estimate unusable.
    unusable: tuple[str, ...]
    #: Largest usable half-width of the 95 % band, m; infinite to ignore the band.
    widest_band: float
    #: Largest usable age of an estimate, s.
    oldest: float


def usable(trust: Trust, age: float, band: Array, status: str) -> bool:
    """Whether an estimate may move an axis; an estimate of bad quality never may.

    Parameters
    ----------
    trust : Trust
    age : float
        Age of the estimate, s.
    band : ndarray, shape (axes of the control,)
        Half-widths of the bands of what they follow (`output.band_along`), m; NaN if unknown.
    status : str
        ``ok``, or reasons with the channels concerned: ``sensor-distrusted:T1,T2``.
    """
    return age <= trust.oldest and not reasons_against(trust, band, status)


def reasons_against(trust: Trust, band: Array, status: str) -> list[str]:
    """Return why a new estimate must not move an axis: reasons of its status, ``widest_band_um``.

    Parameters
    ----------
    trust, band, status
        As for `usable`.
    """
    reasons = sorted(reasons_of(status) & {LOST, *trust.unusable})
    return [*reasons, "widest_band_um"] if bool(np.any(band > trust.widest_band)) else reasons


def limit_without_band(trust: Trust, bands: Array) -> str:
    """Return a warning if there is a limit on the band but all bands are unknown; else empty.

    Parameters
    ----------
    trust : Trust
    bands : ndarray
        Half-widths of what is followed in some estimates, m.
    """
    if not math.isfinite(trust.widest_band) or not np.isnan(bands).all():
        return ""
    return (
        f"widest_band_um {trust.widest_band / MICRO:g} makes no estimate unusable: there is no "
        "band; leave it out, and list under unusable what does"
    )


def known_reasons() -> Sequence[str]:
    """Return every reason that a status can have."""
    return (~Status(0)).reasons
