"""Which readings of a sample are not to be believed: range, rate, stuck, and contradiction.

Everything is judged before a sample is used. A channel is distrusted when it is

- impossible: no part of the machine is so hot or so cold;
- hasty: it changed faster than any part of a machine does;
- stuck: it repeats its last value far longer than it ever did; or the model says that it should
  have moved by now;
- contradicted: its innovation, given the other channels, is beyond what is to be expected.

It is believed again when all that has been over for `RETURN`; one that was contradicted must have
come nearer the model than the model is likely to have come to it, and stay there for `AGREED`.
Where most channels contradict the model, it is the model's state that is wrong (`Verdict.lost`):
then all are believed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.machine_code import compiled
from thermojoint.artefacts.arrays import Array, Flags

#: From the innovations (n,), K, and the channels that count (indices): what of them no possible
#: change of the heat explains, K, shape (n,), and its covariance, K2, shape (n, n).
Explain = Callable[[Array, NDArray[np.int64]], tuple[Array, Array]]

#: Standard deviations of an innovation beyond which a reading is contradicted.
GATE = 5.0
#: What a healthy reading may be off by for want of a perfect model, K, and a part of what the model
#: says beside: no innovation below GATE of it counts, however sure the model is of itself.
MODEL_ERROR, MODEL_SHARE = 0.2, 0.01
#: A distrusted channel is believed again after this long without a fault, s.
RETURN = 30.0
#: One that was contradicted, after this long: a jump of the heat brings what is off near the model,
#: for as long as the other channels take to see that heat.
AGREED = 300.0
#: A channel that was off is believed again only if it is off by no more than this part of what it
#: was, or by so many standard deviations of the model: a model that has lost it wanders. If it has
#: jumped back by that part or more, it need only be as near as any.
NEARER, NEAR = 0.25, 1.0
JUMPED_BACK = 0.5
#: No thermometer in a machine changes faster than this, K/s, beyond a jump of `JUMP`, K.
RATE, JUMP = 2.0, 3.0
#: A value that repeats for this long, s, and this many samples may be stuck, ...
STUCK, REPEATS = 12.0, 4
#: ... if by its own habit the channel would do so with this probability, or less, ...
IMPROBABLE = 1e-6
#: ... and has no coarse display: it has changed by less than its noise, or by what is on average so
#: far from multiples of one step, over so many changes; ...
GRAIN, SEEN = 0.005, 10.0
#: ... or if the model says that it should have moved by so many of its steps, or of its noise.
STEPS = 4.0
#: A channel that never changed is stuck as well if this many others turn back in this share of
#: their changes, as noise does, and by their habit it would have changed.
WITNESSES, TURNING = 2, 0.25
#: The step of a display that has shown none yet, K.
UNKNOWN = 0.25
#: Repetition that a channel is given at first, and the samples over which its habit is learnt.
HABIT, LEARNT = 0.5, 50.0
#: Changes below this are rounding, K.
ROUNDING = 1e-9


class Watch(NamedTuple):
    """What is remembered of every channel; arrays of shape (n,), NaN where nothing is known yet.

    Attributes
    ----------
    distrusted : ndarray
        1 where it is left out, else 0.
    fault : ndarray
        When it last showed a fault, s.
    read : ndarray
        When it was last there, s.
    last : ndarray
        What it said then, K.
    changed : ndarray
        When it first said so, s.
    expected : ndarray
        What the model said at that time, K.
    repeats : ndarray
        How often it said so since.
    habit : ndarray
        The share of its readings that repeat the one before.
    finest : ndarray
        The smallest change that it has shown, K.
    grain : ndarray
        How far its changes are from multiples of that, as a part of it: 0 for a coarse display.
    rise : ndarray
        Its last change, K.
    turned : ndarray
        The share of its changes that turn back: a smooth one's none, two thirds of pure noise's.
    off : ndarray
        How far it was from the model when that contradicted it, K; negative since it jumped back.
    """

    distrusted: Array
    fault: Array
    read: Array
    last: Array
    changed: Array
    expected: Array
    repeats: Array
    habit: Array
    finest: Array
    grain: Array
    rise: Array
    turned: Array
    off: Array


def fresh(channels: int) -> Watch:
    """Return a watch that has seen nothing."""
    nothing, unknown = np.zeros(channels), np.full(channels, np.nan)
    return Watch(
        distrusted=nothing,
        fault=unknown,
        read=unknown,
        last=unknown,
        changed=unknown,
        expected=unknown,
        repeats=nothing,
        habit=np.full(channels, HABIT),
        finest=unknown,
        grain=nothing,
        rise=unknown,
        turned=nothing,
        off=unknown,
    )


class Verdict(NamedTuple):
    """What a sample is worth.

    Attributes
    ----------
    believed : ndarray of bool, shape (n,)
        To be used.
    lost : bool
        Most channels contradict the model: its state is not the machine's.
    watch : Watch
        To be kept for the next sample.
    """

    believed: Flags
    lost: bool
    watch: Watch


def judge_sample(
    watch: Watch,
    time: float,
    readings: Array,
    predicted: Array,
    explain: Explain,
    noise: Array,
    limits: tuple[Array, Array],
    thermometers: int,
) -> Verdict:
    """Say which readings of a sample are to be used.

    Parameters
    ----------
    watch : Watch
        Of the sample before.
    time : float
        s.
    readings : ndarray, shape (n,)
        K; NaN where there is none.
    predicted : ndarray, shape (n,)
        What the model expects, K.
    explain : callable
        As `Explain`; called where it matters.
    noise : ndarray, shape (n,)
        Standard deviation of a reading, K.
    limits : pair of ndarray, shape (n,)
        Lowest and highest reading that is possible, K.
    thermometers : int
        Channels, the first ones, that are thermometers in the machine; others may be constants.
    """
    present = np.isfinite(readings)
    seen = Watch(*np.array(watch))
    odd, near = np.empty_like(present), np.empty_like(present)
    look(seen, time, readings, predicted, noise, *limits, thermometers, odd, near)
    doubted = watch.distrusted > 0.0
    credible = present & ~odd
    contradicted = _contradicted(readings - predicted, predicted, explain, credible & ~doubted)
    if not (odd.any() or doubted.any() or contradicted.any()):
        return Verdict(present, False, seen)
    first = not np.isfinite(watch.read).any()
    lost = bool(contradicted.any()) and _mostly(contradicted | doubted, credible, first)
    if lost:
        faulty, doubted = odd, doubted & ~credible
    else:
        faulty = odd | contradicted | (doubted & present & ~near)
    fault = np.where(faulty, time, seen.fault)
    wait = np.where(np.isfinite(seen.off), AGREED, RETURN)
    distrusted = faulty | (doubted & (~present | (time - fault < wait)))
    off = np.where(contradicted & ~doubted, np.abs(readings - predicted), seen.off)
    after = seen._replace(
        distrusted=distrusted.astype(float), fault=fault, off=np.where(distrusted, off, np.nan)
    )
    return Verdict(present & ~distrusted, lost, after)


def model_error(predicted: Array) -> Array:
    """Return what healthy readings may be off by for want of a perfect model, K, shape (n,)."""
    return np.asarray(MODEL_ERROR + MODEL_SHARE * np.abs(predicted))


@compiled
def _stuck(watch: Watch, channel: int, time: float, said: float, noise: float) -> bool:
    """Whether a channel repeats its last value although it should not."""
    repeats, finest = watch.repeats[channel], watch.finest[channel]
    if repeats < REPEATS or time - watch.changed[channel] < STUCK:
        return False
    unlike = repeats * math.log(max(watch.habit[channel], 1e-300)) < math.log(IMPROBABLE)
    if unlike and (finest < noise or watch.grain[channel] > GRAIN):
        return True
    step = max(finest, noise) if finest >= 0.0 else max(UNKNOWN, noise)
    return abs(said - watch.expected[channel]) > STEPS * step


@compiled
def _silent(watch: Watch, channel: int, thermometers: int) -> bool:
    """Whether a channel never changed where others have noise."""
    if channel >= thermometers or watch.finest[channel] >= 0.0:
        return False
    witnesses, habit = 0, 0.0
    for k in range(thermometers):
        if k == channel or watch.distrusted[k] > 0.0 or watch.turned[k] < TURNING:
            continue
        witnesses += 1
        habit = max(habit, watch.habit[k])
    improbable = watch.repeats[channel] * math.log(max(habit, 1e-300)) < math.log(IMPROBABLE)
    return witnesses >= WITNESSES and improbable


@compiled
def look(
    watch: Watch,
    time: float,
    readings: Array,
    predicted: Array,
    noise: Array,
    low: Array,
    high: Array,
    thermometers: int,
    odd: Flags,
    near: Flags,
) -> None:
    """Put a sample into the watch, in place; say what is odd, and what is near the model."""
    for k in range(readings.size):
        reading, said = readings[k], predicted[k]
        odd[k] = near[k] = False
        if not np.isfinite(reading):
            continue
        imperfect = MODEL_ERROR + MODEL_SHARE * abs(said)
        limit = GATE * imperfect
        if watch.off[k] >= 0.0:
            limit = min(limit, max(NEAR * imperfect, NEARER * watch.off[k]))
        near[k] = abs(reading - said) <= limit
        change, since = abs(reading - watch.last[k]), time - watch.read[k]
        # Compared with what is not known yet, NaN, nothing is odd.
        odd[k] = reading < low[k] or reading > high[k] or change > RATE * since + JUMP
        watch.read[k] = time
        if change <= ROUNDING:
            watch.repeats[k] += 1.0
            odd[k] = odd[k] or _stuck(watch, k, time, said, noise[k])
            odd[k] = odd[k] or _silent(watch, k, thermometers)
            continue
        run = watch.repeats[k] + 1.0
        kept = (1.0 - 1.0 / LEARNT) ** run
        watch.habit[k] = kept * watch.habit[k] + (1.0 - kept) * watch.repeats[k] / run
        rise, before = reading - watch.last[k], watch.rise[k]
        if change >= JUMPED_BACK * abs(watch.off[k]):
            watch.off[k] = -abs(watch.off[k])
        watch.last[k], watch.changed[k], watch.expected[k] = reading, time, said
        watch.repeats[k] = 0.0
        if not change >= 0.0:
            continue
        watch.rise[k] = rise
        watch.turned[k] += ((1.0 if rise * before < 0.0 else 0.0) - watch.turned[k]) / SEEN
        finest = watch.finest[k]
        if finest >= 0.0:
            ratio = max(change, finest) / min(change, finest)
            watch.grain[k] += (abs(ratio - np.rint(ratio)) - watch.grain[k]) / SEEN
        watch.finest[k] = min(change, finest) if finest >= 0.0 else change


def _contradicted(innovation: Array, predicted: Array, explain: Explain, trusted: Flags) -> Flags:
    """Channels that the others and the model contradict, the worst first; shape (n,)."""
    found = np.zeros_like(trusted)
    at = np.flatnonzero(trusted)
    # No statistic below exceeds |innovation| / MODEL_ERROR: the usual case costs nothing.
    if math.sqrt(innovation[at] @ innovation[at]) <= GATE * MODEL_ERROR:
        return found
    imperfect = model_error(predicted)
    while at.size:
        rest, covariance = explain(innovation, at)
        whole = covariance + np.diag(imperfect**2)
        inverse = np.linalg.inv(whole[np.ix_(at, at)])
        # What the others leave open in i is r = (S^-1 nu)_i / (S^-1)_ii, of variance 1 / (S^-1)_ii.
        relative = np.abs(inverse @ rest[at]) / np.sqrt(np.diag(inverse))
        worst = int(np.argmax(relative))
        if relative[worst] <= GATE:
            break
        found[at[worst]] = True
        at = np.delete(at, worst)
    return found


def _mostly(doubtful: Flags, credible: Flags, first: bool) -> bool:
    """Whether more than half of the channels, and more than one, are doubtful.

    At the first sample more than one is enough: a machine that is not as it was said to be is
    likelier then than two faults at once.
    """
    most = 1.0 if first else max(1.0, 0.5 * credible.sum())
    return bool((doubtful & credible).sum() > most)
