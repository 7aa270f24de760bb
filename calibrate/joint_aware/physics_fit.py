"""Regularised nonlinear least-squares fit of a machine's parameters to its responses.

min over theta (logarithms of the factors), the remainder's gains G and the sensors' offsets o of

    sum |y - f(theta) - Z G - o|^2 / sigma^2 + |G|^2 / tau^2 + |o|^2 / 0.3 K^2 + |theta / spread|^2

over the samples of all runs. G and o enter linearly and are eliminated (`misfit`), so that the
search has as many unknowns as there are parameters. It goes by a coarse march whose difference from
the machine's own march is kept from the last round (a defect correction): what it comes to solves
the equations of the machine's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from calibrate.joint_aware.misfit import (
    Problem,
    Run,
    coarser,
    errors,
    fit_linear,
    make_problem,
    reading_noise,
    residuals,
    trust_in,
)
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.reduced.discrepancy import Discrepancy
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.parameters import Parameter, active

#: Steps of a run in a search.
SEARCH_STEPS = 150
#: Relative step of the difference quotients, and of the parameters at the end.
DIFFERENCE, CLOSE = 1e-3, 1e-4
MOST_EVALUATIONS = 20
#: Rounds of the defect correction at most, and the change, in standard deviations, of the last.
MOST_ROUNDS, SETTLED = 6, 0.05
#: Searches beside that from the case's own values start from draws of the prior; their seed, and
#: how far they go.
STARTS, SEED, ROUGHLY = 3, 1, 1e-3


@dataclass(frozen=True, eq=False)
class Start:
    """Result of the search from one start.

    Attributes
    ----------
    begun, found : ndarray, shape (k,)
        Logarithms of the factors.
    cost : float
        Half the sum of squares there.
    """

    begun: Array
    found: Array
    cost: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted parameters, the remainder beside them, and what the data say of either.

    Attributes
    ----------
    parameters : tuple of Parameter
        In the order of the arrays below.
    logarithms : ndarray, shape (k,)
        Of the factors.
    residuals : ndarray, shape (n,)
        Of `misfit.residuals` there.
    jacobian : ndarray, shape (n, k)
        Of the residuals by the logarithms in units of their priors.
    discrepancy : Discrepancy
        Fitted at these parameters.
    offset, noise : ndarray, shape (p,)
        Of every sensor, and the standard deviation of its reading, K.
    residual_temperature : ndarray, shape (p,)
        RMS of what is left, K.
    residual_displacement : ndarray, shape (axes,)
        m.
    starts : tuple of Start
        Where searches came to, each by the coarse march; the case's own values first.
    evaluations : int
        Of all runs.
    """

    parameters: tuple[Parameter, ...]
    logarithms: Array
    residuals: Array
    jacobian: Array
    discrepancy: Discrepancy
    offset: Array
    noise: Array
    residual_temperature: Array
    residual_displacement: Array
    starts: tuple[Start, ...]
    evaluations: int

    @property
    def spread(self) -> Array:
        """Prior standard deviations of the logarithms, (k,)."""
        return np.array([parameter.spread for parameter in self.parameters])

    @property
    def directions(self) -> tuple[Array, Array]:
        """Singular values of the Jacobian, (k,), and the directions that they belong to, in rows.

        Above 1 the data decide, below 1 the prior does.
        """
        _, singular, directions = np.linalg.svd(self.jacobian, full_matrices=False)
        return singular, directions

    @property
    def covariance(self) -> Array:
        """Covariance of the logarithms after the calibration, (k, k)."""
        singular, directions = self.directions
        inverse = directions.T @ (directions / (1.0 + singular**2)[:, None])
        return np.asarray(self.spread[:, None] * inverse * self.spread)


def fit_physics(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fitted: Sequence[str] | None = None,
    starts: int = STARTS,
) -> Fit:
    """Fit a machine's parameters, its remainder and its sensors' offsets.

    Parameters
    ----------
    machine : ReducedMachine
        As its case says.
    runs : sequence of Run
        From rest.
    fitted : sequence of str, optional
        Names of the parameters to fit; default all that the machine has. None at all leaves the
        case as it is and fits the remainder and the offsets alone.
    starts : int
        Searches from draws of the prior, beside that from the case's own values.

    Raises
    ------
    ConvergenceError
        The machine of the case itself cannot be marched through the runs.
    """
    parameters = tuple(one for one in active(machine) if fitted is None or one.name in fitted)
    whole = make_problem(machine, runs)
    if not parameters:
        return _fit(whole, parameters, np.zeros(0), np.zeros((0, 0)), (), 1)
    problem = make_problem(machine, [coarser(run, SEARCH_STEPS) for run in runs])
    spread = np.array([parameter.spread for parameter in parameters])
    now = np.zeros(spread.size)
    defect, evaluations, tried = _defect(whole, problem, parameters, now), 2, []
    for begun in _starts(parameters, starts):
        try:
            result = _search(problem, parameters, begun, defect, ROUGHLY)
        except ConvergenceError:
            if not begun.any():
                raise
            continue
        tried.append(Start(spread * begun, spread * result.x, float(result.cost)))
        evaluations += _counted(result)
    now = min(tried, key=lambda one: one.cost).found / spread
    for _ in range(MOST_ROUNDS):
        left = fit_linear(whole, *errors(whole, parameters, spread * now)).temperature
        trust = trust_in(whole, left)
        whole, problem = replace(whole, trust=trust), replace(problem, trust=trust)
        defect = _defect(whole, problem, parameters, now)
        result = _search(problem, parameters, now, defect, CLOSE)
        evaluations += 3 + _counted(result)
        before, now = now, result.x
        # In standard deviations of the parameters that the data leave.
        step = np.append(result.jac[: defect.size] @ (now - before), now - before)
        if np.linalg.norm(step) <= SETTLED:
            break
    return _fit(whole, parameters, now, result.jac[: defect.size], tuple(tried), evaluations)


def _starts(parameters: tuple[Parameter, ...], count: int) -> list[Array]:
    rng = np.random.default_rng(SEED)
    drawn = np.clip(rng.normal(size=(count, len(parameters))), -2.0, 2.0)
    return [np.zeros(len(parameters)), *drawn]


def _defect(
    whole: Problem, problem: Problem, parameters: tuple[Parameter, ...], scaled: Array
) -> Array:
    """Difference between the residuals at full and at coarse time resolution."""
    logarithms = scaled * [parameter.spread for parameter in parameters]
    return residuals(whole, parameters, logarithms) - residuals(problem, parameters, logarithms)


def _search(
    problem: Problem,
    parameters: tuple[Parameter, ...],
    start: Array,
    defect: Array,
    close: float,
) -> OptimizeResult:
    spread = np.array([parameter.spread for parameter in parameters])
    first: list[Array] = []

    def of(scaled: Array) -> Array:
        try:
            found = defect + residuals(problem, parameters, spread * scaled)
        except ConvergenceError:
            # A trial step too far: worse than where the search began, so that it is shortened.
            if not first:
                raise
            found = 10.0 * first[0]
        if not first:
            first.append(found)
        return np.concatenate([found, scaled])

    return least_squares(
        of,
        start,
        diff_step=DIFFERENCE,
        x_scale=1.0,
        bounds=(-3.0, 3.0),
        xtol=close,
        ftol=close,
        gtol=1e-8,
        max_nfev=MOST_EVALUATIONS,
    )


def _counted(result: OptimizeResult) -> int:
    return int(result.nfev + (result.njev or 0) * result.x.size)


def _fit(
    problem: Problem,
    parameters: tuple[Parameter, ...],
    scaled: Array,
    jacobian: Array,
    starts: tuple[Start, ...],
    evaluations: int,
) -> Fit:
    logarithms = np.array([parameter.spread for parameter in parameters]) * scaled
    linear = fit_linear(problem, *errors(problem, parameters, logarithms))
    return Fit(
        parameters=parameters,
        logarithms=logarithms,
        residuals=residuals(problem, parameters, logarithms),
        jacobian=jacobian,
        discrepancy=linear.discrepancy,
        offset=linear.offset,
        noise=reading_noise(problem, linear.temperature),
        residual_temperature=np.sqrt(np.mean(linear.temperature**2, axis=0)),
        residual_displacement=np.sqrt(np.mean(linear.displacement**2, axis=0)),
        starts=starts,
        evaluations=evaluations,
    )
