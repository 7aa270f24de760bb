"""Settings of a compensation output from a TOML file, with units in the names of the keys."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from estimator.lines import Stroke, lever, name_at
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.settings.read import settings_from
from thermojoint.artefacts.settings.section import Finite, NotNegative, Positive, Section, Texts
from thermojoint.artefacts.units import MICRO, MILLI
from thermojoint.compensation.offsets.output import AxisSlope, Limits, OutputSettings
from thermojoint.compensation.offsets.usable import UNUSABLE, Trust, known_reasons

#: A range of an axis or a heater with more steps than this indicates a wrong unit.
MOST_STEPS = 1e9


class SlopeSection(Section):
    """``[axes.NAME.slope]``: the axis takes K0 and a slope; the defaults depend on the stroke."""

    resolution_um_per_m: Positive = 1.0
    rate_um_per_m_s: Positive | None = None
    dead_band_um_per_m: NotNegative | None = None
    largest_um_per_m: Positive | None = None
    reference_mm: Finite | None = None


class AxisSection(Section):
    """``[axes.NAME]``: the axis of the estimate that an axis of the control follows; the sign.

    With `at_mm`, NAME is a point in a table of the control: the offset at that axis position.
    """

    follows: str
    at_mm: Finite | None = None
    sign: Literal[-1, 1] = -1
    slope: SlopeSection | None = None

    @field_validator("sign", mode="before")
    @classmethod
    def _number(cls, sign: Any) -> Any:  # noqa: ANN401 - what the file contains
        # It equals 1, and would be the sign with the displacement.
        if sign is True:
            raise ValueError("input should be -1 or 1")
        return sign

    @model_validator(mode="after")
    def _one_position(self) -> Self:
        if self.at_mm is not None and self.slope is not None:
            raise ValueError("at_mm: a line is about every position; leave at_mm or slope out")
        return self

    @property
    def estimated(self) -> str:
        """Name of the followed displacement in the estimate."""
        return self.follows if self.at_mm is None else name_at(self.follows, self.at_mm)


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
    slopes : mapping
        By axis: requested settings of its slope. The resulting rules are in `output` once the
        strokes are known (`with_slopes`).
    """

    output: OutputSettings
    trust: Trust
    cycle: float
    slopes: Mapping[str, SlopeSection] = field(default_factory=dict)


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
    if not _countable(MICRO * given.largest_um, MICRO * given.resolution_um):
        raise InputError(
            f"{where}: largest_um {given.largest_um:g} is not 1 to {MOST_STEPS:.0e} steps of "
            f"resolution_um {given.resolution_um:g}; change one of them"
        )
    widest = given.widest_band_um
    return Settings(
        OutputSettings(
            names=tuple(given.axes),
            estimated=tuple(axis.estimated for axis in given.axes.values()),
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
        {name: axis.slope for name, axis in given.axes.items() if axis.slope is not None},
    )


def check_axes(settings: Settings, axes: Collection[str], where: str) -> None:
    """Raise InputError if a displacement that is followed is not one of an estimate's `axes`.

    `where` is the name of the settings.
    """
    for name in settings.output.estimated:
        if name not in axes:
            raise unknown_name("axis", name, axes, f"{where}: axes: the estimate has")


def with_slopes(settings: Settings, strokes: Mapping[str, Stroke], where: str) -> Settings:
    """Return settings with the rules for the slopes that they request.

    Offset and slope of an axis share its rate, its largest offset and its dead band. With L the
    distance of the far end of the stroke from P0, the offset's limit is the whole limit less L
    times the slope's limit. By the triangle inequality the correction, offset + slope (P - P0),
    keeps the whole limit at every position of the stroke.

    Parameters
    ----------
    settings : Settings
    strokes : mapping of str to Stroke
        Strokes of the displacements that are known along an axis.
    where : str
        Name of the settings, for messages.

    Raises
    ------
    InputError
        A displacement is not known along an axis, or nothing is left for the offset.
    """
    output = settings.output
    own = []
    for axis, section in settings.slopes.items():
        at, follows = f"{where}: axes.{axis}.slope", output.estimated[output.names.index(axis)]
        if follows not in strokes:
            raise InputError(
                f"{at}: {follows} is estimated at one place; leave the slope out, or learn it "
                f"along an axis: --displacement {follows}_um@y_pos_mm"
            )
        own.append(_axis_slope(axis, section, output.limits, strokes[follows], at))
    return replace(settings, output=replace(output, slopes=tuple(own)))


def _axis_slope(
    axis: str, section: SlopeSection, whole: Limits, stroke: Stroke, at: str
) -> AxisSlope:
    reference = stroke.reference
    if section.reference_mm is not None:
        reference = MILLI * section.reference_mm
    far = lever(reference, stroke.low, stroke.high)
    if far <= 0.0:
        raise InputError(f"{at}: the stroke is one position; leave the slope out")
    slope = Limits(
        MICRO * section.resolution_um_per_m,
        _shared(section.rate_um_per_m_s, whole.rate, far),
        _shared(section.dead_band_um_per_m, whole.dead_band, far),
        _shared(section.largest_um_per_m, whole.largest, far),
    )
    offset = Limits(
        whole.resolution,
        whole.rate - far * slope.rate,
        max(whole.dead_band - far * slope.dead_band, 0.0),
        whole.largest - far * slope.largest,
    )
    at_end = f"{1e3 * far:g} mm from P0"
    if offset.rate <= 0.0:
        raise InputError(
            f"{at}.rate_um_per_m_s {slope.rate / MICRO:g}: {at_end} it is all of rate_um_s "
            f"{whole.rate / MICRO:g}, and K0 would not move; make it smaller"
        )
    if offset.most_steps < 1:
        raise InputError(
            f"{at}.largest_um_per_m {slope.largest / MICRO:g}: {at_end} it is all of largest_um "
            f"{whole.largest / MICRO:g}; make it smaller"
        )
    if not _countable(slope.largest, slope.resolution):
        raise InputError(
            f"{at}.largest_um_per_m {slope.largest / MICRO:g} is not 1 to {MOST_STEPS:.0e} steps "
            f"of resolution_um_per_m {slope.resolution / MICRO:g}; change one of them"
        )
    return AxisSlope(axis, reference, stroke.low, stroke.high, offset, slope)


def _countable(largest: float, resolution: float) -> bool:
    """Whether a range in SI has at least one step of its resolution, and not too many."""
    # The smallest numbers of a file are zero in SI.
    return 0.0 < resolution <= largest <= MOST_STEPS * resolution


def _shared(given: float | None, whole: float, lever: float) -> float:
    """Return a limit of a slope (SI) given in millionths; by default half of the whole limit."""
    return 0.5 * whole / lever if given is None else MICRO * given
