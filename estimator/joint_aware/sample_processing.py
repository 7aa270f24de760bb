"""Processing of one sample: predict, gate, correct, solve.

`process` is the whole of it. `process_ordinary` is the part in compiled code, `process_any` the
general rule.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.joint_aware import (
    compiled_sample,
    displacement_readings,
    odometers,
    power_readings,
    unreported_motion,
)
from estimator.joint_aware.compiled_sample import Results, empty_results
from estimator.joint_aware.displacement_readings import mean_of
from estimator.joint_aware.innovation_gate import GatedSample, gate_readings
from estimator.joint_aware.observer import Moment, Observer
from estimator.joint_aware.observer_state import Absences, ObserverState, unpacked
from estimator.joint_aware.precomputed import Precomputed
from estimator.joint_aware.sample_values import SampleValues
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError

#: Longest gap that counts, s. Heat of before a week has no effect any more; the steps of a longer
#: gap would be so long that heat of its last hours was overlooked.
_LONGEST_GAP_S = 604_800.0
#: Clocks of loggers jitter: an interval may exceed whole steps by this part of a step before it is
#: divided into one more, and one that differs from a step by less than `SAME` of it counts as one.
_LONGER, SAME = 0.25, 1e-3


class Processed(NamedTuple):
    """Result of processing a sample."""

    #: State after the sample.
    after: ObserverState
    #: Shape (axes,): before corrections by innovations and displacement readings, m.
    displacement: Array
    #: Knowledge of the joint's slips before the sample.
    slip_knowledge: float
    #: Shape (p + 1,): readings that were used.
    accepted: Flags
    #: Whether a displacement reading was refused.
    refused: bool
    #: Sampling interval in steps of the model.
    often: int


def process(
    data: Precomputed, state: Array, time: float, read: SampleValues
) -> tuple[Array, Processed]:
    """Return the state after a sample, and the result of processing it.

    Parameters
    ----------
    data : Precomputed
        Of the observer.
    state : ndarray
        After the previous sample; it is not modified.
    time : float
        s, later than that of the previous sample.
    read : SampleValues
        Values of the sample.
    """
    observer, layout = data.observer, data.layout
    if read.powers.size:
        state = state.copy()
        power_readings.change_heat(observer, unpacked(state, layout), read.powers)
    flat = state.copy()
    after = unpacked(flat, layout)
    moment = moment_of(observer, float(after.time), time)
    stood = observer.place(after.loads).copy()
    # A missing factor keeps its last value.
    now = after.loads[: read.factors.size]
    now[:] = np.where(np.isnan(read.factors), now, read.factors)
    travelled, reset = odometers.count(observer, after, read.odometers, stood, moment.elapsed)
    processed = process_ordinary(data, after, moment, read)
    if processed is None:
        before = unpacked(state, layout)
        before = before._replace(odometer=after.odometer, odometer_age=after.odometer_age)
        moment = replace(moment, loads=after.loads, travelled=travelled)
        processed = process_any(data, odometers.after_reset(before, reset), moment, read)
        flat = processed.after.flat()
    if (unread := np.isnan(read.powers)).any():
        before, after = unpacked(state, layout), unpacked(flat, layout)
        power_readings.attribute_heat(observer, before, after, unread)
    return flat, processed


def moment_of(observer: Observer, last: float, time: float) -> Moment:
    """Return the time of a sample relative to the last one (s); NaN before the first.

    Raises
    ------
    InputError
        Time does not increase.
    """
    step, thresholds = observer.model.step, observer.thresholds
    if not math.isfinite(time):
        raise InputError(f"time {time:.15g} s is not a time; drop the sample")
    if math.isnan(last):
        return Moment(time, 0.0, 0)
    if not time > last:
        raise InputError(
            f"time {time:.15g} s does not come after {last:.15g} s; drop or re-order the sample"
        )
    elapsed = min(time - last, _LONGEST_GAP_S)
    steps = min(max(1, math.ceil(elapsed / step - _LONGER)), thresholds.most_steps)
    length = elapsed / steps
    near = abs(length - step) <= SAME * step
    return Moment(time, step if near else length, steps)


def process_ordinary(
    data: Precomputed, state: ObserverState, moment: Moment, read: SampleValues
) -> Processed | None:
    """Process an ordinary sample in compiled code, in place; None if it is not one."""
    if data.place is None or moment.steps != 1 or moment.length != data.observer.model.step:
        return None
    if not np.isnan(read.displacements).all():
        return None
    readings = read.temperatures
    results, times = empty_results(1, data.sizes), np.array([moment.time])
    if not compiled_sample.ordinary_samples(
        data.place, state, times, moment.length, readings[None], results
    ):
        return None
    state.steps[()] = 1.0
    slip_knowledge, everything = float(state.slip_knowledge), np.ones(readings.size, dtype=bool)
    return Processed(state, results.displacement[0], slip_knowledge, everything, False, 1)


def process_any(
    data: Precomputed, before: ObserverState, moment: Moment, read: SampleValues
) -> Processed:
    """Process any sample."""
    observer, readings, probed = data.observer, read.temperatures, read.displacements
    prediction = observer.predict(before, moment)
    used = gate_readings(observer, before, prediction, moment, readings, data.readable)
    (linear, errors), factor = _corrected(observer, used, moment, readings)
    prediction = used.prediction
    settled = observer.equilibrium(prediction, linear, moment.loads)
    elapsed = moment.time - float(before.time) if moment.steps else 0.0
    begun = before.begun if moment.steps else np.array(moment.time)
    absences = _absences(data, before, moment, read, bool(used.accepted.all()))
    reported, positions = 2 * len(observer.model.ways), slice(2 * len(observer.model.ways), None)
    error = displacement_readings.later(before.model_error, elapsed, data.forgetting)
    refused = False
    if np.isfinite(probed).any():
        means = used.watch.means
        since = moment.time - float(begun)
        parts = observer.model_error(settled.relaxed, prediction.slip_knowledge, means, since)
        apart = probed - settled.displacement - observer.displacement_by(means)
        correction = displacement_readings.correct_by(
            apart - parts @ mean_of(error),
            observer.thresholds.probe,
            observer.model.band,
            parts,
            factor,
            error,
        )
        size, factor = linear.size, correction.covariance_factor
        linear, errors = linear + correction.state[:size], errors + correction.state[size:]
        error, refused = correction.known, correction.refused
        settled = observer.equilibrium(prediction, linear, moment.loads)
    after = ObserverState(
        time=np.array(moment.time),
        begun=begun,
        slip_knowledge=np.array(observer.slip_knowledge_after(prediction.slip_knowledge, factor)),
        linear=linear,
        loads=moment.loads,
        **settled.joint._asdict(),
        covariance_factor=factor,
        errors=errors,
        drive=prediction.drive,
        odometer=before.odometer,
        power_heat=before.power_heat,
        watch=used.watch,
        model_error=error,
        pending=used.pending,
        steps=np.array(float(moment.steps)),
        odometer_age=before.odometer_age,
        away=absences.away[:reported],
        back=absences.back[:reported],
        position_away=absences.away[positions],
        position_back=absences.back[positions],
    )
    slips, often = prediction.slip_knowledge, _often(before, moment)
    return Processed(after, settled.displacement, slips, used.accepted, refused, often)


def _often(before: ObserverState, moment: Moment) -> int:
    """Sampling interval in steps: one long interval is a gap, two in a row are the interval."""
    return min(moment.steps, int(before.steps) or moment.steps)


def _corrected(
    observer: Observer, used: GatedSample, moment: Moment, readings: Array
) -> tuple[tuple[Array, Array], Array]:
    """The linear state, the errors, and their covariance factor after the used readings."""
    at, prediction, size = np.flatnonzero(used.accepted), used.prediction, observer.system.size
    length = moment.length if moment.steps else observer.model.step
    gain, factor = observer.gain(
        at, prediction.covariance_factor, length, prediction.slip_knowledge
    )
    moved = gain @ (readings - observer.readings(prediction))[at]
    return (prediction.linear + moved[:size], prediction.errors + moved[size:]), factor


def _absences(
    data: Precomputed, before: ObserverState, moment: Moment, read: SampleValues, whole: bool
) -> Absences:
    """`unreported_motion.absences_after`; the table is made at the first absence.

    In a gap of more than two sampling intervals no position is read either.
    """
    last, positions = before.absences, len(before.position_away)
    elapsed, often = moment.elapsed, _often(before, moment)
    gap = moment.length * (moment.steps - often) if moment.steps > 2 * often else 0.0
    unplaced = np.isnan(read.factors[read.factors.size - positions :])
    unread = elapsed * (before.odometer_age > 0.0)
    missing = np.concatenate([unread, np.zeros_like(unread), np.where(unplaced, elapsed, gap)])
    if not (last.away.any() or missing.any()) or (motion := data.unreported_motion) is None:
        return Absences(np.zeros_like(last.away), np.zeros_like(last.away))
    longest = motion.back[-1] * data.observer.model.step
    return unreported_motion.absences_after(last, missing, elapsed * whole, longest)


def results_of(observer: Observer, processed: Processed) -> Results:
    """Return the results of a sample that was processed alone."""
    after = processed.after
    return Results(processed.displacement, after.linear[observer.relaxations], after.watch.means)
