"""Innovation gate: readings used by the observer, and the knowledge left without the others.

Start at `trusted`, the only judge of a sample. It takes three steps:

1. A jump that is not yet judged is followed for another sample (`_followed`, `suspicion`).
2. The channels are judged (`sensor_faults.judge_sample`), a jump of the heat being no contradiction
   (`_unexplained`). Where most contradict, it is the state that is wrong: then nothing is taken to
   be known, and they are judged again.
3. Where a channel is newly left out that saw most of a source, that source's heat is unknown: it
   may have changed just then (`_heat_unknown`). A jump of a channel that is used becomes a
   suspicion.

A usual sample, on which all of this has no effect, is taken in machine code (`compiled_sample`).
Proved by tests/test_faulty_readings.py: every fault in every sensor of a machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware import fault_isolation
from estimator.joint_aware.fault_isolation import Judgement, PendingJump
from estimator.joint_aware.filter_design import compressed
from estimator.joint_aware.observer import Expected, Observer
from estimator.joint_aware.observer_state import UNKNOWN, ObserverState
from estimator.sensor_faults import Channels, Sample, Watch, judge_sample, model_error
from thermojoint.artefacts.arrays import Array, Flags


@dataclass(frozen=True, eq=False)
class Trusted:
    """Readings used of a sample.

    Attributes
    ----------
    believed : ndarray of bool, shape (p + 1,)
        Readings to be used.
    watch : Watch
        Of every channel, after the sample.
    suspicion : PendingJump
        After the sample.
    expected : Expected
        What they are to correct.
    """

    believed: Flags
    watch: Watch
    suspicion: PendingJump
    expected: Expected


@dataclass(frozen=True)
class Moment:
    """When a sample comes.

    Attributes
    ----------
    time : float
        s.
    length : float
        Of a step since the sample before, s.
    steps : int
        Number of these; 0 at the first sample.
    """

    time: float
    length: float
    steps: int


def trusted(
    observer: Observer,
    before: ObserverState,
    expected: Expected,
    moment: Moment,
    readings: Array,
    channels: Channels,
) -> Trusted:
    """Say which readings of a sample are used.

    Parameters
    ----------
    observer : Observer
        Whose sample it is.
    before : ObserverState
        After the sample before.
    expected : Expected
        At this one.
    moment : Moment
        When it comes.
    readings : ndarray, shape (p + 1,)
        K; NaN where there is none.
    channels : Channels
        What the readings can say (`channels_of`).
    """
    rules, watch = observer.thresholds.faults, before.watch
    open_, judgement = _followed(observer, before, moment, readings)
    if judgement in (Judgement.OFFSET, Judgement.SPIKE):
        expected = expected._replace(linear=open_.linear)
    if judgement is Judgement.OFFSET:
        channel = int(open_.channel)
        said = observer.system.rows[channel] @ open_.linear
        watch = _distrusting(watch, channel, moment.time, abs(float(readings[channel] - said)))
    if judgement is not Judgement.OPEN:
        open_ = fault_isolation.none(expected.linear.size)
    rows = observer.system.rows
    lost = expected._replace(excess=observer.model.warm, memory=UNKNOWN)
    for attempt in (expected, lost):
        verdict = judge_sample(
            watch,
            Sample(moment.time, readings, rows @ attempt.linear),
            partial(_unexplained, observer, attempt, moment),
            channels,
            rules,
        )
        if not verdict.lost:
            break
    if np.isfinite(open_.channel) and verdict.watch.distrusted[int(open_.channel)]:
        attempt = attempt._replace(linear=open_.linear)
        open_ = fault_isolation.none(expected.linear.size)
    newly = _believed_before(before) & ~verdict.believed
    if newly.any():
        attempt = _heat_unknown(observer, attempt, newly, verdict.believed)
    innovation = np.where(verdict.believed, readings - rows @ attempt.linear, 0.0)
    imperfect = model_error(rows @ attempt.linear, rules)
    jumps = bool((np.abs(innovation) > rules.gate * imperfect).any())
    if jumps and not np.isfinite(open_.channel):
        own = np.diag(observer.innovation_covariance(attempt.excess))
        limit = rules.gate * np.sqrt(own + imperfect**2)
        elapsed = moment.steps * moment.length or observer.model.step
        open_ = fault_isolation.suspected(attempt.linear, innovation, limit, moment.time, elapsed)
    return Trusted(verdict.believed, verdict.watch, open_, attempt)


def channels_of(observer: Observer, limits: tuple[Array, Array]) -> Channels:
    """Return what the readings of an observer can say; `limits` are the calibrated ones, K."""
    known, (low, high) = observer.thresholds, limits
    return Channels(
        noise=np.minimum(np.sqrt(observer.model.filter.noise), known.thermometer),
        low=low - known.room,
        high=high + known.further * (high - low) + known.room,
        thermometers=len(observer.model.sensors),
    )


def _followed(
    observer: Observer, before: ObserverState, moment: Moment, readings: Array
) -> tuple[PendingJump, Judgement]:
    """A jump that is not yet judged, this sample counted, and what it was."""
    known = before.suspicion
    if not np.isfinite(known.channel):
        return known, Judgement.OPEN
    channel = int(known.channel)
    alone = observer.expected(before._replace(linear=known.linear), moment.length, moment.steps)
    known = known._replace(linear=alone.linear, samples=known.samples + 1.0)
    if readings[channel] == before.watch.last[channel] and before.watch.repeats[channel] > 0.0:
        # It may be stuck: that takes longer to be seen.
        return known, Judgement.OPEN
    said = observer.system.rows[channel] @ alone.linear
    departure, rules = float(readings[channel] - said), observer.thresholds
    limit = rules.faults.gate * float(model_error(said, rules.faults))
    # The source that the reading sees most of.
    answers = observer.onset[:, channel]
    answer = answers[:, int(np.argmax(np.abs(answers[-1])))]
    elapsed = moment.time - float(known.since)
    due = elapsed >= rules.decided and known.samples >= rules.samples
    expected = fault_isolation.growth(known, elapsed, answer, observer.model.step)
    return known, fault_isolation.judged(known, departure, limit, bool(due), expected)


def _believed_before(before: ObserverState) -> Flags:
    """Channels that the sample before had; before the first sample all count."""
    read = np.isnan(before.time) | (before.watch.read == before.time)
    return np.asarray((before.watch.distrusted == 0.0) & read)


def _distrusting(watch: Watch, channel: int, time: float, off: float) -> Watch:
    """The watch with one more channel distrusted, that is off by so much (K)."""
    changed = {"distrusted": 1.0, "fault": time, "off": off}
    arrays = {name: getattr(watch, name).copy() for name in changed}
    for name, value in changed.items():
        arrays[name][channel] = value
    return watch._replace(**arrays)


def _heat_unknown(
    observer: Observer, expected: Expected, newly: Flags, believed: Flags
) -> Expected:
    """The same with any heat of the sources of which a lost channel saw more than all others."""
    power, scale = observer.model.power, observer.model.filter.scale
    answers = np.abs(observer.onset[0])
    lost = answers[newly].max(axis=0) > answers[believed].max(axis=0, initial=0.0)
    if not lost.any():
        return expected
    unknown = np.zeros((observer.system.size, power.size))
    unknown[observer.system.decay.size :][: power.size] = np.diag(
        np.where(lost, observer.model.calibrated.heat * power, 0.0)
    )
    more = np.hstack([expected.excess, unknown])
    return expected._replace(excess=compressed(more, scale, expected.excess.shape[1]))


def _unexplained(
    observer: Observer,
    expected: Expected,
    moment: Moment,
    innovation: Array,
    at: NDArray[np.int64],
) -> tuple[Array, Array]:
    """What no possible change of the heat explains; as `sensor_faults.Explain`."""
    covariance = observer.innovation_covariance(expected.excess)
    if expected.memory == UNKNOWN:
        # The state is still a guess: what lasts in the readings may be all that it is made of.
        covariance = covariance + np.diag(observer.model.filter.lasting)
    power = observer.model.power
    heat = expected.linear[observer.system.decay.size :][: power.size]
    known = observer.thresholds
    most = known.onset * observer.model.calibrated.heat * power
    slack = known.onset_slack * most
    bounds = (np.minimum(-heat, 0.0) - slack, np.maximum(most - heat, 0.0) + slack)
    # Before the first sample a source may have been on for a step.
    onset = observer.onset[min(max(moment.steps, 1), len(observer.onset)) - 1]
    return fault_isolation.without_heat(innovation, at, covariance, onset, bounds), covariance
