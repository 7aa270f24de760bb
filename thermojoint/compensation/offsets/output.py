"""One cycle of a control: from an estimate to the offset of each of its axes.

What is wanted is sign times the estimated displacement, filtered by a first-order low-pass, held
within a dead band, limited to a largest total; what comes out goes there no faster than a rate, in
whole steps of the control's resolution. An estimate that cannot be used freezes the offsets, and
after a while they decay to zero. The offsets are counted in whole steps, so that none is between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class OutputSettings:
    """How offsets are made.

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

    @property
    def most_steps(self) -> int:
        """Largest offset in whole steps."""
        # A limit that is a number of steps, but for its rounding, is that number.
        return math.floor(self.largest / self.resolution + 1e-9)


class OutputState(NamedTuple):
    """All that one cycle leaves to the next.

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
        When the estimates became unusable, s; NaN if they are usable.
    frozen : ndarray of int, shape (axes,)
        The offsets at that time.
    """

    time: float
    steps: NDArray[np.int64]
    filtered: Array
    wanted: Array
    credit: float
    unusable_since: float
    frozen: NDArray[np.int64]


def at_zero(settings: OutputSettings) -> OutputState:
    """Return the state of a control that has received nothing yet."""
    count = len(settings.names)
    unseen, none = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    return OutputState(math.nan, none, unseen, unseen, 0.0, math.nan, none)


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
    if target is None or not np.isfinite(target).all():
        since = time if math.isnan(state.unusable_since) else state.unusable_since
        frozen = state.steps if math.isnan(state.unusable_since) else state.frozen
        left = _left(settings, time - since)
        # Towards zero, so that what decays never grows.
        goal = np.trunc(left * frozen).astype(np.int64)
        filtered = wanted = np.full(len(settings.names), np.nan)
    else:
        since, frozen = math.nan, state.frozen
        filtered = _filtered(settings, state.filtered, target, passed)
        wanted = _beyond_dead_band(settings, state.wanted, filtered)
        most = settings.most_steps
        goal = np.clip(np.rint(wanted / settings.resolution), -most, most).astype(np.int64)
    allowed, credit = _allowed(settings, state.credit, passed)
    moved = np.clip(goal - state.steps, -allowed, allowed)
    used = int(np.abs(moved).max(initial=0)) * settings.resolution
    return OutputState(
        time, state.steps + moved, filtered, wanted, max(credit - used, 0.0), since, frozen
    )


def _left(settings: OutputSettings, unusable: float) -> float:
    """Part of a frozen offset that is left after a time without an estimate (s)."""
    return math.exp(-max(unusable - settings.freeze_time, 0.0) / settings.decay_time)


def _filtered(settings: OutputSettings, before: Array, target: Array, passed: float) -> Array:
    """The low-pass; it begins where the first usable estimate is, and the rate does the rest."""
    if np.isnan(before).any() or settings.filter_time <= 0.0:
        return target
    return np.asarray(target + math.exp(-passed / settings.filter_time) * (before - target))


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
