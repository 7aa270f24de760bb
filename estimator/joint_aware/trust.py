"""Which readings of a sample an observer uses, and what it takes to be known where some are not.

`sensor_faults` judges a sample by itself, `suspicion` a jump by the samples after it. Where most
readings contradict, it is the state that is wrong: then nothing is taken to be known. Where one is
newly left out that saw most of a source, that source's heat is: it may have changed just then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware import suspicion
from estimator.joint_aware.filter_design import compressed
from estimator.joint_aware.observer import ANSWER, Expected, Observer
from estimator.joint_aware.observer_state import UNKNOWN, ObserverState
from estimator.joint_aware.suspicion import Judgement, Suspicion
from estimator.sensor_faults import GATE, Watch, judge_sample, model_error
from thermojoint.artefacts.arrays import Array, Flags

#: A reading is impossible further than this beyond the calibrated ones, K; above them also by this
#: many times their range.
ROOM, FURTHER = 60.0, 3.0
#: Noise of a thermometer, K, at most.
THERMOMETER = 0.05
#: The heat may jump to this many times the largest calibrated, and a part of that more or below 0.
ONSET, SLACK = 1.5, 0.05


@dataclass(frozen=True, eq=False)
class Trusted:
    """What is used of a sample.

    Attributes
    ----------
    believed : ndarray of bool, shape (p + 1,)
        Readings to be used.
    watch : Watch
        Of every channel, after the sample.
    suspicion : Suspicion
        After the sample.
    expected : Expected
        What they are to correct.
    """

    believed: Flags
    watch: Watch
    suspicion: Suspicion
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
    limits: tuple[Array, Array],
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
    limits : pair of ndarray, shape (p + 1,)
        Lowest and highest calibrated reading, K.
    """
    watch = before.watch
    open_, judgement = _followed(observer, before, moment, readings)
    if judgement in (Judgement.OFFSET, Judgement.SPIKE):
        expected = expected._replace(linear=open_.linear)
    if judgement is Judgement.OFFSET:
        channel = int(open_.channel)
        said = observer.system.rows[channel] @ open_.linear
        watch = _distrusting(watch, channel, moment.time, abs(float(readings[channel] - said)))
    if judgement is not Judgement.OPEN:
        open_ = suspicion.none(expected.linear.size)
    rows = observer.system.rows
    noise = thermometer_noise(observer)
    lost = expected._replace(excess=observer.model.warm, memory=UNKNOWN)
    for attempt in (expected, lost):
        verdict = judge_sample(
            watch,
            moment.time,
            readings,
            rows @ attempt.linear,
            partial(_unexplained, observer, attempt, moment),
            noise,
            possible(limits),
            len(observer.model.sensors),
        )
        if not verdict.lost:
            break
    if np.isfinite(open_.channel) and verdict.watch.distrusted[int(open_.channel)]:
        attempt = attempt._replace(linear=open_.linear)
        open_ = suspicion.none(expected.linear.size)
    newly = _believed_before(before) & ~verdict.believed
    if newly.any():
        attempt = _heat_unknown(observer, attempt, newly, verdict.believed)
    innovation = np.where(verdict.believed, readings - rows @ attempt.linear, 0.0)
    imperfect = model_error(rows @ attempt.linear)
    jumps = bool((np.abs(innovation) > GATE * imperfect).any())
    if jumps and not np.isfinite(open_.channel):
        own = np.diag(observer.innovation_covariance(attempt.excess))
        deviation = np.sqrt(own + imperfect**2)
        elapsed = moment.steps * moment.length or observer.model.step
        open_ = suspicion.suspected(attempt.linear, innovation, deviation, moment.time, elapsed)
    return Trusted(verdict.believed, verdict.watch, open_, attempt)


def thermometer_noise(observer: Observer) -> Array:
    """Return the noise of every thermometer, K, shape (p + 1,).

    The filter's own holds what the model errs by, too.
    """
    return np.minimum(np.sqrt(observer.model.filter.noise), THERMOMETER)


def possible(limits: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the lowest and highest reading that can be one, K, of the calibrated ones."""
    low, high = limits
    return low - ROOM, high + FURTHER * (high - low) + ROOM


def _followed(
    observer: Observer, before: ObserverState, moment: Moment, readings: Array
) -> tuple[Suspicion, Judgement]:
    """A jump that is not yet judged, this sample counted, and what it was."""
    known = before.suspicion
    if not np.isfinite(known.channel):
        return known, Judgement.OPEN
    channel = int(known.channel)
    alone = observer.expected(replace(before, linear=known.linear), moment.length, moment.steps)
    known = known._replace(linear=alone.linear, samples=known.samples + 1.0)
    if readings[channel] == before.watch.last[channel] and before.watch.repeats[channel] > 0.0:
        # It may be stuck: that takes longer to be seen.
        return known, Judgement.OPEN
    said = observer.system.rows[channel] @ alone.linear
    departure, imperfect = float(readings[channel] - said), float(model_error(said))
    # The source that the reading sees most of.
    answers = observer.onset[:, channel]
    answer = answers[:, int(np.argmax(np.abs(answers[-1])))]
    return known, suspicion.judged(
        known, departure, moment.time, imperfect, answer, observer.model.step
    )


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
    most = ONSET * observer.model.calibrated.heat * power
    slack = SLACK * most
    bounds = (np.minimum(-heat, 0.0) - slack, np.maximum(most - heat, 0.0) + slack)
    # Before the first sample a source may have been on for a step.
    onset = observer.onset[min(max(moment.steps, 1), ANSWER) - 1]
    return suspicion.without_heat(innovation, at, covariance, onset, bounds), covariance
