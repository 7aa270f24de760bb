"""Sensor fault detection by range, rate, repetition and innovation.

Start at `judge_sample`: it judges a sample before it is used. A channel is distrusted when it is

- impossible: no part of the machine is so hot or so cold;
- hasty: it changed faster than any part of a machine does;
- stuck: it repeats its last value far longer than it ever did; or the model says that it should
  have moved by now;
- contradicted: its innovation, given the other channels, is beyond what is to be expected.

The first three are found by `look`, channel by channel; the last by `_contradicted`, the worst
channel first. A channel is believed again when all that has been over for `Thresholds.clear`; one
that was contradicted must have come nearer the model than the model is likely to have come to it,
and stay there for `Thresholds.agreed`. Where most channels contradict the model, it is the model's
state that is wrong (`Verdict.lost`): then all are believed.

Proved by tests/test_sensor_faults.py, one rule at a time and without a machine, and by
``python -m benchmarks.sensor_faults`` on the reference machine (docs/faulty-sensors.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled
from thermojoint.artefacts.arrays import Array, Flags

#: From the innovations (n,), K, and the channels that count (indices): what of them no possible
#: change of the heat explains, K, shape (n,), and its covariance, K2, shape (n, n).
Explain = Callable[[Array, NDArray[np.int64]], tuple[Array, Array]]


class Thresholds(NamedTuple):
    """When a channel is distrusted, and when it is believed again.

    Set and checked together by ``python -m benchmarks.sensor_faults``: 128 faults over 35 min, of
    which 126 are survived, and 64 over 8 h, of which 63 are (docs/faulty-sensors.md). What a field
    alone is worth there stands with it.

    Attributes
    ----------
    gate : float
        Standard deviations of an innovation beyond which a reading is contradicted.
    model_error, model_share : float
        Standard deviation of a healthy reading for want of a perfect model, K, and a part of what
        the model says beside: no innovation below `gate` of it counts, however sure the model is.
    clear : float
        A distrusted channel is believed again after this long without a fault, s.
    agreed : float
        One that was contradicted, after this long near the model, s: a jump of the heat brings what
        is off near it for as long as the other channels take to see that heat. With 30 s, 59 of
        the 64 faults over 8 h are survived.
    nearer, near : float
        It counts as near if it is off by no more than this part of what it was, or by so many
        standard deviations of the model: a model that has lost a channel wanders. Without this
        rule and those for `witnesses`, 119 of the 128 faults are survived.
    jumped_back : float
        If it has jumped back by this part of what it was off by, it need only be as near as any.
    rate, jump : float
        No thermometer in a machine changes faster than this, K/s, beyond a jump, K.
    stuck, repeats : float
        A value that repeats for this long, s, and this many samples may be stuck, ...
    improbable : float
        ... if by its own habit the channel would do so with this probability, or less, ...
    grain, seen : float
        ... and has no coarse display: it has changed by less than its noise, or by what is on
        average so far from multiples of one step, over so many changes; ...
    steps : float
        ... or if the model says that it should have moved by so many of its steps or its noise.
    witnesses, turning : float
        A channel that never changed is stuck as well if this many others turn back in this share
        of their changes, as noise does, and by their habit it would have changed.
    unknown_step : float
        The step of a display that has shown none yet, K.
    habit, learnt : float
        Repetition that a channel is given at first, and the samples over which it is learnt.
    rounding : float
        Changes below this are none, K.
    """

    gate: float = 5.0
    model_error: float = 0.2
    model_share: float = 0.01
    clear: float = 30.0
    agreed: float = 300.0
    nearer: float = 0.25
    near: float = 1.0
    jumped_back: float = 0.5
    rate: float = 2.0
    jump: float = 3.0
    stuck: float = 12.0
    repeats: float = 4.0
    improbable: float = 1e-6
    grain: float = 0.005
    seen: float = 10.0
    steps: float = 4.0
    witnesses: float = 2.0
    turning: float = 0.25
    unknown_step: float = 0.25
    habit: float = 0.5
    learnt: float = 50.0
    rounding: float = 1e-9


class Channels(NamedTuple):
    """Prior knowledge of the channels; arrays of shape (n,), K.

    Attributes
    ----------
    noise : ndarray
        Standard deviation of a reading.
    low, high : ndarray
        Lowest and highest reading that is possible.
    thermometers : int
        Channels, the first ones, that are thermometers in the machine; others may be constants.
    """

    noise: Array
    low: Array
    high: Array
    thermometers: int


class Sample(NamedTuple):
    """A sample and what the model expects of it.

    Attributes
    ----------
    time : float
        s.
    readings : ndarray, shape (n,)
        K; NaN where there is none.
    predicted : ndarray, shape (n,)
        K.
    """

    time: float
    readings: Array
    predicted: Array


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


def fresh(channels: int, rules: Thresholds) -> Watch:
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
        habit=np.full(channels, rules.habit),
        finest=unknown,
        grain=nothing,
        rise=unknown,
        turned=nothing,
        off=unknown,
    )


class Verdict(NamedTuple):
    """Verdict on the readings of a sample.

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
    watch: Watch, sample: Sample, explain: Explain, channels: Channels, rules: Thresholds
) -> Verdict:
    """Say which readings of a sample are to be used.

    Parameters
    ----------
    watch : Watch
        Of the sample before.
    sample : Sample
        The readings beside what the model expects.
    explain : callable
        As `Explain`; called where it matters.
    channels : Channels
        What they can say.
    rules : Thresholds
        When one is distrusted.
    """
    time, readings, predicted = sample
    present = np.isfinite(readings)
    seen = Watch(*np.array(watch))
    odd, near = np.empty_like(present), np.empty_like(present)
    look(seen, sample, channels, rules, odd, near)
    doubted = watch.distrusted > 0.0
    credible = present & ~odd
    contradicted = _contradicted(sample, explain, credible & ~doubted, rules)
    if not (odd.any() or doubted.any() or contradicted.any()):
        return Verdict(present, False, seen)
    first = not np.isfinite(watch.read).any()
    lost = bool(contradicted.any()) and _mostly(contradicted | doubted, credible, first)
    if lost:
        faulty, doubted = odd, doubted & ~credible
    else:
        faulty = odd | contradicted | (doubted & present & ~near)
    fault = np.where(faulty, time, seen.fault)
    wait = np.where(np.isfinite(seen.off), rules.agreed, rules.clear)
    distrusted = faulty | (doubted & (~present | (time - fault < wait)))
    off = np.where(contradicted & ~doubted, np.abs(readings - predicted), seen.off)
    after = seen._replace(
        distrusted=distrusted.astype(float), fault=fault, off=np.where(distrusted, off, np.nan)
    )
    return Verdict(present & ~distrusted, lost, after)


def model_error(predicted: Array, rules: Thresholds) -> Array:
    """Return what healthy readings may be off by for want of a perfect model, K, shape (n,)."""
    return np.asarray(rules.model_error + rules.model_share * np.abs(predicted))


@compiled
def certainly_alike(innovation: Array, rules: Thresholds) -> bool:
    """Whether innovations are so small, K, that whatever the covariance none is a contradiction.

    No statistic of a contradiction, and none of a jump, exceeds |innovation| / `model_error`.
    """
    return math.sqrt(np.dot(innovation, innovation)) <= rules.gate * rules.model_error


@compiled
def _stuck(watch: Watch, channel: int, sample: Sample, noise: float, rules: Thresholds) -> bool:
    """Whether a channel repeats its last value although it should not."""
    repeats, finest = watch.repeats[channel], watch.finest[channel]
    if repeats < rules.repeats or sample.time - watch.changed[channel] < rules.stuck:
        return False
    unlike = repeats * math.log(max(watch.habit[channel], 1e-300)) < math.log(rules.improbable)
    if unlike and (finest < noise or watch.grain[channel] > rules.grain):
        return True
    step = max(finest, noise) if finest >= 0.0 else max(rules.unknown_step, noise)
    return abs(sample.predicted[channel] - watch.expected[channel]) > rules.steps * step


@compiled
def _silent(watch: Watch, channel: int, thermometers: int, rules: Thresholds) -> bool:
    """Whether a channel never changed where others have noise."""
    if channel >= thermometers or watch.finest[channel] >= 0.0:
        return False
    witnesses, habit = 0, 0.0
    for k in range(thermometers):
        if k == channel or watch.distrusted[k] > 0.0 or watch.turned[k] < rules.turning:
            continue
        witnesses += 1
        habit = max(habit, watch.habit[k])
    likelihood = watch.repeats[channel] * math.log(max(habit, 1e-300))
    return witnesses >= rules.witnesses and likelihood < math.log(rules.improbable)


@compiled
def look(
    watch: Watch, sample: Sample, channels: Channels, rules: Thresholds, odd: Flags, near: Flags
) -> None:
    """Put a sample into the watch, in place; say what is odd, and what is near the model."""
    time, readings, predicted = sample.time, sample.readings, sample.predicted
    for k in range(readings.size):
        reading, said = readings[k], predicted[k]
        odd[k] = near[k] = False
        if not np.isfinite(reading):
            continue
        imperfect = rules.model_error + rules.model_share * abs(said)
        limit = rules.gate * imperfect
        if watch.off[k] >= 0.0:
            limit = min(limit, max(rules.near * imperfect, rules.nearer * watch.off[k]))
        near[k] = abs(reading - said) <= limit
        change, since = abs(reading - watch.last[k]), time - watch.read[k]
        # Compared with what is not known yet, NaN, nothing is odd.
        odd[k] = reading < channels.low[k] or reading > channels.high[k]
        odd[k] = odd[k] or change > rules.rate * since + rules.jump
        watch.read[k] = time
        if change <= rules.rounding:
            watch.repeats[k] += 1.0
            odd[k] = odd[k] or _stuck(watch, k, sample, channels.noise[k], rules)
            odd[k] = odd[k] or _silent(watch, k, channels.thermometers, rules)
            continue
        run = watch.repeats[k] + 1.0
        kept = (1.0 - 1.0 / rules.learnt) ** run
        watch.habit[k] = kept * watch.habit[k] + (1.0 - kept) * watch.repeats[k] / run
        rise, before = reading - watch.last[k], watch.rise[k]
        if change >= rules.jumped_back * abs(watch.off[k]):
            watch.off[k] = -abs(watch.off[k])
        watch.last[k], watch.changed[k], watch.expected[k] = reading, time, said
        watch.repeats[k] = 0.0
        if not change >= 0.0:
            continue
        watch.rise[k] = rise
        watch.turned[k] += ((1.0 if rise * before < 0.0 else 0.0) - watch.turned[k]) / rules.seen
        finest = watch.finest[k]
        if finest >= 0.0:
            ratio = max(change, finest) / min(change, finest)
            watch.grain[k] += (abs(ratio - np.rint(ratio)) - watch.grain[k]) / rules.seen
        watch.finest[k] = min(change, finest) if finest >= 0.0 else change


def _contradicted(sample: Sample, explain: Explain, trusted: Flags, rules: Thresholds) -> Flags:
    """Channels that the others and the model contradict, the worst first; shape (n,)."""
    innovation = sample.readings - sample.predicted
    found = np.zeros_like(trusted)
    at = np.flatnonzero(trusted)
    if certainly_alike(innovation[at], rules):
        return found
    imperfect = model_error(sample.predicted, rules)
    while at.size:
        rest, covariance = explain(innovation, at)
        whole = covariance + np.diag(imperfect**2)
        inverse = np.linalg.inv(whole[np.ix_(at, at)])
        # What the others leave open in i is r = (S^-1 nu)_i / (S^-1)_ii, of variance 1 / (S^-1)_ii.
        relative = np.abs(inverse @ rest[at]) / np.sqrt(np.diag(inverse))
        worst = int(np.argmax(relative))
        if relative[worst] <= rules.gate:
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
