"""Settings of a compensation output from a TOML file, with units in the names of the keys."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.settings.read import settings_from
from thermojoint.artefacts.settings.section import NotNegative, Positive, Section, Texts
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.output import OutputSettings
from thermojoint.compensation.offsets.usable import UNUSABLE, Trust, known_reasons

#: More steps than this in the range of an axis or a heater indicate a wrong unit.
MOST_STEPS = 1e9


class AxisSection(Section):
    """``[axes.NAME]``: the axis of the estimate that an axis of the control follows; the sign."""

    follows: str
    sign: Literal[-1, 1] = -1


class SettingsFile(Section):
    """The whole file."""

    cycle_s: Positive = 1.0
    resolution_um: Positive = 0.1
    rate_um_s: Positive = 1.0
    dead_band_um: NotNegative = 0.0
    filter_s: NotNegative = 0.0
    largest_um: Positive = 500.0
    oldest_s: Positive = 30.0
    freeze_s: NotNegative = 60.0
    decay_s: Positive = 600.0
    recover_s: NotNegative = 10.0
    unusable: Texts = UNUSABLE
    widest_band_um: Positive | None = None
    axes: Annotated[dict[str, AxisSection], Field(min_length=1)]


@dataclass(frozen=True)
class Settings:
    """A compensation output.

    Attributes
    ----------
    output : OutputSettings
        Rules for the offsets.
    trust : Trust
        Conditions for using an estimate.
    cycle : float
        Cycle time of the control, s.
    """

    output: OutputSettings
    trust: Trust
    cycle: float


def read_settings(path: Path | str) -> Settings:
    """Read the settings of a compensation output.

    Parameters
    ----------
    path : Path or str
        TOML.

    Raises
    ------
    InputError
        The file is missing or not TOML, a key is unknown or missing, or a value is out of range.
    """
    return settings_from_data(toml.parse(toml.read_text(Path(path), "settings"), str(path)), path)


def settings_from_data(data: dict[str, Any], where: Path | str) -> Settings:
    """Return settings given as nested dictionaries; raises as `read_settings`."""
    given = settings_from(SettingsFile, data, str(where), Path())
    known = known_reasons()
    for reason in given.unusable:
        if reason not in known:
            raise unknown_name("reason", reason, known, f"{where}: unusable")
    if not 1.0 <= given.largest_um / given.resolution_um <= MOST_STEPS:
        raise InputError(
            f"{where}: largest_um {given.largest_um:g} is not 1 to {MOST_STEPS:.0e} steps of "
            f"resolution_um {given.resolution_um:g}; change one of them"
        )
    widest = given.widest_band_um
    return Settings(
        OutputSettings(
            names=tuple(given.axes),
            estimated=tuple(axis.follows for axis in given.axes.values()),
            signs=tuple(axis.sign for axis in given.axes.values()),
            resolution=MICRO * given.resolution_um,
            rate=MICRO * given.rate_um_s,
            dead_band=MICRO * given.dead_band_um,
            filter_time=given.filter_s,
            largest=MICRO * given.largest_um,
            freeze_time=given.freeze_s,
            decay_time=given.decay_s,
            recover_time=given.recover_s,
            longest_cycle=max(given.oldest_s, given.cycle_s),
        ),
        Trust(given.unusable, math.inf if widest is None else MICRO * widest, given.oldest_s),
        given.cycle_s,
    )
