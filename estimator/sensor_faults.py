"""Sensor fault detection by range, rate, repetition and innovation.

Start at `judge_sample`: it judges a sample before it is used. A channel is distrusted when it is

- impossible: the temperature cannot occur in a machine;
- too fast: it changed faster than any part of a machine can;
- stuck: it repeats its last value much longer than before, or it should have changed according to
  the model;
- contradicted: its innovation, given the other channels, is larger than expected.

The first three are detected by `update_watch`, channel by channel; the last by `_contradicted`, the
worst channel first. A channel is trusted again after `Thresholds.clear` without a fault; one that
was contradicted must have approached the model by more than the model can have approached it, and
stay there for `Thresholds.agreed`. If most channels contradict the model, the model's state is
wrong (`Verdict.lost`): then all are trusted.

Verified by tests/estimator/test_sensor_faults.py, one rule at a time and without a machine, and by
``python -m benchmarks.sensor_faults`` on the reference machine (docs/faulty-sensors.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled, compiled_part
from thermojoint.artefacts.arrays import Array, Flags

#: From the innovations (n,), K, and the indices of the channels that count: the part that no
#: admissible change of heat explains, K, shape (n,), and its covariance, K2, shape (n, n).
Explain = Callable[[Array, NDArray[np.int64]], tuple[Array, Array]]


class Thresholds(NamedTuple):
    """Thresholds at which a channel is distrusted, and trusted again.

    Set and checked together by ``python -m benchmarks.sensor_faults``: 128 faults over 35 min, of
    which 126 are tolerated, and 64 over 8 h, of which 63 are (docs/faulty-sensors.md). The effect
    of a single threshold is stated with it.
    """

    #: Innovation gate in standard deviations, beyond which a reading is contradicted.
    gate: float = 5.0
    #: Model error of a healthy reading as a standard deviation, K, and as a fraction of the model's
    #: own one: no innovation below `gate` times it counts, however certain the model is.
    model_error: float = 0.2
    model_share: float = 0.01
    #: A distrusted channel is trusted again after this time without a fault, s.
    clear: float = 30.0
    #: A contradicted channel is trusted again after this time near the model, s: a jump of the heat
    #: brings a wrong reading near it until the other channels have seen that heat. With 30 s, 59 of
    #: the 64 faults over 8 h are tolerated.
    agreed: float = 300.0
    #: It counts as near if its error is at most this fraction of the original one, or this many
    #: standard deviations of the model: a model that has lost a channel drifts. Without this rule
    #: and those for `witnesses`, 119 of the 128 faults are tolerated.
    nearer: float = 0.25
    near: float = 1.0
    #: If it has jumped back by this fraction of its error, the usual gate decides whether it is
    #: near.
    jumped_back: float = 0.5
    #: No thermometer in a machine changes faster than this, K/s, beyond a jump, K.
    rate: float = 2.0
    jump: float = 3.0
    #: A value that repeats for this time, s, and this many samples may be stuck, ...
    stuck: float = 12.0
    repeats: float = 4.0
    #: ... if the channel's usual behaviour makes that as unlikely as this, or more, ...
    improbable: float = 1e-6
    #: ... and its display is not coarse: it has changed by less than its noise, or its changes have
    #: been, on average, this far from multiples of one step, over this many changes; ...
    grain: float = 0.005
    seen: float = 10.0
    #: ... or if according to the model it should have moved by this many steps or standard
    #: deviations.
    steps: float = 4.0
    #: A channel that never changed is also stuck if this many others reverse in this fraction of
    #: their changes, as noise does, and it would usually have changed.
    witnesses: float = 2.0
    reversing: float = 0.25
    #: Assumed step of a display that has not shown any yet, K.
    unknown_step: float = 0.25
    #: Initial repetition rate of a channel, and the samples over which it is learned.
    repeat_rate: float = 0.5
    learnt: float = 50.0
    #: Changes below this are ignored, K.
    rounding: float = 1e-9
    #: Time over which innovations are averaged, s: new heat is found within it, so that an
    #: innovation that remains after it is an error of the model.
    lasts: float = 600.0
    #: Times over which these means are averaged again, s: the effect of a model error on the
    #: displacement depends on its duration.
    longer: float = 3600.0
    longest: float = 4.0 * 3600.0


class Channels(NamedTuple):
    """Prior knowledge of the channels; arrays of shape (n,), K."""

    #: Standard deviation of a reading.
    noise: Array
    #: Lowest and highest possible reading.
    low: Array
    high: Array
    #: Number of channels, the first ones, that are thermometers in the machine; others may be
    #: constant.
    thermometers: int


class Sample(NamedTuple):
    """A sample and the prediction for it."""

    #: s.
    time: float
    #: Shape (n,): readings, K; NaN where missing.
    readings: Array
    #: Shape (n,): K.
    predicted: Array


class Watch(NamedTuple):
    """Memory of every channel; arrays of shape (n,), NaN where unknown."""

    #: 1 if it is excluded, else 0.
    distrusted: Array
    #: Time of its last fault, s.
    fault: Array
    #: Time of its last reading, s.
    read: Array
    #: Its last reading, K.
    last: Array
    #: Time since which it has had this value, s.
    changed: Array
    #: Prediction of the model at that time, K.
    expected: Array
    #: Number of repetitions since.
    repeats: Array
    #: Fraction of its readings that repeat the previous one.
    repeat_rate: Array
    #: Smallest change so far, K.
    finest: Array
    #: Mean distance of its changes from multiples of that, relative to it: 0 for a coarse display.
    grain: Array
    #: Its last change, K.
    rise: Array
    #: Fraction of its changes that reverse: none for a smooth signal, two thirds for pure noise.
    reversal_rate: Array
    #: Its error when the model contradicted it, K; negative once it has jumped back.
    off: Array
    #: Mean of its innovations over the last ten minutes, each at most `gate` times the model error,
    #: K; constant while the channel is distrusted.
    lasting: Array
    #: Means of `lasting` over the last hour and the last four, K.
    longer: Array
    longest: Array

    @property
    def means(self) -> Array:
        """Means of the innovations: of all channels over ten minutes, then longer, (3 n,), K."""
        return np.concatenate([self.lasting, self.longer, self.longest])


def new_watch(channels: int, rules: Thresholds) -> Watch:
    """Return a watch without any memory."""
    nothing, unknown = np.zeros(channels), np.full(channels, np.nan)
    return Watch(*[unknown] * len(Watch._fields))._replace(
        distrusted=nothing,
        repeats=nothing,
        repeat_rate=np.full(channels, rules.repeat_rate),
        grain=nothing,
        reversal_rate=nothing,
        lasting=nothing,
        longer=nothing,
        longest=nothing,
    )


class Verdict(NamedTuple):
    """Verdict on the readings of a sample."""

    #: Shape (n,): readings to be used.
    accepted: Flags
    #: Most channels contradict the model: its state is wrong.
    lost: bool
    #: Memory for the next sample.
    watch: Watch


def judge_sample(
    watch: Watch, sample: Sample, explain: Explain, channels: Channels, rules: Thresholds
) -> Verdict:
    """Judge which readings of a sample are to be used."""
    time, readings, predicted = sample
    present = np.isfinite(readings)
    seen = Watch(*np.array(watch))
    invalid, near = np.empty_like(present), np.empty_like(present)
    update_watch(seen, sample, channels, rules, invalid, near)
    doubted = watch.distrusted > 0.0
    credible = present & ~invalid
    contradicted = _contradicted(sample, explain, credible & ~doubted, rules)
    if not (invalid.any() or doubted.any() or contradicted.any()):
        return Verdict(present, False, seen)
    first = not np.isfinite(watch.read).any()
    lost = bool(contradicted.any()) and majority_doubtful(contradicted | doubted, credible, first)
    if lost:
        faulty, doubted = invalid, doubted & ~credible
    else:
        faulty = invalid | contradicted | (doubted & present & ~near)
    fault = np.where(faulty, time, seen.fault)
    wait = np.where(np.isfinite(seen.off), rules.agreed, rules.clear)
    distrusted = faulty | (doubted & (~present | (time - fault < wait)))
    off = np.where(contradicted & ~doubted, np.abs(readings - predicted), seen.off)
    after = seen._replace(
        distrusted=distrusted.astype(float), fault=fault, off=np.where(distrusted, off, np.nan)
    )
    return Verdict(present & ~distrusted, lost, after)


def model_error(predicted: Array, rules: Thresholds) -> Array:
    """Return the standard deviation of the model error of healthy readings, K, shape (n,)."""
    return np.asarray(rules.model_error + rules.model_share * np.abs(predicted))


@compiled
def certainly_consistent(innovation: Array, rules: Thresholds) -> bool:
    """Whether innovations are so small, K, that none is a contradiction for any covariance.

    No statistic of a contradiction or a jump exceeds |innovation| / `model_error`.
    """
    return math.sqrt(np.dot(innovation, innovation)) <= rules.gate * rules.model_error


@compiled_part
def _stuck(watch: Watch, channel: int, sample: Sample, noise: float, rules: Thresholds) -> bool:
    """Whether a channel repeats its last value although it should not."""
    repeats, finest = watch.repeats[channel], watch.finest[channel]
    if repeats < rules.repeats or sample.time - watch.changed[channel] < rules.stuck:
        return False
    unlike = repeats * math.log(max(watch.repeat_rate[channel], 1e-300)) < math.log(
        rules.improbable
    )
    if unlike and (finest < noise or watch.grain[channel] > rules.grain):
        return True
    step = max(finest, noise) if finest >= 0.0 else max(rules.unknown_step, noise)
    return abs(sample.predicted[channel] - watch.expected[channel]) > rules.steps * step


@compiled_part
def _silent(watch: Watch, channel: int, thermometers: int, rules: Thresholds) -> bool:
    """Whether a channel has never changed although others have noise."""
    if channel >= thermometers or watch.finest[channel] >= 0.0:
        return False
    witnesses, repeat_rate = 0, 0.0
    for k in range(thermometers):
        if k == channel or watch.distrusted[k] > 0.0 or watch.reversal_rate[k] < rules.reversing:
            continue
        witnesses += 1
        repeat_rate = max(repeat_rate, watch.repeat_rate[k])
    likelihood = watch.repeats[channel] * math.log(max(repeat_rate, 1e-300))
    return witnesses >= rules.witnesses and likelihood < math.log(rules.improbable)


@compiled
def update_watch(
    watch: Watch, sample: Sample, channels: Channels, rules: Thresholds, invalid: Flags, near: Flags
) -> None:
    """Update the watch by a sample, in place; set `invalid` if faulty, `near` if near the model."""
    time, readings, predicted = sample.time, sample.readings, sample.predicted
    for k in range(readings.size):
        reading, expected = readings[k], predicted[k]
        invalid[k] = near[k] = False
        if not np.isfinite(reading):
            continue
        imperfect = rules.model_error + rules.model_share * abs(expected)
        limit = rules.gate * imperfect
        if watch.off[k] >= 0.0:
            limit = min(limit, max(rules.near * imperfect, rules.nearer * watch.off[k]))
        near[k] = abs(reading - expected) <= limit
        change, since = abs(reading - watch.last[k]), time - watch.read[k]
        # Comparisons with unknown values, NaN, find no fault.
        invalid[k] = reading < channels.low[k] or reading > channels.high[k]
        invalid[k] = invalid[k] or change > rules.rate * since + rules.jump
        if watch.distrusted[k] == 0.0 and since > 0.0 and not invalid[k]:
            most = rules.gate * imperfect
            innovation = min(max(reading - expected, -most), most)
            watch.lasting[k] += since / (since + rules.lasts) * (innovation - watch.lasting[k])
            mean = watch.lasting[k]
            watch.longer[k] += since / (since + rules.longer) * (mean - watch.longer[k])
            watch.longest[k] += since / (since + rules.longest) * (mean - watch.longest[k])
        watch.read[k] = time
        if change <= rules.rounding:
            watch.repeats[k] += 1.0
            invalid[k] = invalid[k] or _stuck(watch, k, sample, channels.noise[k], rules)
            invalid[k] = invalid[k] or _silent(watch, k, channels.thermometers, rules)
            continue
        run = watch.repeats[k] + 1.0
        kept = (1.0 - 1.0 / rules.learnt) ** run
        watch.repeat_rate[k] = kept * watch.repeat_rate[k] + (1.0 - kept) * watch.repeats[k] / run
        rise, before = reading - watch.last[k], watch.rise[k]
        if change >= rules.jumped_back * abs(watch.off[k]):
            watch.off[k] = -abs(watch.off[k])
        watch.last[k], watch.changed[k], watch.expected[k] = reading, time, expected
        watch.repeats[k] = 0.0
        if not change >= 0.0:
            continue
        watch.rise[k] = rise
        watch.reversal_rate[k] += (
            (1.0 if rise * before < 0.0 else 0.0) - watch.reversal_rate[k]
        ) / rules.seen
        finest = watch.finest[k]
        if finest >= 0.0:
            ratio = max(change, finest) / min(change, finest)
            watch.grain[k] += (abs(ratio - np.rint(ratio)) - watch.grain[k]) / rules.seen
        watch.finest[k] = min(change, finest) if finest >= 0.0 else change


def _contradicted(sample: Sample, explain: Explain, trusted: Flags, rules: Thresholds) -> Flags:
    """Channels contradicted by the others and the model, the worst first; shape (n,)."""
    innovation = sample.readings - sample.predicted
    contradicted = np.zeros_like(trusted)
    at = np.flatnonzero(trusted)
    if certainly_consistent(innovation[at], rules):
        return contradicted
    imperfect = model_error(sample.predicted, rules)
    while at.size:
        rest, covariance = explain(innovation, at)
        whole = covariance + np.diag(imperfect**2)
        inverse = np.linalg.inv(whole[np.ix_(at, at)])
        # The part of i that the others leave unexplained is r = (S^-1 nu)_i / (S^-1)_ii, of
        # variance 1 / (S^-1)_ii.
        relative = np.abs(inverse @ rest[at]) / np.sqrt(np.diag(inverse))
        worst = int(np.argmax(relative))
        if relative[worst] <= rules.gate:
            break
        contradicted[at[worst]] = True
        at = np.delete(at, worst)
    return contradicted


def majority_doubtful(doubtful: Flags, credible: Flags, first: bool) -> bool:
    """Whether more than half of the channels, and more than one, are doubtful.

    At the first sample more than one is enough: a wrong initial state is then more likely than two
    simultaneous faults.
    """
    most = 1.0 if first else max(1.0, 0.5 * credible.sum())
    return bool((doubtful & credible).sum() > most)
