"""Identifiability of a machine's parameters from calibration runs, present and further ones.

Profiles: half the sum of squares with one parameter fixed near its fitted value and the others
fitted again. Further runs: the covariance of the parameters with the information that a run would
add (its Jacobian is that of the fitted machine, so that no new data are needed), propagated to the
displacement of a day of random heat. There the discrepancy compensates the effect of a parameter
that is proportional to the heat in the calibration runs. Everything uses coarse marches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.joint_aware.misfit import (
    SIGMAS,
    Problem,
    Run,
    errors,
    fit_linear,
    highest_heat,
    make_problem,
    physics_with,
    residuals,
    sampled,
    searched,
)
from calibrate.joint_aware.physics_fit import SEARCH, Fit, problem_of
from calibrate.joint_aware.random_heat import random_levels
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.parameters import factors_of
from thermojoint.reduced.physics import at_start, simulate_known

#: Candidate runs: heating time and cooling time, s.
CANDIDATES = {
    "cool-down of 4 h": (2100.0, 12300.0),
    "step of 4 h": (14400.0, 0.0),
    "step of 35 min": (2100.0, 0.0),
}


#: Points of a profile, in standard deviations from the fit, and iterations for the other parameters
#: at each.
POINTS, ITERATIONS = (-2.0, -1.0, 0.0, 1.0, 2.0), 2
#: Length of the day of random heat to which uncertainty is propagated, s, its steps, and the seed.
DAY, STEPS, SEED = 8 * 3600.0, 480, 2


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile of one parameter, the others being fitted."""

    parameter: str
    #: Shape (points,): factors on the case's value.
    factor: Array
    #: Shape (points,): half the sum of squares above that of the fit.
    cost: Array


def profiles(machine: ReducedMachine, runs: Sequence[Run], fit: Fit) -> list[Profile]:
    """Return the profile of every fitted parameter."""
    problem = problem_of(machine, searched(machine, runs, SEARCH.steps), fit)
    at_fit = fit.coordinates / fit.spread
    # Correct the coarse march by its difference from the machine's own march.
    defect = fit.residuals - residuals(problem, fit.parameters, fit.coordinates)
    deviation = np.sqrt(np.diag(fit.covariance)) / fit.spread

    def at(scaled: Array) -> Array:
        whitened = defect + residuals(problem, fit.parameters, fit.spread * scaled)
        return np.concatenate([whitened, scaled])

    whole = np.vstack([fit.jacobian, np.eye(at_fit.size)])
    least, bounds = at(at_fit), [parameter.least for parameter in fit.parameters]
    curves = []
    for k, parameter in enumerate(fit.parameters):
        others = np.arange(at_fit.size) != k
        improve = np.linalg.pinv(whole[:, others])
        values, costs = [], []
        for point in POINTS:
            scaled = at_fit.copy()
            scaled[k] = max(scaled[k] + point * deviation[k], parameter.least)
            # Follow the valley by the tangent, then by Newton's method with a frozen tangent.
            scaled[others] -= improve @ (whole[:, k] * (scaled[k] - at_fit[k]))
            now = at(scaled)
            for _ in range(ITERATIONS):
                trial = scaled.copy()
                trial[others] -= improve @ now
                trial = np.maximum(trial, bounds)
                after = at(trial)
                if after @ after >= now @ now:
                    break
                scaled, now = trial, after
            values.append(parameter.factor(float(fit.spread[k] * scaled[k])))
            costs.append(0.5 * float(now @ now - least @ least))
        curves.append(Profile(parameter.name, np.array(values), np.array(costs)))
    return curves


@dataclass(frozen=True, eq=False)
class FurtherRun:
    """Information of one more run."""

    #: Name of the run; "none" for the present knowledge.
    name: str
    #: Shape (k,): standard deviation of the parameters' coordinates.
    deviation: Array
    #: Shape (axes,): standard deviation of the displacement in the day, root mean square, m.
    day: Array


def further_runs(machine: ReducedMachine, runs: Sequence[Run], fit: Fit) -> list[FurtherRun]:
    """Return the uncertainty of the parameters and of a day, without and with each further run."""
    heat = highest_heat(machine, runs)
    levels = random_levels(SEED, DAY, DAY / STEPS, heat, machine.power.size)
    day = _planned(machine, fit, levels, DAY)
    moved = _day_sensitivity(machine, runs, day, fit)
    further = []
    planned = (
        {"none": None}
        | {name: _heated(machine, fit, heat, *lasts) for name, lasts in CANDIDATES.items()}
        | {"day of 8 h": day}
    )
    for name, run in planned.items():
        information = np.eye(fit.spread.size) + fit.jacobian.T @ fit.jacobian
        if run is not None:
            added = _jacobian(problem_of(machine, [run], fit), fit)
            information = information + added.T @ added
        covariance = np.linalg.inv(information)
        variance = np.einsum("nak,kl,nal->na", moved, covariance, moved)
        further.append(
            FurtherRun(
                name,
                fit.spread * np.sqrt(np.diag(covariance)),
                np.sqrt(variance.mean(axis=0)),
            )
        )
    return further


def _planned(machine: ReducedMachine, fit: Fit, heat: Array, length: float) -> Run:
    """A run that has not been made, simulated by the fitted machine."""
    step = length / len(heat)
    inputs = machine.inputs(heat * machine.power)
    physics = physics_with(machine, factors_of(fit.parameters, fit.coordinates))
    times = np.linspace(step, length, SIGMAS.samples)
    nothing = np.zeros((times.size, 0))
    run = Run(inputs, times, nothing, nothing, step)
    sensed, moved = (
        sampled(values, run, first)
        for values, first in zip(
            simulate_known(physics, inputs, step), at_start(physics), strict=True
        )
    )
    return replace(run, temperature=sensed, displacement=moved)


def _heated(machine: ReducedMachine, fit: Fit, heat: float, on: float, off: float) -> Run:
    length = on + off
    times = length / SEARCH.steps * np.arange(1, SEARCH.steps + 1)
    level = np.where(times <= on, heat, 0.0)
    return _planned(machine, fit, np.tile(level[:, None], (1, machine.power.size)), length)


def _steps(fit: Fit) -> Array:
    """Logarithms next to the fit, one parameter changed in each row, (k, k)."""
    return np.asarray(fit.coordinates + SEARCH.difference * np.diag(fit.spread))


def _jacobian(problem: Problem, fit: Fit) -> Array:
    here = residuals(problem, fit.parameters, fit.coordinates)
    beside = [residuals(problem, fit.parameters, at) for at in _steps(fit)]
    return (np.column_stack(beside) - here[:, None]) / SEARCH.difference


def _day_sensitivity(machine: ReducedMachine, runs: Sequence[Run], day: Run, fit: Fit) -> Array:
    """Displacement in the day per prior standard deviation of each parameter, (n, axes, k), m."""
    known = make_problem(machine, searched(machine, runs, SEARCH.steps))
    planned = make_problem(machine, [day])

    def moved(coordinates: Array) -> Array:
        gains = fit_linear(known, *errors(known, fit.parameters, coordinates)).discrepancy
        _, physics = errors(planned, fit.parameters, coordinates)
        return np.asarray(planned.states @ gains.displacement.T - physics)

    here = moved(fit.coordinates)
    return np.stack([(moved(at) - here) / SEARCH.difference for at in _steps(fit)], axis=2)
