"""Axis offsets in one control cycle, from an estimate.

The target is sign times the estimated displacement after a first-order low-pass, a dead band and a
limit. The offset approaches it with a limited rate in whole steps of the control's resolution.
Without a usable estimate the offsets freeze, and later decay to zero; they follow again once
estimates have been usable for some time, so that an intermittent status does not move an axis back
and forth.

A state outlives its settings (`content_of`, `restored`): it is stored in metres by axis name, so
after a change of the resolution, the limits or the axes each axis continues from the offset that
the control received last.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class OutputSettings:
    """Settings of the output stage.

    Attributes
    ----------
    names : tuple of str
        Axes of the control.
    estimated : tuple of str
        Axis of the estimate that each of them follows.
    signs : tuple of int
        1 or -1: offset per estimated displacement.
    resolution : float
        Step of an offset, m.
    rate : float
        Largest rate of an offset, m/s.
    dead_band : float
        The target changes only if the estimate has changed by more than this, m.
    filter_time : float
        Time constant of the low-pass, s; 0 for none.
    largest : float
        Largest offset of either sign, m.
    freeze_time : float
        Time for which offsets are held without a usable estimate, s.
    decay_time : float
        Time constant of their decay to zero after that, s.
    recover_time : float
        Time for which estimates must be usable again before offsets follow them, s.
    longest_cycle : float
        Upper limit of a cycle's duration in the rate limit, s, so that offsets do not jump after a
        pause.
    """

    names: tuple[str, ...]
    estimated: tuple[str, ...]
    signs: tuple[int, ...]
    resolution: float
    rate: float
    dead_band: float
    filter_time: float
    largest: float
    freeze_time: float
    decay_time: float
    recover_time: float
    longest_cycle: float

    @property
    def most_steps(self) -> int:
        """Largest offset in whole steps."""
        # Rounding must not reduce a limit of a whole number of steps.
        return math.floor(self.largest / self.resolution + 1e-9)


class Mode(Enum):
    """Mode of the offsets."""

    WAIT = "wait"
    FOLLOW = "follow"
    FREEZE = "freeze"
    DECAY = "decay"


class OutputState(NamedTuple):
    """State carried from one cycle to the next.

    Attributes
    ----------
    time : float
        Time of the last cycle, s; NaN before the first.
    steps : ndarray of int, shape (axes,)
        The offsets, in steps of the resolution.
    filtered, wanted : ndarray, shape (axes,)
        Target after the low-pass, and after the dead band, m; NaN before the first estimate.
    credit : float
        Unused travel carried over from previous cycles, m; at most one step.
    unusable_since : float
        Time at which the offsets stopped following, s; NaN while they follow.
    frozen : ndarray of int, shape (axes,)
        The offsets at that time.
    usable_since : float
        Time at which estimates became usable again, s; NaN if they have not.
    """

    time: float
    steps: NDArray[np.int64]
    filtered: Array
    wanted: Array
    credit: float
    unusable_since: float
    frozen: NDArray[np.int64]
    usable_since: float

    @property
    def used(self) -> bool:
        """Whether any estimate has moved the offsets yet."""
        return bool(self.frozen.any() or self.steps.any() or np.isfinite(self.wanted).any())


def at_zero(settings: OutputSettings) -> OutputState:
    """Return the state before the first cycle."""
    count = len(settings.names)
    unseen, none = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    return OutputState(math.nan, none, unseen, unseen, 0.0, math.nan, none, math.nan)


def offsets_of(settings: OutputSettings, state: OutputState) -> Array:
    """Return the offsets of a state, m, shape (axes,)."""
    return np.asarray(settings.resolution * state.steps)


def followed(settings: OutputSettings, axes: Sequence[str], displacement: Array) -> Array:
    """Return the targets of the offsets, m, shape (control's axes,).

    Parameters
    ----------
    settings : OutputSettings
    axes : sequence of str
        Axes of the estimate, including all that `settings` refers to.
    displacement : ndarray, shape (axes,)
        Estimated, m.
    """
    at = [list(axes).index(name) for name in settings.estimated]
    return np.asarray(np.array(settings.signs) * displacement[at])


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
        s; later than that of the previous cycle.
    target : ndarray, shape (axes,), or None
        Targets of the offsets, m (`followed`); None or non-finite values without a usable estimate.
    """
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
        goal = np.rint(wanted / settings.resolution)
    else:
        if not usable:
            usable_since = math.nan
        since = time if math.isnan(state.unusable_since) else state.unusable_since
        frozen = state.steps if math.isnan(state.unusable_since) else state.frozen
        left = _left(settings, time - since)
        # Rounded towards zero, so that a decaying offset never grows, even with a new resolution.
        goal = np.sign(state.steps) * np.minimum(np.trunc(left * np.abs(frozen)), abs(state.steps))
        filtered = wanted = np.full(len(settings.names), np.nan)
    most = settings.most_steps
    allowed, credit = _allowed(settings, state.credit, min(passed, settings.longest_cycle))
    way = np.clip(goal, -most, most).astype(np.int64) - state.steps
    moved = np.clip(way, -allowed, allowed)
    left_over = max(credit - int(np.abs(moved).max(initial=0)) * settings.resolution, 0.0)
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
    return {
        "time": _known(state.time),
        "unusable_since": _known(state.unusable_since),
        "axes": {
            name: {
                "follows": settings.estimated[k],
                "sign": settings.signs[k],
                "offset": settings.resolution * int(state.steps[k]),
                "frozen": settings.resolution * int(state.frozen[k]),
                "filtered": _known(state.filtered[k]),
                "wanted": _known(state.wanted[k]),
            }
            for k, name in enumerate(settings.names)
        },
    }


def restored(
    settings: OutputSettings, content: Mapping[str, Any], time: float, silence: float
) -> OutputState:
    """Return the state under these settings that continues one stored under others.

    An axis of the same name starts from its last offset, rounded to the resolution; a new axis from
    zero. Filtered values are only used if the same estimate is followed. The elapsed time moves no
    axis, since a control holds its last value.

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
    steps, frozen = state.steps.copy(), state.frozen.copy()
    filtered, wanted = state.filtered.copy(), state.wanted.copy()
    for k, name in enumerate(settings.names):
        if (axis := axes.get(name)) is None:
            continue
        steps[k], frozen[k] = (
            round(axis[key] / settings.resolution) for key in ("offset", "frozen")
        )
        if (axis["follows"], axis["sign"]) == (settings.estimated[k], settings.signs[k]):
            filtered[k], wanted[k] = (_number(axis.get(key)) for key in ("filtered", "wanted"))
    before, unusable = (_number(content.get(key)) for key in ("time", "unusable_since"))
    unusable += time - silence - before
    return OutputState(time, steps, filtered, wanted, 0.0, unusable, frozen, math.nan)


def moved_to(
    settings: OutputSettings, state: OutputState, offsets: Array, time: float
) -> OutputState:
    """Return the state that goes on from offsets (m) that a control has, frozen there at a time.

    They are not those that it was sent last; they follow again once estimates have been usable for
    the time to recover.
    """
    steps = np.rint(offsets / settings.resolution).astype(np.int64)
    return state._replace(
        steps=steps, frozen=steps, credit=0.0, unusable_since=time, usable_since=math.nan
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
    inside = np.abs(filtered - before) <= settings.dead_band  # False for NaN
    return np.where(inside, before, filtered)


def _allowed(settings: OutputSettings, credit: float, passed: float) -> tuple[int, float]:
    """Number of steps that an offset may move in a cycle, and the available travel (m).

    Travel of less than a step is carried over to the next cycle, up to one step, so that within any
    time an offset moves by at most the rate times this time plus one step.
    """
    travel = settings.rate * passed
    credit = min(credit + travel, max(travel, settings.resolution))
    return math.floor(credit / settings.resolution + 1e-9), credit
