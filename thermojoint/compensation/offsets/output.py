"""Axis offsets in one control cycle, from an estimate.

What is wanted is sign times the estimated displacement, filtered by a first-order low-pass, held
within a dead band, limited to a largest total; what comes out goes there no faster than a rate, in
whole steps of the control's resolution. An estimate that cannot be used freezes the offsets, and
after a while they decay to zero; they follow again once estimates have been usable for some time,
so that a status that comes and goes does not drive an axis to and fro. The offsets are counted in
whole steps, so that none is between.

A state outlives its settings (`content_of`, `restored`): it is kept in metres by the names of the
axes, so after a change of the resolution, the limits or the axes each axis goes on from the offset
that the control received last.
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
        The control's axes.
    estimated : tuple of str
        The axis of the estimate that each of them follows.
    signs : tuple of int
        1 or -1: offset per estimated displacement.
    resolution : float
        One step of an offset, m.
    rate : float
        Fastest change of an offset, m/s.
    dead_band : float
        What is wanted moves only if the estimate has moved by more than this, m.
    filter_time : float
        Time constant of the low-pass, s; 0 for none.
    largest : float
        Largest offset of either sign, m.
    freeze_time : float
        How long offsets stay where they are without a usable estimate, s.
    decay_time : float
        Time constant with which they go to zero then, s.
    recover_time : float
        How long estimates must have been usable again before offsets follow them, s.
    longest_cycle : float
        A longer time between two cycles counts as this long for how far offsets may move, s: after
        a pause they begin where they were.
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
        # A limit that is a number of steps, but for its rounding, is that number.
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
        Of the last cycle, s; NaN before the first.
    steps : ndarray of int, shape (axes,)
        The offsets, in steps of the resolution.
    filtered, wanted : ndarray, shape (axes,)
        After the low-pass, and after the dead band, m; NaN where no estimate has been used yet.
    credit : float
        How far an offset may move beyond what the time of a cycle allows, m: less than a step.
    unusable_since : float
        When the offsets ceased to follow, s; NaN while they follow.
    frozen : ndarray of int, shape (axes,)
        The offsets at that time.
    usable_since : float
        When estimates became usable again since then, s; NaN if they have not.
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
    """Return the state of a control that has received nothing yet."""
    count = len(settings.names)
    unseen, none = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    return OutputState(math.nan, none, unseen, unseen, 0.0, math.nan, none, math.nan)


def offsets_of(settings: OutputSettings, state: OutputState) -> Array:
    """Return the offsets of a state, m, shape (axes,)."""
    return np.asarray(settings.resolution * state.steps)


def followed(settings: OutputSettings, axes: Sequence[str], displacement: Array) -> Array:
    """Return what the offsets should be, m, shape (control's axes,).

    Parameters
    ----------
    settings : OutputSettings
    axes : sequence of str
        Of the estimate; it has every one that `settings` names.
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
        After the cycle before; it stays as it is.
    time : float
        s; later than that of the cycle before.
    target : ndarray, shape (axes,), or None
        What the offsets should be, m (`followed`); None, or a value that is not finite: there is no
        usable estimate.
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
        # Towards zero, so that what decays never grows; nor beyond what another resolution left.
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
    """Return what the offsets of a state do; they wait until an estimate has moved them."""
    if math.isnan(state.unusable_since):
        return Mode.FOLLOW if np.isfinite(state.wanted).any() else Mode.WAIT
    if not state.used:
        return Mode.WAIT
    frozen = state.time - state.unusable_since <= settings.freeze_time
    return Mode.FREEZE if frozen else Mode.DECAY


def content_of(settings: OutputSettings, state: OutputState) -> dict[str, Any]:
    """Return a state as JSON values that do not depend on the settings: `restored`.

    None stands for what is not known. Axes of another such content may stand beside these.
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
    """Return the state that goes on, under these settings, from one that others have left.

    An axis of the same name begins at the offset that it had, to half a step of the resolution; an
    axis that is new, at zero. What was filtered counts only where the same estimate is followed.
    Nothing moves by the time that has passed: a control that was told nothing holds its value.

    Parameters
    ----------
    settings : OutputSettings
    content : mapping
        `content_of` the state, by whatever settings.
    time : float
        When it goes on, by the clock of the cycles from now on, s.
    silence : float
        Since its last cycle, s; freezing and decay count it.
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


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _recovered(settings: OutputSettings, state: OutputState, usable: float) -> bool:
    """Whether offsets follow an estimate that is usable, and has been for a time (s)."""
    return math.isnan(state.unusable_since) or usable >= settings.recover_time


def _left(settings: OutputSettings, unusable: float) -> float:
    """Part of a frozen offset that is left after a time without an estimate (s)."""
    return math.exp(-max(unusable - settings.freeze_time, 0.0) / settings.decay_time)


def _filtered(settings: OutputSettings, before: Array, target: Array, passed: float) -> Array:
    """The low-pass; it begins where the first usable estimate is, and the rate does the rest."""
    if settings.filter_time <= 0.0:
        return target
    filtered = target + math.exp(-passed / settings.filter_time) * (before - target)
    return np.where(np.isnan(before), target, filtered)


def _beyond_dead_band(settings: OutputSettings, before: Array, filtered: Array) -> Array:
    stays = np.abs(filtered - before) <= settings.dead_band  # not where there was none
    return np.where(stays, before, filtered)


def _allowed(settings: OutputSettings, credit: float, passed: float) -> tuple[int, float]:
    """Steps that an offset may move in a cycle, and the way (m) they are taken from.

    What a cycle's time allows less than a step of is kept for the next, but never more than a step:
    so over any time an offset moves by the rate times this time, and a step.
    """
    way = settings.rate * passed
    credit = min(credit + way, max(way, settings.resolution))
    return math.floor(credit / settings.resolution + 1e-9), credit
