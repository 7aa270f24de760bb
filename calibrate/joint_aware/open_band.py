"""Confidence band from parameter uncertainty, learned on machines with the same responses.

Parameters are drawn from what the calibration says of them, and the remainder is fitted to the
calibration runs beside each draw, so that every drawn machine answers them alike. It then runs
through histories of heat, and the observer follows it by its temperatures. Its error is written as
a sum of the relaxed heat, which every sample knows, and of its squares, as far as that goes: a
machine with another film errs in proportion to the heat and the longer the more, one with another
joint errs with its square. The mean square of these sums over the draws, and what they leave, is
the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.stats import t as student

from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.misfit import (
    DISCREPANCY_DISPLACEMENT,
    DISCREPANCY_TEMPERATURE,
    OFFSET,
    Problem,
    Run,
    coarser,
    errors,
    fit_linear,
    make_problem,
    physics_with,
)
from calibrate.joint_aware.physics_fit import SEARCH_STEPS, Fit
from calibrate.joint_aware.random_heat import random_levels
from estimator.interface import follow
from estimator.joint_aware.estimator import WIDTH, JointAware
from estimator.joint_aware.filter_design import Noise
from estimator.joint_aware.observer_model import Band, ObserverModel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.reduced.discrepancy import Discrepancy, make_ridge, relaxed
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.parameters import factors_of
from thermojoint.reduced.physics import conduct, settle_joint, simulate_known


@dataclass(frozen=True)
class Drawing:
    """The machines and histories that a band is learnt from (docs/joint-aware.md, on the bands).

    Attributes
    ----------
    draws, seed : int
        Drawn machines; the seed of them and of the histories.
    duration, step : float
        Length of the random history and steps, s.
    beyond : float
        Highest level, relative to the largest heat calibrated.
    least_share : float
        Gains that the data do not show are as large as those that they do, but at least this part
        of what the model is not trusted to.
    floor : float
        Part of the largest mean square below which errors are all alike to the band.
    share_left : float
        A fit trusts its model less than it need (`misfit`), lest a model that errs alike for a
        whole run bends the parameters: machines drawn from what it then says err by so much of
        their own band's share.
    rough : float
        What an error's explanation may leave, relative to its largest value.
    """

    draws: int = 12
    seed: int = 1
    duration: float = 8 * 3600.0
    step: float = 20.0
    beyond: float = 1.5
    least_share: float = 0.1
    floor: float = 1e-4
    share_left: float = 0.5
    rough: float = 0.02


#: What is drawn where nobody says otherwise.
USUAL = Drawing()


def open_band(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    model: ObserverModel,
    noise: Noise | None = None,
    drawing: Drawing = USUAL,
) -> Band:
    """Return the band of an observer with what its calibration leaves open.

    Parameters
    ----------
    machine : ReducedMachine
        As its case says.
    runs : sequence of Run
        That it was calibrated with.
    fit : Fit
        Parameters, remainder, and what is known of them.
    model : ObserverModel
        The observer of this fit.
    noise : Noise, optional
        As for `make_observer`.
    drawing : Drawing
        How many machines, and through what.
    """
    slow = replace(machine, step=max(drawing.step, machine.step))
    observer = JointAware(make_observer(slow, fit, model.calibrated, noise))
    rng = np.random.default_rng(drawing.seed)
    highest, sources = drawing.beyond * model.calibrated.heat, machine.power.size
    day = random_levels(rng, drawing.duration, slow.step, highest, sources)
    # The day hardly ever sees a machine that has just begun to be warm.
    begun = np.full(
        (round(min(run.length * len(run.inputs) for run in runs) / slow.step), sources), highest
    )
    histories = [
        _history_of(heat, fit.discrepancy.rates, slow.step) for heat in (day, begun, 0.5 * begun)
    ]
    problem = make_problem(slow, [coarser(run, SEARCH_STEPS) for run in runs])
    found: list[Array] = []
    while len(found) < drawing.draws:
        try:
            drawn = _draw(rng, problem, fit, drawing.least_share)
            found.append(np.vstack([_errors(slow, drawn, observer, one) for one in histories]))
        except ConvergenceError:
            continue
    every = np.array(found).transpose(2, 0, 1)
    features = np.vstack([one.features for one in histories])
    ends = np.cumsum([len(one.heat) for one in histories])[:-1]
    weights = np.array(
        [[_explained(features, error, ends, drawing) for error in axis] for axis in every]
    )
    # Few draws leave their variance uncertain: Student's quantile in place of the normal one.
    weights *= float(student.ppf(0.975, drawing.draws)) / WIDTH
    said = np.mean((weights @ features.T) ** 2, axis=1)
    squares = np.vstack([one.squares for one in histories])
    return replace(
        model.band,
        history=_history(observer, slow, day),
        open=drawing.share_left * weights,
        square=drawing.share_left**2
        * np.array([_left(squares, *one, drawing.floor) for one in zip(said, every, strict=True)]),
    )


@dataclass(frozen=True, eq=False)
class _History:
    """Heat (n, s), its relaxations (n, s q), what explains errors, and mean squares (n, q)."""

    heat: Array
    states: Array
    features: Array
    squares: Array


def _history_of(heat: Array, rates: Array, step: float) -> _History:
    states = relaxed(heat, rates, step)
    squares = np.square(states.reshape(len(heat), heat.shape[1], -1)).mean(axis=1)
    return _History(heat, states, np.hstack([states, states**2]), squares)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A machine that the calibration runs do not tell from the fitted one."""

    factors: dict[str, float]
    discrepancy: Discrepancy
    offset: Array


def _history(observer: JointAware, machine: ReducedMachine, heat: Array) -> Array:
    """Mean square of what slips of the past change in the displacement, m2, shape (axes,)."""
    physics = observer.observer.physics
    amplitudes, joint = np.zeros(physics.modes.rates.size), physics.at_rest()
    differences = []
    for given in heat:
        inputs = np.append(given * machine.power, 0.0)
        amplitudes = conduct(physics, amplitudes, inputs, joint.pressure, machine.step)
        fresh = joint._replace(slip=np.zeros_like(joint.slip))
        _, without = settle_joint(physics, fresh, amplitudes)
        joint, moved = settle_joint(physics, joint, amplitudes)
        differences.append(moved - without)
    return np.asarray(np.mean(np.square(differences), axis=0))


def _draw(rng: np.random.Generator, problem: Problem, fit: Fit, least_share: float) -> _Drawn:
    singular, directions = fit.directions
    along = rng.normal(size=singular.size) / np.sqrt(1.0 + singular**2)
    logarithms = fit.logarithms + fit.spread * (along @ directions)
    # What the parameters change in the runs, remainder and offsets take back.
    moved = [
        fit_linear(problem, *errors(problem, fit.parameters, at))
        for at in (logarithms, fit.logarithms)
    ]
    sensed = [np.column_stack([one.discrepancy.temperature, one.offset]) for one in moved]
    constant = np.column_stack([problem.states, np.ones(len(problem.states))])
    own = np.column_stack([fit.discrepancy.temperature, fit.offset])
    temperature = own + sensed[0] - sensed[1]
    displacement = (
        fit.discrepancy.displacement
        + moved[0].discrepancy.displacement
        - moved[1].discrepancy.displacement
    )
    for row in temperature:
        tau = _size(row[:-1], DISCREPANCY_TEMPERATURE, least_share)
        row += _unknown(
            rng, constant, np.append(tau * problem.shape, OFFSET), DISCREPANCY_TEMPERATURE
        )
    for row in displacement:
        tau = _size(row, DISCREPANCY_DISPLACEMENT, least_share)
        row += _unknown(rng, problem.states, tau * problem.shape, DISCREPANCY_DISPLACEMENT)
    return _Drawn(
        factors_of(fit.parameters, logarithms),
        Discrepancy(problem.rates, temperature[:, :-1], displacement),
        temperature[:, -1],
    )


def _size(gains: Array, sigma: float, least_share: float) -> float:
    return max(float(np.sqrt(np.mean(gains**2))), least_share * sigma)


def _unknown(rng: np.random.Generator, states: Array, shape: Array, sigma: float) -> Array:
    """Posterior covariance factor of gains on `states` with priors like `shape`."""
    root = make_ridge(states, shape).uncertainty(sigma, 1.0)
    return np.asarray(root @ rng.normal(size=root.shape[1]))


def _errors(
    machine: ReducedMachine, drawn: _Drawn, observer: JointAware, history: _History
) -> Array:
    """Errors (n, axes), m, of the observer on a drawn machine."""
    physics = physics_with(machine, drawn.factors)
    count = len(history.heat)
    inputs = np.column_stack([history.heat * machine.power, np.zeros(count)])
    temperature, displacement = simulate_known(physics, inputs, machine.step)
    temperature = drawn.offset + temperature + history.states @ drawn.discrepancy.temperature.T
    displacement = displacement + history.states @ drawn.discrepancy.displacement.T
    readings = np.vstack([drawn.offset, temperature])
    times = machine.step * np.arange(count + 1)
    samples = ((time, *row, 0.0) for time, row in zip(times, readings, strict=True))
    estimates = [one.displacement for _, one in follow(observer, samples, observer.initial_state())]
    return np.array(estimates[1:]) - displacement


def _explained(features: Array, error: Array, ends: Array, drawing: Drawing) -> Array:
    """Return the weights (f,) of features (n, f) that explain an error (n,), regularised.

    Every history, they end at `ends`, counts relative to its own largest error: else what is left
    of a day's would be taken for an error of the first minutes.
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
    found = make_ridge(features / scale / own[:, None] * size, np.ones(scale.size))
    weights, _ = found.gains(error / own, drawing.rough, 1.0)
    return np.asarray(weights * size / scale)


def _left(squares: Array, said: Array, errors: Array, floor: float) -> Array:
    """Coefficients (q,) of squares (n, q) for what errors (draws, n) have beyond `said`, (n,).

    Each counts relative to what is said of it.
    """
    mean = np.mean(errors**2, axis=0)
    size = float(mean.max())
    if size <= 0.0:
        return np.zeros(squares.shape[1])
    scale = np.maximum(squares.max(axis=0), np.finfo(float).tiny)
    weight = 1.0 / np.maximum(said, floor * size)
    short = np.maximum(mean - said, 0.0)
    coefficients = nnls(squares / scale * weight[:, None], short * weight)[0] / scale
    return np.asarray(coefficients)
