"""Confidence band from parameter uncertainty, learned on machines with the same responses.

Parameters are drawn from the posterior of the calibration, and for each draw the discrepancy is
fitted to the calibration runs, so that all drawn machines have the same responses. Each then runs
through histories of heat while the observer estimates its displacement from its temperatures. The
error is approximated by a sum of the relaxed heat, known at every sample, and of its squares: the
error of a machine with another convection coefficient is proportional to the heat and grows with
time, that of one with another joint to the square of the heat. The mean square of these sums over
the draws, plus their residual, is the band.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.stats import t as student

from calibrate.joint_aware.assembling import observer_from_rest
from calibrate.joint_aware.misfit import (
    SIGMAS,
    Problem,
    Run,
    errors,
    fit_linear,
    largest_displacement,
    physics_with,
    searched,
)
from calibrate.joint_aware.physics_fit import SEARCH, Fit, problem_of
from calibrate.joint_aware.random_heat import random_course, random_levels
from estimator import sensor_faults
from estimator.joint_aware.band import WIDTH
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.filter_design import NOISE, Noise
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_model import Band, Calibrated, ObserverModel
from estimator.joint_aware.observer_state import KNOWN
from estimator.joint_aware.thresholds import Thresholds
from fesim.axes.axis import gone_along
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.reduced.discrepancy import COUNT, Discrepancy, make_ridge, relaxed
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.parameters import LAG_UNIT, factors_of
from thermojoint.reduced.physics import (
    JointState,
    at_start,
    displaced,
    march_known,
    settle_joint,
    simulate_known,
)


@dataclass(frozen=True)
class Drawing:
    """Machines and histories from which a band is learned (docs/joint-aware.md, on the bands)."""

    #: Least number of drawn machines, one for each parameter if there are more; the seed of them
    #: and of the histories.
    draws: int = 12
    seed: int = 1
    #: Length of the random history and steps, s.
    duration: float = 8 * 3600.0
    step: float = 20.0
    #: Highest level, relative to the largest heat calibrated.
    beyond: float = 1.5
    #: Gains that the data do not determine are as large as those that they do, but at least this
    #: fraction of the assumed model error.
    least_share: float = 0.1
    #: Fraction of the largest mean square below which all errors count the same in the band.
    floor: float = 1e-4
    #: A fit assumes model errors this many times larger than it needs to (`misfit`), so that
    #: persistent errors do not bias the parameters. The machines are drawn as if it assumed the
    #: actual ones: this only reduces the uncertainty in directions that the data determine.
    assumed: float = 2.0
    #: Tolerated residual of an error's approximation, relative to its largest value.
    rough: float = 0.02


#: The default.
USUAL = Drawing()
#: Where temperatures differ from the model's for ten minutes by a fraction of their largest values
#: in the runs, the displacement is assumed to differ by this part of that fraction, as a standard
#: deviation.
DOUBTED = 0.8
#: The gain that no run shows is assumed this many times as large as all others together.
SLOWLY = 1.3
#: Least temperature rise with which a thermometer counts, relative to that of the warmest.
FAR = 0.1
#: Drawn machines have no faulty sensors: an onset of heat within one of their steps is no fault.
HEALTHY = Thresholds(faults=sensor_faults.Thresholds(gate=1e6, jump=1e6, stuck=1e9), room=1e6)


def variance_of_heat(model: ObserverModel) -> Array:
    """Return the variance of the displacement that a band expects after hours of heat 1, m2."""
    heat = np.ones(model.power.size * model.discrepancy.rates.size)
    means = np.zeros(3 * model.band.surprise.shape[1])
    parts = Observer(model).model_error(heat, KNOWN, means)
    return np.asarray(model.band.steady + np.square(parts).sum(axis=1))


def open_band(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    model: ObserverModel,
    noise: Noise = NOISE,
    drawing: Drawing = USUAL,
) -> Band:
    """Return the band of an observer, including the uncertainty of its calibration.

    Parameters
    ----------
    machine : ReducedMachine
        As described by its case.
    runs : sequence of Run
        Calibration runs.
    fit : Fit
        Parameters, discrepancy, and their uncertainty.
    model : ObserverModel
        The observer of this fit.
    noise : Noise
        As for `observer_from_rest`.
    drawing : Drawing
        Number of machines, and their histories.
    """
    slow = on_longer_steps(machine, runs, model.calibrated, fit, noise, drawing)
    rng, step = np.random.default_rng(drawing.seed), slow.machine.step
    highest, sources = drawing.beyond * model.calibrated.heat, machine.power.size
    day = random_levels(rng, drawing.duration, step, highest, sources)
    # The day hardly contains the beginning of a warm-up.
    shortest = min(run.length * len(run.inputs) for run in runs)
    begun = np.full((max(1, round(shortest / step)), sources), highest)
    moves = np.random.default_rng(drawing.seed)
    histories = [
        history_of(heat, fit.discrepancy.rates, step, _course(moves, len(heat), slow.machine))
        for heat in (day, begun, 0.5 * begun)
    ]
    errors_of_draws = drawn_errors(rng, slow, histories, drawing)
    every = errors_of_draws.transpose(2, 0, 1)
    features = np.vstack([history.features for history in histories])
    ends = np.cumsum([len(history.heat) for history in histories])[:-1]
    weights = np.array(
        [[_explained(features, error, ends, drawing) for error in axis] for axis in every]
    )
    # With few draws the variance is uncertain: use Student's quantile in place of the normal one.
    weights *= float(student.ppf(0.975, len(errors_of_draws))) / WIDTH
    claimed = np.mean((weights @ features.T) ** 2, axis=1)
    squares = np.vstack([history.squares for history in histories])
    more = [shortfall(squares, *axis, drawing.floor) for axis in zip(claimed, every, strict=True)]
    slips, drives = _pasts(slow.observer, slow.machine, histories[0])
    return replace(
        model.band,
        history=slips,
        drive=drives,
        open=weights,
        square=unlike_its_case(slow) + np.array(more),
        surprise=surprise_of(runs, fit.doubt),
    )


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted machine on the longer steps of a band, with its runs and its observer."""

    machine: ReducedMachine
    problem: Problem
    fit: Fit
    observer: JointAware


def on_longer_steps(
    machine: ReducedMachine,
    runs: Sequence[Run],
    calibrated: Calibrated,
    fit: Fit,
    noise: Noise,
    drawing: Drawing,
) -> Fitted:
    """Return a fit to `runs`, its machine and its observer on the steps of `drawing`.

    They are multiples of the machine's own steps, into which those of a run can be joined.
    """
    own = machine.step
    slow = replace(machine, step=own * math.ceil(drawing.step / own - 1e-9))
    observer = JointAware(observer_from_rest(slow, fit, calibrated, noise), thresholds=HEALTHY)
    problem = problem_of(slow, searched(machine, runs, SEARCH.steps), fit)
    return Fitted(slow, problem, fit, observer)


def unlike_its_case(fitted: Fitted) -> Array:
    """Return the variance of errors that no run shows, per square of the relaxed heat, (axes, q).

    The slowest relaxation has no gain, as no run lasts long enough for it. A machine of the family
    needs none. One with residuals beyond its parameters is given an unknown gain of the size that
    all others are assumed to have together (`SLOWLY`), in proportion to these residuals. Heat that
    no run shows need not displace the machine as its sources do: every axis gets the mean of all.
    """
    unknown = np.zeros((len(fitted.machine.axes), fitted.problem.rates.size))
    gains = np.mean(np.square([channel.tau for channel in fitted.problem.displacement]))
    unknown[:, -1] = (1.0 - fitted.fit.doubt**-2) * SLOWLY**2 * COUNT * gains
    return unknown


def surprise_of(runs: Sequence[Run], doubt: float) -> Array:
    """Return the variance of an error per square of a lasting innovation, m2/K2, (axes, p + 1).

    Errors of temperatures and of the displacement due to the same unknown heat are assumed to be
    equal fractions of the largest values, in the mean of the axes. All thermometers have the same
    weight, the ambient has none. Machines of the posterior have lasting innovations, too, whose
    errors are already in the band.

    Parameters
    ----------
    runs : sequence of Run
        Calibration runs.
    doubt : float
        Of the fit: at 1 the machine is one of the posterior.
    """
    moved = largest_displacement(runs)
    sensed = np.max([np.abs(run.temperature).max(axis=0) for run in runs], axis=0)
    sensed = np.maximum(sensed, FAR * sensed.max())
    size = (1.0 - doubt**-2) * DOUBTED**2 * np.mean(np.square(moved))
    per_reading = np.append(size / (sensed.size * np.square(sensed)), 0.0)
    return np.tile(per_reading, (moved.size, 1))


def drawn_errors(
    rng: np.random.Generator, fitted: Fitted, histories: Sequence[History], drawing: Drawing
) -> Array:
    """Return the errors of an observer in histories of machines of its posterior.

    Returns
    -------
    ndarray, shape (draws, n, axes)
        m; the histories one after the other.

    Raises
    ------
    ConvergenceError
        None of the machines can be marched.
    """
    found: list[Array] = []
    for drawn in draw_machines(rng, fitted.problem, fitted.fit, drawing):
        try:
            found.append(np.vstack([errors_on(fitted, drawn, history) for history in histories]))
        except ConvergenceError:
            continue
    if not found:
        raise ConvergenceError(
            "band: no machine like the calibrated one can be marched; check the case"
        )
    return np.array(found)


@dataclass(frozen=True, eq=False)
class History:
    """Heat (n, s), its relaxations (n, s q), features of errors (n, f), and mean squares (n, q).

    And the positions of x moving axes, m, (n, x).
    """

    heat: Array
    states: Array
    features: Array
    squares: Array
    course: Array


def history_of(heat: Array, rates: Array, step: float, course: Array) -> History:
    """Return a history on steps of `step` (s).

    Parameters
    ----------
    heat : ndarray, shape (n, s)
        Relative to the reference.
    rates : ndarray, shape (q,)
        Of the discrepancy, 1/s.
    step : float
        s.
    course : ndarray, shape (n, x)
        Positions of the x moving axes, m.
    """
    states = relaxed(heat, rates, step)
    squares = np.square(states.reshape(len(heat), heat.shape[1], -1)).mean(axis=1)
    return History(heat, states, np.hstack([states, states**2]), squares, course)


def _course(rng: np.random.Generator, steps: int, machine: ReducedMachine) -> Array:
    """Random positions of the axis that a machine may have, (n, x)."""
    if machine.guide is None:
        return np.zeros((steps, 0))
    return random_course(rng, steps, machine.step, machine.guide.way)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A machine with the same calibration runs as the fitted one."""

    factors: dict[str, float]
    discrepancy: Discrepancy
    offset: Array


def _pasts(observer: JointAware, machine: ReducedMachine, history: History) -> tuple[Array, Array]:
    """Mean squares of the displacement by past slips and by warm drives, m2, (axes,) each."""
    physics = observer.observer.physics
    inputs = machine.inputs(history.heat * machine.power, history.course)
    marched = march_known(physics, inputs, machine.step)
    loads = np.tile(physics.modes.factors, (len(inputs), 1))
    loads[:, loads.shape[1] - history.course.shape[1] :] = history.course
    joint, joints, probes = physics.at_rest(), list[JointState](), np.empty_like(marched.probes)
    for k, (now, acting) in enumerate(zip(marched.amplitudes, loads, strict=True)):
        joint, probes[k] = settle_joint(physics, joint, now, acting)
        joint = joint._replace(slip=physics.rest.slip)
        joints.append(joint)
    every = JointState(*map(np.array, zip(*joints, strict=True)))
    others = (
        marched._replace(probes=probes, joint=every),
        marched._replace(drive=np.zeros_like(marched.drive)),
    )
    moved, without, cold = (displaced(physics, one) for one in (marched, *others))
    slips, drives = (np.square(moved - other).mean(axis=0) for other in (without, cold))
    return slips, drives


def _directions(rng: np.random.Generator, draws: int, size: int) -> Array:
    """Return draws (draws, size) of a standard normal distribution whose covariance is exact."""
    drawn = rng.normal(size=(draws, size))
    left, _, right = np.linalg.svd(drawn, full_matrices=False)
    return np.asarray(np.sqrt(draws) * (left @ right))


def draw_machines(
    rng: np.random.Generator, problem: Problem, fit: Fit, drawing: Drawing = USUAL
) -> Iterator[Drawn]:
    """Yield machines of the posterior, as many as there are parameters or `drawing.draws`.

    Parameters
    ----------
    rng : Generator
        Draws them.
    problem : Problem
        The runs of the fit.
    fit : Fit
        Parameters, discrepancy, and their uncertainty.
    drawing : Drawing
        Number of machines, and the assumed errors.
    """
    count = sum(_open(fit))
    for along in _directions(rng, max(drawing.draws, count), count):
        try:
            yield _draw(rng, problem, fit, along, drawing)
        except ConvergenceError:
            continue


def _open(fit: Fit) -> list[bool]:
    """Parameters that are drawn, (k,): an error of a lag is over within minutes."""
    return [not parameter.name.endswith(LAG_UNIT) for parameter in fit.parameters]


def _draw(
    rng: np.random.Generator, problem: Problem, fit: Fit, along: Array, drawing: Drawing
) -> Drawn:
    drawn = _open(fit)
    _, singular, directions = np.linalg.svd(fit.jacobian[:, drawn], full_matrices=False)
    known = along / np.sqrt(1.0 + (drawing.assumed * singular) ** 2)
    coordinates = fit.coordinates.copy()
    coordinates[drawn] += fit.spread[drawn] * (known @ directions)
    # Discrepancy and offsets compensate the effect of the parameters in the runs.
    moved = [
        fit_linear(problem, *errors(problem, fit.parameters, at))
        for at in (coordinates, fit.coordinates)
    ]
    sensed = [np.column_stack([fitted.discrepancy.temperature, fitted.offset]) for fitted in moved]
    constant = np.column_stack([problem.states, np.ones(len(problem.states))])
    own = np.column_stack([fit.discrepancy.temperature, fit.offset])
    temperature = own + sensed[0] - sensed[1]
    displacement = (
        fit.discrepancy.displacement
        + moved[0].discrepancy.displacement
        - moved[1].discrepancy.displacement
    )
    # Factor by which the fit assumes errors too large, given its doubt.
    assumed = drawing.assumed / problem.doubt
    sensed_sigma = SIGMAS.discrepancy_temperature / assumed
    for row in temperature:
        tau = _size(row[:-1], SIGMAS.discrepancy_temperature, drawing.least_share)
        shape = np.append(tau * problem.shape, SIGMAS.offset)
        row += _unknown(rng, constant, shape, sensed_sigma)
    moved_sigma = SIGMAS.discrepancy_displacement / assumed
    for row, seen, channel in zip(displacement, problem.seen, problem.displacement, strict=True):
        tau = _size(row, SIGMAS.discrepancy_displacement, drawing.least_share)
        row += _unknown(rng, seen, tau * problem.shape, channel.weight * moved_sigma)
    return Drawn(
        factors_of(fit.parameters, coordinates),
        Discrepancy(problem.rates, temperature[:, :-1], displacement),
        temperature[:, -1],
    )


def _size(gains: Array, sigma: float, least_share: float) -> float:
    return max(float(np.sqrt(np.mean(gains**2))), least_share * sigma)


def _unknown(rng: np.random.Generator, states: Array, shape: Array, sigma: float) -> Array:
    """Posterior covariance factor of gains on `states` with priors like `shape`."""
    root = make_ridge(states, shape).uncertainty(sigma, 1.0)
    return np.asarray(root @ rng.normal(size=root.shape[1]))


def errors_on(fitted: Fitted, drawn: Drawn, history: History) -> Array:
    """Return the errors (n, axes), m, of an observer on a drawn machine."""
    machine, observer = fitted.machine, fitted.observer
    physics = physics_with(machine, drawn.factors)
    count = len(history.heat)
    inputs = machine.inputs(history.heat * machine.power, history.course)
    temperature, displacement = simulate_known(physics, inputs, machine.step)
    temperature = drawn.offset + temperature + history.states @ drawn.discrepancy.temperature.T
    displacement = displacement + history.states @ drawn.discrepancy.displacement.T
    readings = np.vstack([drawn.offset + at_start(physics)[0], temperature])
    times = machine.step * np.arange(count + 1)
    # An ambient of 0 K, loads as at the start.
    first = physics.modes.factors
    others = np.tile(np.append(0.0, first[: len(machine.load_names)]), (count + 1, 1))
    course = np.vstack([first[first.size - history.course.shape[1] :], history.course])
    counted = gone_along(course)[:, list(observer.model.counted)]
    samples = np.column_stack([times, readings, others, course, counted])
    return np.asarray(observer.displacements(samples)[1:] - displacement)


def _explained(features: Array, error: Array, ends: Array, drawing: Drawing) -> Array:
    """Return the weights (f,) of features (n, f) that explain an error (n,), regularised.

    Every history (they end at `ends`) is scaled by its own largest error; otherwise the residual of
    the day would count as an error of the first minutes.
    """
    least = np.finfo(float).tiny
    scale = np.maximum(np.abs(features).max(axis=0), least)
    size = float(np.abs(error).max())
    if size <= 0.0:
        return np.zeros(scale.size)
    own = np.concatenate(
        [
            np.full(part.size, max(np.abs(part).max(), drawing.floor * size))
            for part in np.split(error, ends)
        ]
    )
    ridge = make_ridge(features / scale / own[:, None] * size, np.ones(scale.size))
    weights, _ = ridge.gains(error / own, drawing.rough, 1.0)
    return np.asarray(weights * size / scale)


def shortfall(squares: Array, claimed: Array, errors: Array, floor: float) -> Array:
    """Return coefficients (q,) of squares (n, q) for mean square errors beyond `claimed`, (n,).

    `errors` has the shape (draws, n); every sample is weighted relative to its claimed variance.
    """
    mean = np.mean(errors**2, axis=0)
    size = float(mean.max())
    if size <= 0.0:
        return np.zeros(squares.shape[1])
    scale = np.maximum(squares.max(axis=0), np.finfo(float).tiny)
    weight = 1.0 / np.maximum(claimed, floor * size)
    short = np.maximum(mean - claimed, 0.0)
    coefficients = nnls(squares / scale * weight[:, None], short * weight)[0] / scale
    return np.asarray(coefficients)
