"""Axis offsets in one control cycle, from an estimate; for axes with a slope also the slopes.

The target is sign times the estimated displacement after a first-order low-pass, a dead band and a
limit. The offset approaches it with a limited rate in whole steps of the control's resolution.
Without a usable estimate the offsets freeze, and later decay to zero; they follow again once
estimates have been usable for some time, so that an intermittent status does not move an axis back
and forth.

An axis with a slope is corrected by offset + slope (position - reference). Offset and slope pass
these stages with limits of their own, which keep the correction within the rate and the largest
offset at every position of the stroke, even while the two move at different times.

A state outlives its settings (`content_of`, `restored`): it is stored in metres by axis name, so
after a change of the resolution, the limits or the axes each axis continues from the offset that
the control received last. A new reference changes the offset, but not the line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.lines import Lines, axis_of, lever
from thermojoint.artefacts.arrays import Array

#: Further numbers stored with each offset and slope.
_KEPT = ("frozen", "filtered", "wanted")
#: More steps than any value has; a rate that allows more would exceed the range of integers.
_ALL_STEPS = 1e15


@dataclass(frozen=True)
class Limits:
    """Limits of an offset (m), or of a slope (m/m)."""

    #: Step size.
    resolution: float
    #: Largest rate, 1/s.
    rate: float
    #: The target changes only if the estimate has changed by more than this.
    dead_band: float
    #: Largest value of either sign.
    largest: float

    @property
    def most_steps(self) -> int:
        """Largest value in whole steps."""
        # Rounding errors must not reduce a limit of a whole number of steps.
        return math.floor(self.largest / self.resolution + 1e-9)


@dataclass(frozen=True)
class AxisSlope:
    """A slope that an axis of the control takes."""

    #: Axis of the control.
    axis: str
    #: Position at which the correction is the offset, and the ends of the stroke, m.
    reference: float
    low: float
    high: float
    #: Limits for this axis, in place of the limits for axes without a slope.
    offset: Limits
    slope: Limits

    @property
    def lever(self) -> float:
        """Largest distance from the reference on the stroke, m."""
        return lever(self.reference, self.low, self.high)


class Channels(NamedTuple):
    """Limits of all values that a control receives: the offsets, then the slopes."""

    #: Shape (channels,): index of the travel that each channel uses.
    shares: NDArray[np.int64]
    #: Shape (channels,): step sizes (m, m/m), dead bands, and largest numbers of steps.
    resolution: Array
    dead_band: Array
    most: NDArray[np.int64]
    #: Shape (channels,): correction at the far end of the stroke per value: 1 for offsets, the
    #: lever (m) for slopes.
    levers: Array
    #: Shape (travels,): the offsets of all axes without a slope share a travel.
    rates: Array
    steps: Array


@dataclass(frozen=True)
class OutputSettings:
    """Settings of the output stage."""

    #: Axes of the control.
    names: tuple[str, ...]
    #: Axis of the estimate that each axis follows.
    estimated: tuple[str, ...]
    #: 1 or -1: offset per estimated displacement.
    signs: tuple[int, ...]
    #: Step of an offset, m.
    resolution: float
    #: Largest rate of an offset, m/s.
    rate: float
    #: The target changes only if the estimate has changed by more than this, m.
    dead_band: float
    #: Time constant of the low-pass, s; 0 for none.
    filter_time: float
    #: Largest offset of either sign, m.
    largest: float
    #: Time for which offsets are held without a usable estimate, s.
    freeze_time: float
    #: Time constant of their decay to zero after that, s.
    decay_time: float
    #: Time for which estimates must be usable again before offsets follow them, s.
    recover_time: float
    #: Upper limit of a cycle's duration in the rate limit, s, so that offsets do not jump after a
    #: pause.
    longest_cycle: float
    #: Slopes of the axes that have one, in the order of the axes.
    slopes: tuple[AxisSlope, ...] = ()

    @property
    def limits(self) -> Limits:
        """Limits of the offsets of axes without a slope."""
        return Limits(self.resolution, self.rate, self.dead_band, self.largest)

    @cached_property
    def along(self) -> tuple[int, ...]:
        """Indices of the axes with a slope."""
        return tuple(self.names.index(one.axis) for one in self.slopes)

    @cached_property
    def channels(self) -> Channels:
        """Limits of the offsets and of the slopes."""
        travels = [self.limits, *(one for own in self.slopes for one in (own.offset, own.slope))]
        shares = np.zeros(len(self.names) + len(self.slopes), dtype=np.int64)
        shares[list(self.along)] = 1 + 2 * np.arange(len(self.slopes))
        shares[len(self.names) :] = 2 + 2 * np.arange(len(self.slopes))
        own = [travels[share] for share in shares.tolist()]
        return Channels(
            shares,
            np.array([one.resolution for one in own]),
            np.array([one.dead_band for one in own]),
            np.array([one.most_steps for one in own]),
            np.array([1.0] * len(self.names) + [one.lever for one in self.slopes]),
            np.array([one.rate for one in travels]),
            np.array([one.resolution for one in travels]),
        )


class Mode(Enum):
    """Mode of the offsets."""

    WAIT = "wait"
    FOLLOW = "follow"
    FREEZE = "freeze"
    DECAY = "decay"


class OutputState(NamedTuple):
    """State carried from one cycle to the next."""

    #: Time of the last cycle, s; NaN before the first.
    time: float
    #: Shape (channels,): the offsets, then the slopes, in steps of their resolution.
    steps: NDArray[np.int64]
    #: Shape (channels,): target after the low-pass, and after the dead band, m and m/m; NaN before
    #: the first estimate.
    filtered: Array
    wanted: Array
    #: Shape (travels,): unused travel carried over from previous cycles, m and m/m; at most one
    #: step.
    credit: Array
    #: Time at which the offsets stopped following, s; NaN while they follow.
    unusable_since: float
    #: Shape (channels,): the offsets at that time.
    frozen: NDArray[np.int64]
    #: Time at which estimates became usable again, s; NaN if they have not.
    usable_since: float

    @property
    def used(self) -> bool:
        """Whether any estimate has moved the offsets yet."""
        return bool(self.frozen.any() or self.steps.any() or np.isfinite(self.wanted).any())


def at_zero(settings: OutputSettings) -> OutputState:
    """Return the state before the first cycle."""
    count = len(settings.channels.shares)
    unseen, none = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    rested = np.zeros(len(settings.channels.rates))
    return OutputState(math.nan, none, unseen, unseen, rested, math.nan, none, math.nan)


def offsets_of(settings: OutputSettings, state: OutputState) -> Array:
    """Return the offsets of a state, m, shape (axes,)."""
    return _values(settings, state.steps)[: len(settings.names)]


def slopes_of(settings: OutputSettings, state: OutputState) -> Array:
    """Return the slopes of a state, m/m, shape (slopes,)."""
    return _values(settings, state.steps)[len(settings.names) :]


def corrections_of(settings: OutputSettings, state: OutputState) -> Array:
    """Return the offsets and the corrections by slopes at the far end, m, shape (channels,)."""
    return settings.channels.levers * _values(settings, state.steps)


def _values(settings: OutputSettings, steps: NDArray[np.int64]) -> Array:
    return np.asarray(settings.channels.resolution * steps)


def followed(
    settings: OutputSettings,
    axes: Sequence[str],
    displacement: Array,
    lines: Lines | None = None,
    places: Mapping[str, float] = MappingProxyType({}),
) -> Array:
    """Return the targets of the offsets (m) and of the slopes (m/m), shape (channels,).

    Parameters
    ----------
    settings : OutputSettings
    axes : sequence of str
        Axes of the estimate; they and `places` include all names in `settings.estimated`.
    displacement : ndarray, shape (axes,)
        Estimated displacement, m.
    lines : Lines, optional
        Estimated lines; without them slopes have no target (NaN).
    places : mapping of str to float, optional
        Estimated displacements at positions by name (`estimator.lines.name_at`), m.
    """
    names, signs = (*axes, *places), np.array(settings.signs)
    at = [names.index(name) for name in settings.estimated]
    targets = np.asarray(signs * np.append(displacement, [*places.values()])[at])
    if not settings.slopes:
        return targets
    along = list(settings.along)
    slopes = np.full(len(along), np.nan)
    if lines is not None:
        own = [at[k] for k in along]
        slopes = signs[along] * lines.slope[own]
        references = np.array([one.reference for one in settings.slopes])
        targets[along] += slopes * (references - lines.reference[own])
    return np.concatenate((targets, slopes))


def band_along(
    settings: OutputSettings, axes: Sequence[str], band: Array, lines: Lines | None
) -> Array:
    """Return the bands of what the axes of the control follow, m, shape (axes of the control,).

    That of an axis with a slope holds at every position of the stroke; it is not wider than the sum
    of the bands of offset and slope. Displacements that no axis follows do not count.

    Parameters
    ----------
    settings : OutputSettings
    axes : sequence of str
        Axes of the estimate.
    band : ndarray, shape (axes,)
        Half-widths of its bands, m.
    lines : Lines or None
        Estimated lines.
    """
    at = [list(axes).index(axis_of(axes, name)) for name in settings.estimated]
    widest = band[at]
    if lines is not None:
        for k, own in zip(settings.along, settings.slopes, strict=True):
            reach = lever(lines.reference[at[k]], own.low, own.high)
            widest[k] += reach * lines.band[at[k]]
    return widest


def cycle(
    settings: OutputSettings, state: OutputState, time: float, target: Array | None
) -> OutputState:
    """Return the state after one cycle.

    Parameters
    ----------
    settings : OutputSettings
    state : OutputState
        State after the previous cycle; not modified.
    time : float
        Time, s; later than the previous cycle.
    target : ndarray, shape (channels,), or None
        Targets of offsets and slopes (`followed`); None or non-finite values without a usable
        estimate.
    """
    channels = settings.channels
    passed = 0.0 if math.isnan(state.time) else time - state.time
    usable = target is not None and bool(np.isfinite(target).all())
    usable_since = state.usable_since
    if usable and math.isnan(usable_since):
        usable_since = time
    frozen = state.frozen
    if target is not None and usable and _recovered(settings, state, time - usable_since):
        since = usable_since = math.nan
        filtered = _filtered(settings, state.filtered, target, passed)
        wanted = _beyond_dead_band(settings, state.wanted, filtered)
        goal = np.rint(wanted / channels.resolution)
    else:
        if not usable:
            usable_since = math.nan
        since = time if math.isnan(state.unusable_since) else state.unusable_since
        frozen = state.steps if math.isnan(state.unusable_since) else state.frozen
        left = _left(settings, time - since)
        # Rounded towards zero: a decaying offset never grows, even with a new resolution.
        goal = np.sign(state.steps) * np.minimum(np.trunc(left * np.abs(frozen)), abs(state.steps))
        filtered = wanted = np.full(len(channels.shares), np.nan)
    allowed, credit = _allowed(channels, state.credit, min(passed, settings.longest_cycle))
    way = np.clip(goal, -channels.most, channels.most).astype(np.int64) - state.steps
    moved = np.clip(way, -allowed[channels.shares], allowed[channels.shares])
    used = np.zeros_like(allowed)
    np.maximum.at(used, channels.shares, np.abs(moved))
    left_over = np.maximum(credit - used * channels.steps, 0.0)
    return OutputState(
        time, state.steps + moved, filtered, wanted, left_over, since, frozen, usable_since
    )


def mode_of(settings: OutputSettings, state: OutputState) -> Mode:
    """Return the mode of a state: waiting until the first usable estimate."""
    if math.isnan(state.unusable_since):
        return Mode.FOLLOW if np.isfinite(state.wanted).any() else Mode.WAIT
    if not state.used:
        return Mode.WAIT
    frozen = state.time - state.unusable_since <= settings.freeze_time
    return Mode.FREEZE if frozen else Mode.DECAY


def content_of(settings: OutputSettings, state: OutputState) -> dict[str, Any]:
    """Return a state as JSON values that do not depend on the settings, for `restored`.

    Unknown values are None. Axes of other settings may be added.
    """
    offset, frozen = _values(settings, state.steps), _values(settings, state.frozen)
    content: dict[str, Any] = {
        "time": _known(state.time),
        "unusable_since": _known(state.unusable_since),
        "axes": {
            name: {
                "follows": settings.estimated[k],
                "sign": settings.signs[k],
                "offset": float(offset[k]),
                "frozen": float(frozen[k]),
                "filtered": _known(state.filtered[k]),
                "wanted": _known(state.wanted[k]),
            }
            for k, name in enumerate(settings.names)
        },
    }
    for k, own in enumerate(settings.slopes, len(settings.names)):
        content["axes"][own.axis]["slope"] = {
            "reference": own.reference,
            "value": float(offset[k]),
            "frozen": float(frozen[k]),
            "filtered": _known(state.filtered[k]),
            "wanted": _known(state.wanted[k]),
        }
    return content


def restored(
    settings: OutputSettings, content: Mapping[str, Any], time: float, silence: float
) -> OutputState:
    """Return the state under these settings that continues one stored under others.

    An axis of the same name starts from its last offset and slope, rounded to the resolution; a new
    axis, or a new slope, from zero. With another reference the offset is the value of the same line
    at that reference. Filtered values are only used if the axis follows the same estimate as
    before. The elapsed time moves no axis, since a control holds its last value.

    Parameters
    ----------
    settings : OutputSettings
    content : mapping
        Result of `content_of`, under any settings.
    time : float
        Current time by the clock of the next cycles, s.
    silence : float
        Time since the last cycle, s, which counts for freezing and decay.
    """
    state, axes = at_zero(settings), content["axes"]
    # By channel: value, frozen, filtered, wanted.
    kept = np.tile([0.0, 0.0, np.nan, np.nan], (len(state.steps), 1))
    for k, name in enumerate(settings.names):
        if (axis := axes.get(name)) is not None:
            kept[k] = [_number(axis.get(key)) for key in ("offset", *_KEPT)]
    for k, own in enumerate(settings.slopes, len(settings.names)):
        slope = axes.get(own.axis, {}).get("slope")
        if slope is not None:
            kept[k] = [_number(slope.get(key)) for key in ("value", *_KEPT)]
            kept[settings.names.index(own.axis)] += (own.reference - slope["reference"]) * kept[k]
    for k, name in enumerate(settings.names):
        axis = axes.get(name, {})
        if (axis.get("follows"), axis.get("sign")) != (settings.estimated[k], settings.signs[k]):
            kept[[k, *_slope_of(settings, k)], 2:] = np.nan
    steps, frozen = (
        np.rint(kept[:, part] / settings.channels.resolution).astype(np.int64) for part in (0, 1)
    )
    before, unusable = (_number(content.get(key)) for key in ("time", "unusable_since"))
    unusable += time - silence - before
    return state._replace(
        time=time,
        steps=steps,
        filtered=kept[:, 2],
        wanted=kept[:, 3],
        unusable_since=unusable,
        frozen=frozen,
    )


def _slope_of(settings: OutputSettings, axis: int) -> list[int]:
    """Return the channel of the slope of an axis, given by its index; empty without a slope."""
    return [len(settings.names) + j for j, k in enumerate(settings.along) if k == axis]


def moved_to(
    settings: OutputSettings, state: OutputState, corrections: Array, time: float
) -> OutputState:
    """Return the state that continues from the corrections in the control, frozen at a time.

    These differ from the last ones sent. Offsets and slopes follow again once estimates have been
    usable for the recovery time.

    Parameters
    ----------
    settings : OutputSettings
    state : OutputState
    corrections : ndarray, shape (channels,)
        In the form of `corrections_of`, m.
    time : float
        Time, s.
    """
    channels = settings.channels
    steps = np.rint(corrections / channels.levers / channels.resolution).astype(np.int64)
    return state._replace(
        steps=steps,
        frozen=steps,
        credit=np.zeros_like(state.credit),
        unusable_since=time,
        usable_since=math.nan,
    )


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _recovered(settings: OutputSettings, state: OutputState, usable: float) -> bool:
    """Whether offsets follow an estimate that has been usable for a time (s)."""
    return math.isnan(state.unusable_since) or usable >= settings.recover_time


def _left(settings: OutputSettings, unusable: float) -> float:
    """Fraction of a frozen offset that remains after a time without an estimate (s)."""
    return math.exp(-max(unusable - settings.freeze_time, 0.0) / settings.decay_time)


def _filtered(settings: OutputSettings, before: Array, target: Array, passed: float) -> Array:
    """Low-pass that starts at the first usable estimate; the rate limit smooths the start."""
    if settings.filter_time <= 0.0:
        return target
    filtered = target + math.exp(-passed / settings.filter_time) * (before - target)
    return np.where(np.isnan(before), target, filtered)


def _beyond_dead_band(settings: OutputSettings, before: Array, filtered: Array) -> Array:
    inside = np.abs(filtered - before) <= settings.channels.dead_band  # False for NaN
    return np.where(inside, before, filtered)


def _allowed(channels: Channels, credit: Array, passed: float) -> tuple[NDArray[np.int64], Array]:
    """Steps by which a value may move in a cycle, and the available travel; shape (travels,).

    Travel of less than a step is carried over to the next cycle, up to one step, so that within any
    time a value moves by at most the rate times this time plus one step.
    """
    travel = channels.rates * passed
    credit = np.minimum(credit + travel, np.maximum(travel, channels.steps))
    steps = np.minimum(np.floor(credit / channels.steps + 1e-9), _ALL_STEPS)
    return steps.astype(np.int64), credit
