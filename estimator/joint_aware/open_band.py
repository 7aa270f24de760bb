"""The part of the band that the calibration leaves open, learnt from machines it cannot tell apart.

Parameters are drawn from what the calibration says of them, and the remainder is fitted to the
calibration runs beside each draw, so that every drawn machine answers them alike. It then runs
through one history of random heat, and the observer follows it by its temperatures. The mean square
of the errors is written as a sum, with coefficients that are not negative, of squares and fourth
powers of the relaxed heat, which every sample knows: an error that grows with the past heat, and
faster where the joint is far from its preload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from artefacts.arrays import Array
from artefacts.errors import ConvergenceError
from estimator.interface import follow
from estimator.joint_aware.assembling import make_observer
from estimator.joint_aware.estimator import WIDTH, JointAware
from estimator.joint_aware.filter_design import Noise
from estimator.joint_aware.observer_model import Band, ObserverModel
from estimator.joint_aware.parameters import factors_of, with_factors
from estimator.joint_aware.physics import conduct, make_physics, settle_joint, simulate_known
from estimator.joint_aware.physics_fit import (
    REMAINDER_DISPLACEMENT,
    REMAINDER_TEMPERATURE,
    Fit,
    Run,
    remainder_at,
)
from estimator.joint_aware.reduced_machine import ReducedMachine, diagonal_modes
from estimator.joint_aware.remainder import relaxed

#: Drawn machines; the seed of them and of the history.
DRAWS, SEED = 8, 1
#: The history: length, s, its steps, s, and how long a level of heat lasts, s.
DURATION, STEP, LASTS = 8 * 3600.0, 10.0, (300.0, 2400.0)
#: Its highest level, relative to the largest heat calibrated.
BEYOND = 1.5
#: Gains that the data do not show are as large as those that they do, but at least this part of
#: what the model is not trusted to.
LEAST_SHARE = 0.1


def open_band(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    model: ObserverModel,
    noise: Noise | None = None,
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
    """
    slow = replace(machine, step=max(STEP, machine.step))
    observer = JointAware(make_observer(slow, fit, model.calibrated, noise))
    rng = np.random.default_rng(SEED)
    heat = random_levels(rng, slow.step, BEYOND * model.calibrated.heat, machine.power.size)
    states = relaxed(heat, fit.remainder.rates, slow.step)
    squares = np.square(states.reshape(len(heat), machine.power.size, -1)).mean(axis=1)
    features = np.hstack([squares, squares**2])
    errors: list[Array] = []
    while len(errors) < DRAWS:
        try:
            errors.append(_error(rng, slow, runs, fit, observer, heat, states))
        except ConvergenceError:
            continue
    every = np.array(errors)
    found = np.array([_variances(features, every[:, :, axis]) for axis in range(every.shape[2])])
    count = squares.shape[1]
    return replace(
        model.band,
        history=_history(observer, slow, heat),
        square=found[:, :count],
        fourth=found[:, count:],
    )


def _history(observer: JointAware, machine: ReducedMachine, heat: Array) -> Array:
    """Mean square of what slips of the past change in the displacement, m2, shape (axes,)."""
    physics = observer.physics
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


def random_levels(rng: np.random.Generator, step: float, highest: float, sources: int) -> Array:
    """Return the heat of every source, one level after another, shape (n, s)."""
    found = np.zeros((round(DURATION / step), sources))
    for source in range(sources):
        at = 0
        while at < len(found):
            lasts = max(1, round(rng.uniform(*LASTS) / step))
            found[at : at + lasts, source] = rng.uniform(0.0, highest)
            at += lasts
    return found


def _error(
    rng: np.random.Generator,
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    observer: JointAware,
    heat: Array,
    states: Array,
) -> Array:
    """Errors (n, axes), m, of the observer on a machine that is drawn."""
    values, turn = np.linalg.eigh(fit.covariance)
    spread = turn * np.sqrt(np.maximum(values, 0.0))
    logarithms = fit.logarithms + spread @ rng.normal(size=values.size)
    drawn = with_factors(machine, factors_of(fit.parameters, logarithms))
    held = drawn.at_preload
    physics = make_physics(diagonal_modes(drawn, held), drawn.joints, held)
    inputs = np.column_stack([heat * machine.power, np.zeros(len(heat))])
    temperature, displacement = simulate_known(physics, inputs, machine.step)
    remainder = remainder_at(machine, runs, fit, logarithms)
    temperature = temperature + states @ _drawn(
        rng, fit, remainder.temperature, REMAINDER_TEMPERATURE
    )
    displacement = displacement + states @ _drawn(
        rng, fit, remainder.displacement, REMAINDER_DISPLACEMENT
    )
    times = machine.step * np.arange(len(heat) + 1)
    readings = np.vstack([np.zeros(temperature.shape[1]), temperature])
    samples = ((time, *row, 0.0) for time, row in zip(times, readings, strict=True))
    estimates = [one.displacement for _, one in follow(observer, samples, observer.initial_state())]
    return np.array(estimates[1:]) - displacement


def _drawn(rng: np.random.Generator, fit: Fit, gains: Array, sigma: float) -> Array:
    """Gains like fitted ones, shape (s q, channels)."""
    drawn = np.empty_like(gains)
    for row, fitted in zip(drawn, gains, strict=True):
        tau = max(float(np.sqrt(np.mean(fitted**2))), LEAST_SHARE * sigma)
        root = fit.ridge.uncertainty(sigma, tau)
        row[:] = fitted + root @ rng.normal(size=root.shape[1])
    return drawn.T


def _variances(features: Array, errors: Array) -> Array:
    """Coefficients of features (n, f) for the variance of errors (draws, n).

    Raised so that the band of 95 % holds 95 % of them.
    """
    mean = np.mean(errors**2, axis=0)
    size = float(mean.max())
    if size <= 0.0:
        return np.zeros(features.shape[1])
    scale = np.maximum(features.max(axis=0), np.finfo(float).tiny)
    coefficients = nnls(features / scale, mean / size)[0] * size / scale
    width = WIDTH * np.sqrt(np.maximum(features @ coefficients, 1e-3 * size))
    ratio = float(np.quantile(np.abs(errors) / width, 0.95))
    return np.asarray(coefficients * max(ratio, 1.0) ** 2)
