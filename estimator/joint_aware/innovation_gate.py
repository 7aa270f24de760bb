"""Innovation gate: which readings the observer uses, and its covariance without the others.

Start at `gate_readings`, which judges a sample in three steps:

1. A pending jump is followed for another sample (`_followed`, `fault_isolation`).
2. The channels are judged (`sensor_faults.judge_sample`); an admissible jump of the heat is no
   contradiction (`_unexplained`). If most channels contradict the model, the state is wrong: then
   it is taken as unknown, and they are judged again.
3. If a newly excluded channel was the most sensitive one to a source, that source's heat is
   unknown: it may have changed at the same moment (`heat_unknown`). A jump of a channel that is
   used becomes a pending jump.

An ordinary sample, on which none of this has an effect, is processed in compiled code
(`compiled_sample`). Verified by tests/estimator/joint_aware/test_faulty_readings.py: every fault in
every sensor of a machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware import fault_isolation
from estimator.joint_aware.fault_isolation import Judgement, PendingJump
from estimator.joint_aware.filter_design import compressed
from estimator.joint_aware.observer import Moment, Observer, Prediction
from estimator.joint_aware.observer_state import UNKNOWN, ObserverState
from estimator.joint_aware.thresholds import Thresholds
from estimator.sensor_faults import Channels, Sample, Watch, judge_sample, model_error
from estimator.span import SLACK
from thermojoint.artefacts.arrays import Array, Flags


@dataclass(frozen=True, eq=False)
class GatedSample:
    """Usable readings of a sample."""

    #: Shape (p + 1,): readings to be used.
    accepted: Flags
    #: Memory of every channel, after the sample.
    watch: Watch
    #: Pending jump after the sample.
    pending: PendingJump
    #: Prediction to be corrected by them.
    prediction: Prediction


def gate_readings(
    observer: Observer,
    before: ObserverState,
    prediction: Prediction,
    moment: Moment,
    readings: Array,
    channels: Channels,
) -> GatedSample:
    """Return the usable readings of a sample.

    Parameters
    ----------
    observer : Observer
        Observer of the machine.
    before : ObserverState
        State after the previous sample.
    prediction : Prediction
        Prediction for this one.
    moment : Moment
        Time of the sample.
    readings : ndarray, shape (p + 1,)
        K; NaN where missing.
    channels : Channels
        Prior knowledge of the channels (`gated_channels`).
    """
    rules, watch = observer.thresholds.faults, before.watch
    open_, judgement = _followed(observer, before, moment, readings)
    if judgement in (Judgement.OFFSET, Judgement.SPIKE):
        prediction = prediction._replace(linear=open_.linear)
    if judgement is Judgement.OFFSET:
        channel = int(open_.channel)
        predicted = observer.readings(prediction)[channel]
        watch = _distrusting(watch, channel, moment.time, abs(float(readings[channel] - predicted)))
    if judgement is not Judgement.OPEN:
        open_ = fault_isolation.none(prediction.linear.size)
    lost = prediction._replace(
        covariance_factor=observer.unknown_start,
        errors=np.zeros_like(prediction.errors),
        slip_knowledge=UNKNOWN,
    )
    for attempt in (prediction, lost):
        verdict = judge_sample(
            watch,
            Sample(moment.time, readings, observer.readings(attempt)),
            partial(_unexplained, observer, attempt, moment),
            channels,
            rules,
        )
        if not verdict.lost:
            break
    if np.isfinite(open_.channel) and verdict.watch.distrusted[int(open_.channel)]:
        attempt = attempt._replace(linear=open_.linear)
        open_ = fault_isolation.none(prediction.linear.size)
    newly = _accepted_before(before) & ~verdict.accepted
    if newly.any():
        factor = heat_unknown(observer, attempt.covariance_factor, newly, verdict.accepted)
        attempt = attempt._replace(covariance_factor=factor)
    predicted = observer.readings(attempt)
    innovation = np.where(verdict.accepted, readings - predicted, 0.0)
    imperfect = model_error(predicted, rules)
    jumps = bool((np.abs(innovation) > rules.gate * imperfect).any())
    if jumps and not np.isfinite(open_.channel):
        own = np.diag(observer.innovation_covariance(attempt.covariance_factor))
        limit = rules.gate * np.sqrt(own + imperfect**2)
        elapsed = moment.steps * moment.length or observer.model.step
        open_ = fault_isolation.pending_jump(
            attempt.linear, innovation, limit, moment.time, elapsed
        )
    return GatedSample(verdict.accepted, verdict.watch, open_, attempt)


def gated_channels(observer: Observer, limits: tuple[Array, Array]) -> Channels:
    """Return the prior knowledge of an observer's channels; `limits` are the calibrated ones, K."""
    known = observer.thresholds
    low, high = possible_readings(limits, known)
    return Channels(
        noise=np.minimum(np.sqrt(observer.model.filter.noise), known.thermometer),
        low=low,
        high=high,
        thermometers=len(observer.model.sensors),
    )


def calibrated_readings(observer: Observer) -> tuple[Array, Array]:
    """Return the calibrated range of every channel, K."""
    model, ambient = observer.model, observer.thresholds.ambient
    low, high = np.array([model.calibrated.temperatures[name] for name in model.sensors]).T
    slack = np.maximum(SLACK * (high - low), 3.0 * np.sqrt(model.filter.noise[:-1]))
    low, high = low - slack - model.offset, high + slack - model.offset
    return np.append(low, -ambient), np.append(high, ambient)


def possible_readings(limits: tuple[Array, Array], known: Thresholds) -> tuple[Array, Array]:
    """Return the lowest and highest possible readings; `limits` are the calibrated ones, K."""
    low, high = limits
    return low - known.room, high + known.further * (high - low) + known.room


def _followed(
    observer: Observer, before: ObserverState, moment: Moment, readings: Array
) -> tuple[PendingJump, Judgement]:
    """A pending jump with this sample counted, and its cause."""
    known = before.pending
    if not np.isfinite(known.channel):
        return known, Judgement.OPEN
    channel = int(known.channel)
    alone = observer.predict(before._replace(linear=known.linear), moment)
    known = known._replace(linear=alone.linear, samples=known.samples + 1.0)
    if readings[channel] == before.watch.last[channel] and before.watch.repeats[channel] > 0.0:
        # It may be stuck, which takes longer to detect.
        return known, Judgement.OPEN
    predicted = observer.readings(alone)[channel]
    departure, rules = float(readings[channel] - predicted), observer.thresholds
    limit = rules.faults.gate * float(model_error(predicted, rules.faults))
    elapsed = moment.time - float(known.since)
    due = elapsed >= rules.decided and known.samples >= rules.samples
    expected = fault_isolation.growth(
        known, elapsed, observer.dominant_response[channel], observer.model.step
    )
    return known, fault_isolation.judged(known, departure, limit, bool(due), expected)


def _accepted_before(before: ObserverState) -> Flags:
    """Channels of the previous sample; all of them before the first sample."""
    read = np.isnan(before.time) | (before.watch.read == before.time)
    return np.asarray((before.watch.distrusted == 0.0) & read)


def _distrusting(watch: Watch, channel: int, time: float, off: float) -> Watch:
    """The watch with one more distrusted channel, which is wrong by `off` (K)."""
    changed = {"distrusted": 1.0, "fault": time, "off": off}
    arrays = {name: getattr(watch, name).copy() for name in changed}
    for name, value in changed.items():
        arrays[name][channel] = value
    return watch._replace(**arrays)


def heat_unknown(observer: Observer, factor: Array, newly: Flags, accepted: Flags) -> Array:
    """Return the covariance factor with unknown heat of sources that excluded channels saw best.

    Parameters
    ----------
    observer : Observer
        Observer of the machine.
    factor : ndarray, shape (n + p + 1, k)
        Before.
    newly, accepted : ndarray of bool, shape (p + 1,)
        Channels that are excluded from now on, and those that are used.
    """
    power = observer.model.power
    answers = np.abs(observer.peak_innovation)
    lost = answers[newly].max(axis=0) > answers[accepted].max(axis=0, initial=0.0)
    if not lost.any():
        return factor
    unknown = np.zeros((observer.rows.shape[1], power.size))
    unknown[observer.heat] = np.diag(np.where(lost, observer.model.calibrated.heat * power, 0.0))
    more = np.hstack([factor, unknown])
    return compressed(more, observer.augmented.scale, factor.shape[1])


def _unexplained(
    observer: Observer,
    prediction: Prediction,
    moment: Moment,
    innovation: Array,
    at: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Part of the innovations that no possible change of heat explains: `sensor_faults.Explain`."""
    covariance = observer.innovation_covariance(prediction.covariance_factor)
    if prediction.slip_knowledge == UNKNOWN:
        # The state is still a guess: it may result from lasting errors of the readings alone.
        covariance = covariance + np.diag(observer.model.filter.lasting)
    heat = prediction.linear[observer.heat]
    onset, most, slack = possible_heat(observer, moment.steps)
    bounds = (np.minimum(-heat, 0.0) - slack, np.maximum(most - heat, 0.0) + slack)
    return fault_isolation.without_heat(innovation, at, covariance, onset, bounds), covariance


def possible_heat(observer: Observer, steps: int) -> tuple[Array, Array, Array]:
    """Return the effect of a change of heat since the sample `steps` before, and its bounds.

    Returns
    -------
    onset : ndarray, shape (p + 1, s)
        Change of the readings per W of each source, K/W.
    most, slack : ndarray, shape (s,)
        Largest heat of each source, and tolerance beyond it or below zero, W.
    """
    known, model = observer.thresholds, observer.model
    most = known.heat_jump * model.calibrated.heat * model.power
    # A source may have been on for one step before the first sample.
    onset = observer.step_response[min(max(steps, 1), len(observer.step_response)) - 1]
    slower = np.abs(observer.peak_innovation).max(axis=0) > np.abs(onset).max(axis=0)
    return np.where(slower, observer.peak_innovation, onset), most, known.heat_jump_slack * most
