"""Export of the joint-aware estimator, with a bounded number of Newton steps.

Predict, judge the readings, correct, settle, read, as `sample_processing` and `sample_estimate` do.
Where a reading is left out, the program has no covariance but uses the gain that the observer
reaches without it; the band is looked up, then and after the reading returns. The header of the
program lists the differences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache, partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from estimator.export import erfc
from estimator.export.program import (
    RELATIVE,
    Contents,
    Interface,
    Operations,
    Precision,
    Table,
    Variable,
    distinct,
    listed,
    no_lines,
    solving,
)
from estimator.interface import Status
from estimator.joint_aware import guided_program
from estimator.joint_aware.band import WIDENED, WIDTH
from estimator.joint_aware.dropouts import (
    Dropouts,
    doubled,
    factor_of,
    left_by_dropouts,
    onward,
    with_gain,
)
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.guided_program import Placed, kernel_of
from estimator.joint_aware.innovation_gate import heat_unknown
from estimator.joint_aware.model_file import fingerprint
from estimator.joint_aware.observer import ANSWER, Observer
from estimator.joint_aware.observer_model import Band
from estimator.joint_aware.observer_state import KNOWN
from estimator.span import SETTLING, SLACK
from fesim.march.compiled_step import JointKernel
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.discrepancy import relaxed
from thermojoint.reduced.physics import heat_step, simulate_known

#: Status bits that no estimator in Python has.
READING_JUMPED, NOT_SETTLED = 1 << 13, 1 << 14
#: Most Newton steps with a line search, and how often one is halved; then most damped steps
#: (pseudo-transient continuation: Kelley & Keyes 1998).
ITERATIONS, HALVINGS, DAMPED_STEPS = 12, 6, 24
#: Damping of the first of these, relative to the Jacobian of a joint that sticks. From one to the
#: next it changes by the ratio of the residuals, within bounds.
DAMPING, LEAST_RATIO, MOST_RATIO = 0.1, 0.25, 4.0
#: How long one reading, or all, are left out to compute the gain and the band without them, s.
WITHOUT_ONE, WITHOUT_ALL = 600.0, 1800.0
#: Passes over the sources that find the heat behind a jump.
SWEEPS = 20
#: Longest effect of an unknown past, s. Its gains change twice in every octave of time, and once
#: until this number of samples.
LONGEST_START, FEW = 7.0 * 86400.0, 64
#: Tolerance of the gap equations in single precision, m: below it is rounding.
SINGLE_TOLERANCE = 2e-11
#: Samples of the self-test if none are recorded, and its load: relative to the largest calibrated,
#: the share of the period that is on, and the period, in samples.
SAMPLES, LOAD, ON, PERIOD = 2000, 0.6, 0.6, 800
_STATUSES = (
    Status.BEYOND_TIME,
    Status.BEYOND_HEAT,
    Status.BEYOND_TEMPERATURE,
    Status.READING_MISSING,
)
#: Those of readings that are left out, for which only Python has a covariance.
_APPROXIMATE = (Status.UNSETTLED, Status.SENSOR_DISTRUSTED, Status.READINGS_LOST)


def contents(estimator: JointAware, precision: Precision) -> Contents:
    """Return the program contents of a joint-aware estimator.

    Raises
    ------
    InputError
        The joints have no compiled law, or there are none; a moving axis cannot be exported
        (`guided_program`).
    """
    kernel = kernel_of(estimator.observer.physics)
    if kernel is None or not kernel.preload.size:
        raise InputError(
            "export: the machine has no joint, or one whose law is not a surface or Back-Burdekin "
            "with a power law of the conductance; run it with 'thermojoint estimate'"
        )
    modes, rest = estimator.model.modes, estimator.observer.physics.rest
    moving = len(estimator.model.moving_axes)
    acts = modes.factors.size > moving or estimator.model.surfaces
    if acts or modes.start.any() or rest.gap.any():
        raise InputError(
            "export: the machine has loads, bolts, initial or held temperatures or a joint without "
            "preload; run it with 'thermojoint estimate'"
        )
    tolerance = kernel.tolerance * (guided_program.CLOSER if moving else 1.0)
    if precision is Precision.SINGLE:
        tolerance = max(tolerance, SINGLE_TOLERANCE)
    model, faults = estimator.model, estimator.thresholds.faults
    way = (guided_program.guided if moving else _standing)(estimator, kernel)
    tables = _tables(estimator, kernel, tolerance, way)
    linear, contacts = estimator.observer.system.size, kernel.preload.size
    axes, draws, _ = model.band.open.shape
    fixed = _every_sample(estimator, linear) + Operations(20, 20, 8, 8).times(axes)
    # The present position, and every position asked for.
    places = 1 + way.values["asked"]
    usual = _newton(contacts, contacts, 0).times(2) + _look(contacts)
    searched = _newton(contacts, 3 * contacts, HALVINGS).times(ITERATIONS)
    damped = _newton(contacts, 3 * contacts, 0).times(DAMPED_STEPS)
    worst = searched + damped + _look(contacts).times(2)
    count = len(estimator.observer.system.rows)
    start = _start(estimator)
    slowest = 1.0 / float(model.modes.rates.min())
    counted = 2 * len(model.ways) + (moving if model.ways else 0)
    motion = estimator.precomputed.unreported_motion
    cases = 0 if motion is None else len(motion.left)
    own = way.state + counted + len(model.powers) + moving + 2 * cases
    looked_up = (2 + axes) * (count + 1 + cases)
    judged = _judging(estimator, linear, contacts)
    judged += Operations(0, 6 * len(start.known) + looked_up)
    return Contents(
        estimator,
        _interface(estimator),
        values={
            "readings": count,
            "sources": distinct(model.sources, "sources"),
            "jumped": READING_JUMPED,
            "not_settled": NOT_SETTLED,
            "jump": faults.gate * faults.model_error,
            "faults": faults,
            "log_improbable": math.log(faults.improbable),
            "log_kept": math.log1p(-1.0 / faults.learnt),
            "decided": estimator.thresholds.decided,
            "due": float(estimator.thresholds.samples),
            "lost": estimator.thresholds.lost,
            "settling": SETTLING * min(slowest, model.calibrated.duration_s),
            "answer": ANSWER,
            "sweeps": SWEEPS,
            "linear": linear,
            "contacts": contacts,
            "modes": model.modes.rates.size,
            "rates": model.discrepancy.rates.size,
            "draws": draws,
            "means": model.band.seen.size,
            "explained": 1.0 - float(model.band.allowed),
            "starts": len(start.known),
            "unreported": () if motion is None else motion.left.shape,
            "calibrated_heat": model.calibrated.heat,
            "absences": _without(estimator).uncertainty.left.shape,
            "error_kept": estimator.observer.lasting_on(model.step),
            "followed": start.followed,
            "iterations": ITERATIONS,
            "halvings": HALVINGS,
            "damped_steps": DAMPED_STEPS,
            "damping": DAMPING,
            "least_ratio": LEAST_RATIO,
            "most_ratio": MOST_RATIO,
            "tables": tables,
            "indices": way.indices,
            "tolerance": tolerance,
            "erfc": _erfc(kernel, precision),
            "width": WIDTH,
            "widened": WIDENED * WIDTH,
            "most_heat": (1.0 + SLACK) * model.calibrated.heat,
            "least_heat": -SLACK * model.calibrated.heat,
            "implausible_heat": estimator.thresholds.implausible_heat * model.calibrated.heat,
            "counted": model.counted,
            "farthest": estimator.thresholds.farthest,
            "most_way": estimator.thresholds.fastest * model.step,
            "told": _told(estimator),
            "longest": (1.0 + SLACK) * model.calibrated.duration_s,
            "root2": math.sqrt(2.0),
            "root2pi": math.sqrt(2.0 * math.pi),
            # Beyond it, exp underflows (`fesim.joint.law`).
            "underflow": 700.0 if precision is Precision.DOUBLE else 80.0,
            **way.values,
        },
        constants=sum(table.values.size for table in tables),
        state=5 * linear + 44 * contacts + 9 * contacts**2 + 19 * count + 14 + own,
        usual=fixed + way.usual + usual.times(places),
        worst=fixed + way.worst + judged + worst.times(places),
        labels=("a sample of two Newton steps, nothing slides", "any sample, at most"),
        duty=lambda: _duty_cycle(estimator),
        origin="a duty cycle",
        lines=partial(guided_program.compared_in, estimator) if moving else no_lines,
        relative=guided_program.RELATIVE if moving else RELATIVE,
    )


def _interface(estimator: JointAware) -> Interface:
    model, axes = estimator.model, distinct(estimator.axes, "axes")
    given = *model.sensors, "ambient", *model.positions, *model.ways, *model.powers
    readings = distinct(given, "sensors")
    moving = bool(model.moving_axes)
    return Interface(
        kind="joint_aware",
        fingerprint=fingerprint(model),
        interval=model.step,
        timed=False,
        inputs=tuple(
            Variable(name, channel.unit, "")
            for name, channel in zip(readings, estimator.channels, strict=False)
        ),
        outputs=(
            *listed("displacement", "m", axes),
            *listed("band", "m", axes),
            *listed("heat", "W", distinct(model.sources, "sources")),
            Variable("estimated_ambient", "K", "ambient"),
            Variable("lowest_pressure", "Pa", "lowest_pressure"),
            Variable("highest_pressure", "Pa", "highest_pressure"),
            *(guided_program.outputs(estimator) if moving else ()),
        ),
        axes=axes,
        statuses=(*_STATUSES, *_APPROXIMATE),
        approximate=_APPROXIMATE,
        lines=guided_program.compared(estimator) if moving else (),
        held=guided_program.LINE_HELD if moving else 0,
    )


def _told(estimator: JointAware) -> list[dict[str, float]]:
    """For every power: index of its source, share that becomes heat, and largest value, W."""
    model = estimator.model
    return [
        {"source": model.sources.index(source), "share": share, "most": most}
        for (source, share), most in zip(
            model.power_shares.items(), estimator.precomputed.most_power.tolist(), strict=True
        )
    ]


def _erfc(kernel: JointKernel, precision: Precision) -> dict[str, Any] | None:
    """Coefficients of erfc, which Structured Text lacks, if a joint's law needs it."""
    if (kernel.laws[:, 0] != 0.0).all():
        return None
    return {
        **{name.lower(): getattr(erfc, name) for name in "ABCDPQ"},
        "inverse_root_pi": erfc.INVERSE_ROOT_PI,
        # Beyond it, the function underflows.
        "largest": 26.5 if precision is Precision.DOUBLE else 9.0,
    }


def _tables(
    estimator: JointAware, kernel: JointKernel, tolerance: float, way: Placed
) -> list[Table]:
    model, observer = estimator.model, estimator.observer
    heat = heat_step(model.modes, model.step)
    system, size = observer.system, observer.system.size
    start = _start(estimator)
    relaxing = model.step * model.discrepancy.rates / (1.0 + model.step * model.discrepancy.rates)
    known = heat.drive[:, : model.modes.drive.shape[1]]
    # decay - 1 without cancellation.
    loss = -model.step * model.modes.rates * heat.decay
    calibrated, readable = estimator.precomputed.calibrated_readings, estimator.precomputed.readable
    band = model.band
    without, motion = _without(estimator), estimator.precomputed.unreported_motion
    absence = without.uncertainty
    most = estimator.thresholds.heat_jump * model.calibrated.heat * model.power
    return [
        Table("loss", "What a mode loses in a step.", loss),
        Table("drive", "Modes per W of each source and K of the ambient.", known),
        Table("conductance", "Factor times area, W/K, hardness, Pa, exponent.", kernel.conductance),
        *way.tables,
        Table("power", "Of each source at heat input 1, W.", model.power),
        Table("relaxing", "What a relaxation gains in a step.", relaxing),
        Table("rows_read", "What the sensors read of the linear state, K.", system.rows),
        Table("start", "s after an unknown past; variance then, m2.", start.known),
        Table("history", "Of the slips before that, m2.", band.history),
        Table("gain", "Of the readings then; at the end the steady one.", start.gain[:, :size]),
        Table("error_gain", "... for what they err by at a start, K.", start.gain[:, size:]),
        Table("supposed", "One that is left out then, by the others.", start.supposed),
        Table("gain_without", "Of the others where one is left out for long.", without.gain),
        Table("briefly", "Samples for which one is supposed before that.", without.supposed),
        Table("away", "Samples that one was left out, at most.", absence.away),
        Table("back", "Samples since then, at least; 0 before.", absence.back),
        Table("remains", "Variance of each and of all then, m2.", absence.left),
        Table("tangent_of", "Displacement per state, m.", band.tangent),
        Table("noise", "Of the thermometers, K.", readable.noise),
        Table("spread", "Variance of an innovation, K2, likewise.", start.spread),
        Table("onset", "Largest innovations after 1 W, K.", observer.peak_innovation),
        Table(
            "answers", "... of the source that is seen best, later, K.", observer.dominant_response
        ),
        Table("most", "Heat that may be switched on, W.", most),
        Table("slack", "Tolerance of that, W.", estimator.thresholds.heat_jump_slack * most),
        Table("offset", "What every sensor reads too much, K.", np.append(model.offset, 0.0)),
        Table("calibrated", "Readings that were calibrated, K.", np.stack(calibrated, 1)),
        Table("possible", "Readings that can be, K.", np.stack([readable.low, readable.high], 1)),
        Table("laws", "Kind, scale, shape, start, preload, friction, stiffness.", kernel.laws),
        Table("preload", "Pa.", kernel.preload),
        Table("remainder_moved", "... per relaxation, m.", model.discrepancy.displacement),
        Table("steady", "Variance of the state after a reading, m2.", band.steady),
        Table("constant", "What the calibration left, m2.", band.constant),
        Table("squares", "... per square of the heat relaxed, m2.", band.square),
        Table("surprise", "... per square of an innovation that lasts, m2/K2.", band.surprise),
        Table("open_band", "Error of machines not told apart, m.", band.open),
        *(_days_told(band) if band.seen.size else ()),
        *(() if motion is None else _unreported_motion(motion)),
        Table("tolerance", "Of the gap equations, m.", np.array(tolerance)),
    ]


def _unreported_motion(motion: Dropouts) -> tuple[Table, Table, Table]:
    return (
        Table("away_motion", "Samples without an odometer or position, at most.", motion.away),
        Table("back_motion", "Samples since then, at least; 0 before.", motion.back),
        Table("remains_motion", "Of odometers, those set anew, positions twice, m.", motion.left),
    )


def _days_told(band: Band) -> tuple[Table, Table]:
    return (
        Table("seen", "Largest mean innovations in recorded days, K.", band.seen),
        Table("meaning", "Displacement per mean innovation, m/K.", band.told),
    )


def _standing(estimator: JointAware, kernel: JointKernel) -> Placed:
    """Return the data of the joints for the program of a machine without moving axes."""
    model, contacts = estimator.model, kernel.preload.size
    heat = heat_step(model.modes, model.step)
    modes, axes = model.modes.rates.size, len(estimator.axes)
    products = 5 * contacts * modes + 2 * contacts**2 + axes * (modes + 3 * contacts)
    own = Operations(products, products + contacts**2, 0, contacts) + solving(contacts)
    tables = [
        Table("influence", "Modes per W across each contact element.", heat.influence),
        Table("joint_influence", "Temperature jumps per W, K/W.", heat.joint_influence),
        Table("jump", "Temperature jumps per mode, K.", kernel.jump),
        Table("held", "Conductance times area that the modes have, W/K.", kernel.held),
        Table("springs", "As stiff as the joint at its preload, Pa/m.", kernel.springs),
        Table("compliance", "Gaps per traction, m/Pa.", kernel.compliance),
        Table("free_gap", "Gaps per mode, m.", kernel.gap),
        Table("reference", "Pa/m.", kernel.reference),
        Table("moved_by", "Displacement per traction, m/Pa.", kernel.moved),
        Table("free_moved", "Displacement per mode, m.", kernel.free),
    ]
    none = {"moving": 0, "drives": (), "asked": 0, "zeros": (), "seats": 0, "heated": 0, "felt": 0}
    return Placed(none, tables, [], 0, own, own)


class _Start(NamedTuple):
    """Variances and gains after a start with an unknown past."""

    #: Shape (k, 1 + axes): time, s, and from then on the variance of the displacement, m2.
    known: Array
    #: Shape (k, n + p + 1, p + 1): gain from then on, for the linear state and the errors of the
    #: readings; the last one is the steady gain.
    gain: Array
    #: Shape (k, p + 1): variance of the innovations, K2; of the steady covariance at the end.
    spread: Array
    #: Shape (k, p + 1, p + 1): expected value of each innovation, given the others, K/K. In place
    #: of a missing innovation, it makes the gain the one without that reading.
    supposed: Array
    #: From this time on, s, the joint's slips are tracked.
    followed: float


@lru_cache(maxsize=8)
def _start(estimator: JointAware) -> _Start:
    """Gains as in Python, each kept for some samples, and the covariance with them.

    With the gain K = K_s + D, where K_s is the steady one, the covariance beyond the steady one
    goes from P to (1 - K H) P (1 - K H)^T + D S D^T. It ends when slips and calibration leave more.
    """
    observer, model, limits = estimator.observer, estimator.model, estimator.thresholds
    own, rows, band = model.filter, observer.rows, model.band
    usual = observer.augmented_gain
    tangent = np.hstack([band.tangent, np.zeros((len(band.tangent), len(rows)))])
    steady = own.innovation + np.diag(own.noise)
    doubted = steady + limits.doubt_of_past**2 * np.diag(own.lasting)
    identity = np.eye(rows.shape[1])
    covariance, k = observer.unknown_start @ observer.unknown_start.T, 0
    known, gains = list[Array](), list[Array]()
    spread, supposed = list[Array](), list[Array]()
    while True:
        seen = covariance @ rows.T
        precision = np.linalg.inv(doubted + rows @ seen)
        own_gain = (seen - usual @ (rows @ seen)) @ precision
        left = identity - (usual + own_gain) @ rows
        noise = own_gain @ doubted @ own_gain.T
        after = left @ covariance @ left.T + noise
        variance = limits.doubt**2 * _moved(tangent, after)
        known.append(np.append(k * model.step, variance))
        cold = model.cold_drives(k * model.step)
        gains.append(usual + own_gain)
        spread.append(np.diag(steady + rows @ seen))
        supposed.append(_supposed(precision))
        if (
            variance + cold <= band.constant + band.history
        ).all() or k * model.step > LONGEST_START:
            break
        # The same gain for some samples: twice as many by each squaring.
        count = 1
        while 2 * count <= k // (1 if k < FEW else 2):
            count *= 2
        onward = observer.advance(left, model.step)
        noise = observer.advance(observer.advance(noise, model.step).T, model.step)
        for _ in range(count.bit_length() - 1):
            noise, onward = noise + onward @ noise @ onward.T, onward @ onward
        covariance, k = onward @ covariance @ onward.T + noise, k + count
    gains[-1], spread[-1] = usual, np.diag(steady)
    supposed[-1] = _supposed(np.linalg.inv(steady))
    every = np.array(known)
    every[:, 1:] = np.maximum.accumulate(every[::-1, 1:])[::-1]
    near = every[(every[:, 1:] <= (limits.doubt * limits.followable) ** 2).all(axis=1), 0]
    followed = float(near[0] if near.size else every[-1, 0])
    every[:, 1:] += [model.cold_drives(time) for time in every[:, 0]]
    return _Start(every, np.array(gains), np.array(spread), np.array(supposed), followed)


class _Without(NamedTuple):
    """Gains and uncertainty where readings are left out."""

    #: Shape (p + 1, n, p + 1): gain that the observer reaches without each reading.
    gain: Array
    #: Shape (p + 1,): samples of an absence before that gain is used; the missing reading is
    #: supposed to be as the others let expect meanwhile (`_Start.supposed`).
    supposed: Array
    #: Variance by absences of each and of all, m2.
    uncertainty: Dropouts


@lru_cache(maxsize=8)
def _without(estimator: JointAware) -> _Without:
    """Gains and uncertainty without each reading, and without all."""
    observer, step = estimator.observer, estimator.model.step
    every, size = np.arange(len(observer.system.rows)), observer.system.size
    away = doubled(math.ceil(WITHOUT_ALL / step))
    known, gains, supposed = _start(estimator).supposed[-1], list[Array](), list[int]()
    paths = list[list[Array]]()
    for left_out in every:
        present = every != left_out
        unknown = heat_unknown(observer, observer.known_start, ~present, present)
        early = observer.steady_gain + np.outer(observer.steady_gain[:, left_out], known[left_out])
        early[:, left_out] = 0.0
        gains.append(_reached(observer, present, unknown))
        brief, path = _changing(observer, unknown[:size], early, gains[-1])
        supposed.append(brief)
        paths.append(path)
    nothing = np.zeros_like(observer.steady_gain)
    unknown = heat_unknown(observer, observer.known_start, every >= 0, every < 0)[:size]
    alone = with_gain(observer, unknown @ unknown.T, nothing, nothing)
    paths.append(list(islice(alone, math.ceil(WITHOUT_ALL / step))))
    factors = [[factor_of(path[min(one, len(path)) - 1]) for one in away] for path in paths]
    uncertainty = left_by_dropouts(observer, away, factors)
    return _Without(np.array(gains), np.array(supposed, dtype=float), uncertainty)


def _reached(observer: Observer, present: Flags, factor: Array) -> Array:
    """Gain (n, p + 1) after only some readings were present for `WITHOUT_ONE`.

    `factor` is the covariance factor before that.
    """
    at, step = np.flatnonzero(present), observer.model.step
    gain = np.zeros_like(observer.steady_gain)
    for _ in range(math.ceil(WITHOUT_ONE / step)):
        of_present, after = observer.gain(at, factor, step, KNOWN)
        factor = observer.propagated(after, step)
    gain[:, at] = of_present[: len(gain)]
    return gain


def _changing(
    observer: Observer, unknown: Array, early: Array, late: Array
) -> tuple[int, list[Array]]:
    """Number of samples with the early gain, and the covariance after every sample of an absence.

    After a long absence the other readings must find heat that the missing one showed best. That
    gain would at first do more harm by their noise than good: it is used from when the uncertainty
    with the early one has grown to what it is in the end. `unknown` (n, k) is the covariance factor
    before the absence, which lasts for `WITHOUT_ONE`.
    """
    samples = math.ceil(WITHOUT_ONE / observer.model.step)
    start, none, more = unknown @ unknown.T, np.zeros_like(early), late - early
    *_, end = islice(with_gain(observer, start, early, more), samples)
    most = _moved(observer.model.band.tangent, end)
    path = list[Array]()
    for covariance in islice(with_gain(observer, start, early, none), samples):
        path.append(covariance)
        if (_moved(observer.model.band.tangent, covariance) >= most).any():
            break
    brief = len(path)
    then = with_gain(observer, onward(observer, path[-1]), early, more)
    return brief, [*path, *islice(then, samples - brief)]


def _moved(tangent: Array, covariance: Array) -> Array:
    """Variance of the displacement (axes,), m2, by that of states which move it by a tangent."""
    return np.asarray(((tangent @ covariance) * tangent).sum(axis=1))


def _supposed(precision: np.ndarray) -> Array:
    """Value of each innovation as the others let expect (p + 1, p + 1), by their precision."""
    return np.asarray(np.eye(len(precision)) - precision / np.diag(precision)[:, None])


def _duty_cycle(estimator: JointAware) -> Iterator[tuple[float, ...]]:
    """Yield the sensor readings of the model's machine under an intermittent load."""
    model, observer = estimator.model, estimator.observer
    at = np.arange(1, SAMPLES)
    level = LOAD * model.calibrated.heat * (at % PERIOD < ON * PERIOD)
    ambient = 0.5 * np.sin(2.0 * np.pi * at / SAMPLES)
    heat = np.repeat(level[:, None], model.power.size, axis=1)
    places = guided_program.course(model.moving_axes, SAMPLES)
    ways = guided_program.ways(places)
    inputs = np.column_stack([heat * model.power, ambient, places[1:]])
    read, _ = simulate_known(observer.physics, inputs, model.step, np.diff(ways, axis=0))
    read += relaxed(heat, model.discrepancy.rates, model.step) @ model.discrepancy.temperature.T
    rows = np.vstack([np.zeros(read.shape[1] + 1), np.column_stack([read, ambient])])
    rows[:, :-1] += model.offset
    shares = model.power_shares
    told = [model.sources.index(source) for source in shares]
    powers = np.vstack([np.zeros(len(told)), (heat * model.power)[:, told] / [*shares.values()]])
    rows = np.hstack([rows, places, ways[:, list(model.counted)], powers])
    for k, row in enumerate(rows.tolist()):
        yield (k * model.step, *row)


def _every_sample(estimator: JointAware, linear: int) -> Operations:
    """Prediction without joints, correction and band."""
    model = estimator.model
    modes, inputs = model.modes.rates.size, model.power.size + 1
    read, (axes, draws, twice) = model.offset.size + 1, model.band.open.shape
    products = modes * (1 + inputs) + linear * 2 * read
    products += axes * (twice + draws * (twice + 2) + twice + 2 * read + model.band.seen.size)
    return Operations(products, products + 8 * linear + modes * 4 + 20 * read, 2 * linear)


def _judging(estimator: JointAware, linear: int, contacts: int) -> Operations:
    """Largest cost of a faulty or missing reading beyond an ordinary sample."""
    model = estimator.model
    count, sources = len(estimator.observer.system.rows), model.power.size
    sweeps = SWEEPS if sources > 1 else 1
    heat = Operations(count * (sources + 4), count * (sources + 4), 2 * count + 1)
    excluded = heat.times(sweeps * sources) + Operations(
        count * (sources + 3), count * (sources + 4), count, count
    )
    pending = linear * (contacts + sources + count + 2 * model.band.steady.size + 6)
    look = Operations(22, 34, 9, 6).times(count) + Operations(count, count)
    return excluded.times(count + 1) + look + Operations(pending, 2 * pending, sources, 4)


def _look(contacts: int) -> Operations:
    """One evaluation of law and residual."""
    unknowns = 3 * contacts
    law = Operations(35, 15, 8, 3).times(contacts)
    return law + Operations(unknowns * (unknowns + 2), unknowns * (unknowns + 4))


def _newton(contacts: int, size: int, halvings: int) -> Operations:
    """One Newton step with this many unknowns."""
    unknowns = 3 * contacts
    build = Operations(3 * size * size + 3 * size, 2 * size * size + 4 * size)
    move = Operations(unknowns * size + unknowns, unknowns * size + unknowns)
    trial = _look(contacts) + Operations(2 * unknowns + 4, 2 * unknowns + 4, 0, 1)
    return build + solving(size) + move + trial.times(halvings + 1)
