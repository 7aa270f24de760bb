"""The machine's parameters from its calibration responses: regularised nonlinear least squares.

min over theta (logarithms of the factors) and the remainder's gains G of

    sum over runs and channels |y - f(theta) - Z G|^2 / sigma^2 + |G|^2 / tau^2 + |theta / spread|^2

G enters linearly and is eliminated (`remainder.Ridge`), so the search has as many unknowns as there
are parameters. Temperatures and displacements of all runs count together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from artefacts.arrays import Array
from artefacts.errors import ConvergenceError
from estimator.joint_aware.parameters import Parameter, active, factors_of, with_factors
from estimator.joint_aware.physics import make_physics, simulate_known
from estimator.joint_aware.reduced_machine import ReducedMachine, diagonal_modes
from estimator.joint_aware.remainder import (
    SHARE,
    Remainder,
    Ridge,
    make_ridge,
    relaxation_rates,
    relaxed,
)

#: Samples of a run that count, at most.
MOST_SAMPLES = 120
#: What the model is not trusted to, for every sample: temperature, K, and displacement, m. A model
#: errs alike from sample to sample, so that a whole run tells little more than one of them would:
#: these are errors of 0.03 K and 0.14 um that last for a run.
TEMPERATURE_SIGMA, DISPLACEMENT_SIGMA = 0.3, 1.5e-6
#: ... and of the remainder, which is there to follow what is left sample by sample.
REMAINDER_TEMPERATURE, REMAINDER_DISPLACEMENT = 0.03, 1e-7
#: Relative step of the difference quotients, and of the parameters at the end.
DIFFERENCE, CLOSE = 1e-3, 1e-4
MOST_EVALUATIONS = 20
#: Steps of a run while the parameters are searched; the remainder is fitted with the march's own.
SEARCH_STEPS = 700


@dataclass(frozen=True, eq=False)
class Run:
    """One calibration run on the steps of the march.

    Attributes
    ----------
    inputs : ndarray, shape (n, s + 1)
        Heat of each source by the case, W, and the ambient, K, at the end of each step.
    times : ndarray, shape (k,)
        Samples that count, s.
    temperature : ndarray, shape (k, p)
        K.
    displacement : ndarray, shape (k, axes)
        m.
    length : float
        Of a step, s.
    """

    inputs: Array
    times: Array
    temperature: Array
    displacement: Array
    length: float


def coarser(run: Run) -> Run:
    """Return a run in `SEARCH_STEPS` steps at most, each with the mean of its inputs."""
    factor = math.ceil(len(run.inputs) / SEARCH_STEPS)
    count = math.ceil(len(run.inputs) / factor)
    padded = np.pad(run.inputs, ((0, factor * count - len(run.inputs)), (0, 0)), mode="edge")
    means = padded.reshape(count, factor, -1).mean(axis=1)
    return replace(run, inputs=means, length=factor * run.length)


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted parameters, the remainder beside them, and what the data say of either.

    Attributes
    ----------
    parameters : tuple of Parameter
        In the order of the arrays below.
    logarithms : ndarray, shape (k,)
        Of the factors.
    covariance : ndarray, shape (k, k)
        Of the logarithms, after the calibration.
    singular : ndarray, shape (k,)
        Of the Jacobian in units of the priors: above 1 the data decide, below 1 the prior does.
    directions : ndarray, shape (k, k)
        Rows: the direction in units of the priors that belongs to each singular value.
    remainder : Remainder
        Fitted at these parameters.
    ridge : Ridge
        What it was fitted with.
    residual_temperature : ndarray, shape (p,)
        RMS of what is left, K.
    residual_displacement : ndarray, shape (axes,)
        m.
    evaluations : int
        Of all runs.
    """

    parameters: tuple[Parameter, ...]
    logarithms: Array
    covariance: Array
    singular: Array
    directions: Array
    remainder: Remainder
    ridge: Ridge
    residual_temperature: Array
    residual_displacement: Array
    evaluations: int


def fit_physics(
    machine: ReducedMachine, runs: Sequence[Run], fitted: Sequence[str] | None = None
) -> Fit:
    """Fit a machine's parameters and its remainder.

    Parameters
    ----------
    machine : ReducedMachine
        As its case says.
    runs : sequence of Run
        From rest.
    fitted : sequence of str, optional
        Names of the parameters to fit; default all that the machine has. None at all leaves the
        case as it is and fits the remainder alone.

    Raises
    ------
    ConvergenceError
        The machine of the case itself cannot be marched through the runs.
    """
    parameters = tuple(one for one in active(machine) if fitted is None or one.name in fitted)
    spread = np.array([one.spread for one in parameters])
    whole = _problem(machine, runs)
    problem = _problem(machine, [coarser(run) for run in runs])
    start = _residuals(problem, parameters, np.zeros(spread.size))
    if not parameters:
        return _fit(whole, parameters, np.zeros(0), np.zeros((start.size, 0)), 1)

    def residuals(scaled: Array) -> Array:
        try:
            found = _residuals(problem, parameters, spread * scaled)
        except ConvergenceError:
            # A trial step too far: worse than where the search began, so that it is shortened.
            found = 10.0 * start
        return np.concatenate([found, scaled])

    result = least_squares(
        residuals,
        np.zeros(spread.size),
        diff_step=DIFFERENCE,
        x_scale=1.0,
        bounds=(-3.0, 3.0),
        xtol=CLOSE,
        ftol=CLOSE,
        gtol=1e-8,
        max_nfev=MOST_EVALUATIONS,
    )
    jacobian = result.jac[: start.size]
    evaluations = int(result.nfev + (result.njev or 0) * spread.size)
    return _fit(whole, parameters, result.x, jacobian, evaluations)


def remainder_at(
    machine: ReducedMachine, runs: Sequence[Run], fit: Fit, logarithms: Array
) -> Remainder:
    """Return the remainder that fits the runs beside other parameters, (k,) logarithms of factors.

    What the parameters change in proportion to the heat, the remainder takes back: the runs know
    the machine as a whole.
    """
    problem = _problem(machine, runs)
    gains, _ = _gains(problem, *_errors(problem, fit.parameters, logarithms))
    return Remainder(problem.rates, *gains)


@dataclass(frozen=True, eq=False)
class _Problem:
    machine: ReducedMachine
    runs: Sequence[Run]
    ridge: Ridge
    rates: Array
    temperature_tau: Array
    displacement_tau: Array


def _problem(machine: ReducedMachine, runs: Sequence[Run]) -> _Problem:
    rates = relaxation_rates()
    sources = machine.power.size
    states = [
        _sampled(relaxed(run.inputs[:, :sources] / machine.power, rates, run.length), run)
        for run in runs
    ]
    level = max(float(np.abs(run.inputs[:, :sources] / machine.power).max()) for run in runs)

    def tau(values: Sequence[Array]) -> Array:
        return np.array(
            [
                SHARE * max(np.abs(one).max() for one in column) / level
                for column in zip(*(value.T for value in values), strict=True)
            ]
        )

    return _Problem(
        machine,
        runs,
        make_ridge(np.vstack(states)),
        rates,
        tau([run.temperature for run in runs]),
        tau([run.displacement for run in runs]),
    )


def _sampled(values: Array, run: Run) -> Array:
    """Values (n, c) after each step from rest, at the times that count, (k, c)."""
    grid = run.length * np.arange(len(values) + 1)
    whole = np.vstack([np.zeros(values.shape[1]), values])
    return np.column_stack([np.interp(run.times, grid, column) for column in whole.T])


def _errors(
    problem: _Problem, parameters: tuple[Parameter, ...], logarithms: Array
) -> tuple[Array, Array]:
    """What the runs have more than the machine: temperatures (k, p), displacements (k, axes)."""
    machine = with_factors(problem.machine, factors_of(parameters, logarithms))
    held = machine.at_preload
    physics = make_physics(diagonal_modes(machine, held), machine.joints, held)
    temperature, displacement = [], []
    for run in problem.runs:
        sensed, moved = simulate_known(physics, run.inputs, run.length)
        temperature.append(run.temperature - _sampled(sensed, run))
        displacement.append(run.displacement - _sampled(moved, run))
    return np.vstack(temperature), np.vstack(displacement)


def _residuals(problem: _Problem, parameters: tuple[Parameter, ...], logarithms: Array) -> Array:
    temperature, displacement = _errors(problem, parameters, logarithms)
    ridge = problem.ridge
    parts = [
        ridge.whitened(column, TEMPERATURE_SIGMA, tau)
        for column, tau in zip(temperature.T, problem.temperature_tau, strict=True)
        if tau > 0.0
    ] + [
        ridge.whitened(column, DISPLACEMENT_SIGMA, tau)
        for column, tau in zip(displacement.T, problem.displacement_tau, strict=True)
        if tau > 0.0
    ]
    return np.concatenate(parts)


def _fit(
    problem: _Problem,
    parameters: tuple[Parameter, ...],
    scaled: Array,
    jacobian: Array,
    evaluations: int,
) -> Fit:
    spread = np.array([one.spread for one in parameters])
    logarithms = spread * scaled
    temperature, displacement = _errors(problem, parameters, logarithms)
    gains, left = _gains(problem, temperature, displacement)
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=False)
    inverse = directions.T @ (directions / (1.0 + singular**2)[:, None])
    return Fit(
        parameters=parameters,
        logarithms=logarithms,
        covariance=spread[:, None] * inverse * spread,
        singular=singular,
        directions=directions,
        remainder=Remainder(problem.rates, *gains),
        ridge=problem.ridge,
        residual_temperature=np.sqrt(np.mean(left[0] ** 2, axis=0)),
        residual_displacement=np.sqrt(np.mean(left[1] ** 2, axis=0)),
        evaluations=evaluations,
    )


def _gains(
    problem: _Problem, temperature: Array, displacement: Array
) -> tuple[list[Array], list[Array]]:
    """The remainder's gains for errors of temperatures and displacements, and what is left."""
    states = problem.ridge.left * problem.ridge.values @ problem.ridge.right
    gains = [
        np.array(
            [
                problem.ridge.gains(y, sigma, tau) if tau > 0.0 else np.zeros(states.shape[1])
                for y, tau in zip(errors.T, taus, strict=True)
            ]
        )
        for errors, sigma, taus in (
            (temperature, REMAINDER_TEMPERATURE, problem.temperature_tau),
            (displacement, REMAINDER_DISPLACEMENT, problem.displacement_tau),
        )
    ]
    left = [
        errors - states @ gain.T
        for errors, gain in zip((temperature, displacement), gains, strict=True)
    ]
    return gains, left
