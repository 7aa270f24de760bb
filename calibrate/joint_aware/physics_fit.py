"""Regularised nonlinear least-squares fit of a machine's parameters to its responses.

min over theta (logarithms of the factors), the discrepancy's gains G and the sensors' offsets o of

    sum |y - f(theta) - Z G - o|^2 / sigma^2 + |G|^2 / tau^2 + |o|^2 / 0.3 K^2 + |theta / spread|^2

over the samples of all runs. G and o are linear and are eliminated (`misfit`), so that the search
has as many unknowns as there are parameters. It uses a coarse march; the difference from the full
march is kept from the last round (a defect correction), so that the converged result solves the
equations of the full march.

Slopes are differences of marches where the first search begins; from there on they follow from the
errors that the searches find anyway (Broyden 1965, `Slopes.moved`), until a step has to be
shortened. The last rounds of the defect correction begin with differences again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from calibrate.joint_aware.misfit import (
    Problem,
    Run,
    best_lags,
    doubt_of,
    errors,
    fit_linear,
    make_problem,
    reading_noise,
    searched,
    trust_in,
    whitened,
)
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.reduced.discrepancy import Discrepancy
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.parameters import Added, Parameter, active


@dataclass(frozen=True)
class Search:
    """Effort and tolerances of the search for parameters."""

    #: Steps of a run during the search; the error of so coarse a march is corrected (module
    #: docstring).
    steps: int = 150
    #: Step of the difference quotients, in standard deviations of the prior: far above the
    #: tolerance of a march, and small enough for the residuals to be linear.
    difference: float = 1e-3
    #: Relative change of parameters and cost at the end of the last search, and of the searches
    #: from several starts.
    close: float = 1e-4
    roughly: float = 1e-3
    #: Most evaluations of a search.
    evaluations: int = 20
    #: Most rounds of the defect correction.
    rounds: int = 6
    #: Change of the last round, in posterior standard deviations.
    settled: float = 0.05
    #: Searches from random draws of the prior, beside the one from the case's values.
    starts: int = 3
    seed: int = 1
    #: Largest distance of a draw from the case's values, in standard deviations of the prior.
    furthest: float = 2.0
    #: Candidates for the initial lags of sensors, s; a search begins with the one that fits best.
    lags: tuple[float, ...] = (0.0, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0)
    #: Largest factor on the assumed errors (`misfit.doubt_of`).
    doubted: float = 5.0
    #: A film or a lag that the case does not have is accepted from this many posterior standard
    #: deviations on.
    evident: float = 2.0


#: The defaults.
SEARCH = Search()
#: Most evaluations of a search that begins where another fit ended.
REFITTED = 4
#: Slopes are taken by differences again if a step has to be shortened more often.
MISLED = 1
#: A constant residual, so that changes of the cost count relative to half a unit, which
#: distinguishes two fits, even if the cost is nearly zero.
UNIT = 1.0
#: A step no longer than this, in units of the priors, is rounding.
NOWHERE = 1e-8


@dataclass(frozen=True, eq=False)
class Start:
    """Result of the search from one start."""

    #: Shape (k,): coordinates.
    reached: Array
    #: Half the sum of squares there.
    cost: float


@dataclass(frozen=True, eq=False)
class Slopes:
    """Errors at some parameters, and their derivatives."""

    #: Shape (k,): coordinates in units of their priors.
    at: Array
    #: Shape (n, p + axes): of `misfit.errors`, K and m.
    errors: Array
    #: Shape (k, n, p + axes): change of the errors by each coordinate.
    each: Array

    def moved(self, at: Array, errors: Array) -> Slopes:
        """Return the nearest slopes that explain the errors at another place (Broyden 1965)."""
        step = at - self.at
        if np.linalg.norm(step) <= NOWHERE:
            return Slopes(at, errors, self.each)
        missed = errors - self.errors - np.tensordot(step, self.each, axes=1)
        return Slopes(at, errors, self.each + np.multiply.outer(step / (step @ step), missed))

    def of(self, samples: Flags) -> Slopes:
        """Return those of some samples, (n,)."""
        return Slopes(self.at, self.errors[samples], self.each[:, samples])

    def jacobian(self, problem: Problem) -> Array:
        """Return the Jacobian of the residuals, (n, k)."""
        return np.column_stack([whitened(problem, each) for each in self.each])


def slopes_at(
    problem: Problem, parameters: tuple[Parameter, ...], at: Array, search: Search
) -> Slopes:
    """Return slopes by differences of marches.

    Parameters
    ----------
    problem : Problem
        The runs.
    parameters : tuple of Parameter
        The k parameters.
    at : ndarray, shape (k,)
        Coordinates in units of their priors.
    search : Search
        With the length of the differences.
    """
    here, *beside = [
        _errors(problem, parameters, place)
        for place in (at, *(at + search.difference * np.eye(at.size)))
    ]
    return Slopes(at, here, (np.array(beside) - here) / search.difference)


def _errors(problem: Problem, parameters: tuple[Parameter, ...], scaled: Array) -> Array:
    """Temperatures and displacements side by side, (n, p + axes)."""
    return np.hstack(errors(problem, parameters, scaled * _spread_of(parameters)))


def _spread_of(parameters: Sequence[Parameter]) -> Array:
    """Prior standard deviations of the coordinates, (k,)."""
    return np.array([parameter.spread for parameter in parameters])


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search."""

    #: Shape (k,): coordinates in units of their priors.
    at: Array
    #: Shape (n,): with the defect.
    residuals: Array
    #: Shape (n, k): of the residuals.
    jacobian: Array
    #: Half the sum of squares, with the prior.
    cost: float
    #: Parameter evaluations of all runs.
    evaluations: int
    #: From which the Jacobian is computed.
    slopes: Slopes


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted parameters and discrepancy, with their uncertainty."""

    #: In the order of the arrays below.
    parameters: tuple[Parameter, ...]
    #: Shape (k,): of the parameters: logarithms of factors, or films in W/(m2 K)
    #: (`Parameter.factor`).
    coordinates: Array
    #: Shape (n, p + axes): of `misfit.errors` there, K and m.
    errors: Array
    #: Shape (n,): of `misfit.residuals` there.
    residuals: Array
    #: Shape (n, k): of the residuals by the coordinates in units of their priors.
    jacobian: Array
    #: Of the errors on the coarse march; the Jacobian is computed from them.
    slopes: Slopes
    #: Fitted at these parameters.
    discrepancy: Discrepancy
    #: Shape (p,): of every sensor, and the standard deviation of its reading, K.
    offset: Array
    noise: Array
    #: Shape (p,): RMS residual, K.
    residual_temperature: Array
    #: Shape (axes,): m.
    residual_displacement: Array
    #: Shape (p,): factor on the assumed error of every sensor (`misfit.trust_in`).
    trust: Array
    #: Factor on all assumed errors (`misfit.doubt_of`).
    doubt: float
    #: Results of the searches with the coarse march; the one from the case's values first.
    starts: tuple[Start, ...]
    #: Parameter evaluations of all runs.
    evaluations: int

    @property
    def spread(self) -> Array:
        """Prior standard deviations of the coordinates, (k,)."""
        return _spread_of(self.parameters)

    @property
    def directions(self) -> tuple[Array, Array]:
        """Singular values of the Jacobian, (k,), and their directions, in rows.

        Directions above 1 are determined by the data, below 1 by the prior.
        """
        _, singular, directions = np.linalg.svd(self.jacobian, full_matrices=False)
        return singular, directions

    @property
    def covariance(self) -> Array:
        """Covariance of the coordinates after the calibration, (k, k)."""
        singular, directions = self.directions
        inverse = directions.T @ (directions / (1.0 + singular**2)[:, None])
        return np.asarray(self.spread[:, None] * inverse * self.spread)


def fit_physics(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fitted: Sequence[str] | None = None,
    search: Search = SEARCH,
) -> Fit:
    """Fit a machine's parameters, its discrepancy and its sensors' offsets.

    Parameters
    ----------
    machine : ReducedMachine
        As described by its case.
    runs : sequence of Run
        From rest.
    fitted : sequence of str, optional
        Names of the parameters to fit; default all that the machine has. If empty, only the
        discrepancy and the offsets are fitted.
    search : Search
        Effort and tolerances.

    Raises
    ------
    ConvergenceError
        The machine of the case itself cannot be marched through the runs.
    """
    parameters = tuple(
        parameter for parameter in active(machine) if fitted is None or parameter.name in fitted
    )
    whole = make_problem(machine, runs)
    if not parameters:
        return _fit(whole, parameters, _nowhere(), (), 1)
    problem = make_problem(machine, searched(machine, runs, search.steps))
    spread = _spread_of(parameters)
    now, rough = np.zeros(spread.size), replace(search, close=search.roughly)
    defect, tried = _defect(whole, problem, parameters, now), []
    slopes, evaluations = slopes_at(problem, parameters, now, search), 3 + now.size
    best: Found | None = None
    for drawn in _starts(parameters, search):
        try:
            begun = best_lags(problem, parameters, spread * drawn, search.lags) / spread
            there = slopes.moved(begun, _errors(problem, parameters, begun))
            result = _search(problem, parameters, there, defect, rough)
        except ConvergenceError:
            if not drawn.any():
                raise
            continue
        tried.append(Start(spread * result.at, result.cost))
        evaluations += result.evaluations
        best = result if best is None or result.cost < best.cost else best
        slopes = best.slopes
    assert best is not None  # the search from the case's values raises
    whole, problem, result, taken = _settled(whole, problem, parameters, best.slopes, search)
    if (doubt := min(doubt_of(whole, result.residuals), search.doubted)) > 1.0:
        whole, problem = replace(whole, doubt=doubt), replace(problem, doubt=doubt)
        evaluations += taken
        whole, problem, result, taken = _settled(whole, problem, parameters, result.slopes, search)
    evaluations, now = evaluations + taken, result.at
    if (held := _undecided(parameters, result, search)).any():
        defect = _defect(whole, problem, parameters, now)
        result = _search(problem, parameters, result.slopes, defect, search, held)
        evaluations, now = evaluations + 2 + result.evaluations, np.where(held, 0.0, result.at)
    slopes = slopes_at(problem, parameters, now, search)
    found = replace(result, at=now, jacobian=slopes.jacobian(problem), slopes=slopes)
    return _fit(whole, parameters, found, tuple(tried), evaluations + 1 + now.size)


def _nowhere() -> Found:
    """Result of a search without parameters."""
    nothing, none = np.zeros(0), np.zeros((0, 0))
    return Found(nothing, nothing, none, 0.0, 0, Slopes(nothing, none, none))


def refit(machine: ReducedMachine, runs: Sequence[Run], fit: Fit, left_out: int) -> Fit:
    """Fit again to all runs of a fit but one, from its parameters and with its slopes.

    As with `SEARCH`, but in few evaluations.

    Parameters
    ----------
    machine, runs
        As in `fit_physics`.
    fit : Fit
        Of all these runs.
    left_out : int
        Index of the run that is left out.

    Raises
    ------
    ConvergenceError
        The machine cannot be marched through the runs.
    """
    parameters = fit.parameters
    kept = np.arange(len(runs)) != left_out
    others = [run for run, stays in zip(runs, kept, strict=True) if stays]
    whole = problem_of(machine, others, fit)
    if not parameters:
        return _fit(whole, parameters, _nowhere(), (), 1)
    samples = np.repeat(kept, [run.times.size for run in runs])
    left, slopes = fit.errors[samples], fit.slopes.of(samples)
    linear = fit_linear(whole, *_apart(whole, left))
    whole = replace(whole, trust=trust_in(whole, linear.temperature))
    coarse = searched(machine, others, SEARCH.steps)
    problem = replace(problem_of(machine, coarse, fit), trust=whole.trust)
    defect = whitened(whole, left) - whitened(problem, slopes.errors)
    held = np.array([isinstance(one, Added) for one in parameters]) & (slopes.at == 0.0)
    few = replace(SEARCH, evaluations=REFITTED, close=SEARCH.roughly)
    result = _search(problem, parameters, slopes, defect, few, held)
    return _fit(whole, parameters, result, (), 1 + result.evaluations)


def _apart(problem: Problem, left: Array) -> tuple[Array, Array]:
    """Errors (n, p + axes) of temperatures and of the displacement."""
    sensors = len(problem.temperature)
    return left[:, :sensors], left[:, sensors:]


def _settled(
    whole: Problem,
    problem: Problem,
    parameters: tuple[Parameter, ...],
    begun: Slopes,
    search: Search,
) -> tuple[Problem, Problem, Found, int]:
    """Search until defect and trust settle; both problems, the last search, and evaluations."""
    now, slopes, evaluations = begun.at, begun, 0
    for number in range(search.rounds):
        linear = fit_linear(whole, *_apart(whole, _errors(whole, parameters, now)))
        trust = trust_in(whole, linear.temperature)
        whole, problem = replace(whole, trust=trust), replace(problem, trust=trust)
        defect = _defect(whole, problem, parameters, now)
        if number > 0:
            # Now the parameters are about right.
            slopes = slopes_at(problem, parameters, now, search)
            evaluations += now.size
        result = _search(problem, parameters, slopes, defect, search)
        evaluations += 3 + result.evaluations
        before, now = now, result.at
        # In posterior standard deviations.
        step = np.append(result.jacobian @ (now - before), now - before)
        if number > 0 and np.linalg.norm(step) <= search.settled:
            break
    return whole, problem, result, evaluations


def problem_of(machine: ReducedMachine, runs: Sequence[Run], fit: Fit) -> Problem:
    """Return the problem of some runs with the errors that a fit assumed at its end."""
    return replace(make_problem(machine, runs), trust=fit.trust, doubt=fit.doubt)


def _undecided(parameters: tuple[Parameter, ...], found: Found, search: Search) -> Flags:
    """Films and lags that the case does not have and the data do not show, (k,).

    A film may explain errors of the model, which is no evidence of one. The fit sets it to zero and
    keeps its uncertainty.
    """
    information = np.eye(found.at.size) + found.jacobian.T @ found.jacobian
    deviation = np.sqrt(np.diag(np.linalg.inv(information)))
    added = np.array([isinstance(parameter, Added) for parameter in parameters])
    return np.asarray(added & (found.at < search.evident * deviation))


def _starts(parameters: tuple[Parameter, ...], search: Search) -> list[Array]:
    drawn = np.random.default_rng(search.seed).normal(size=(search.starts, len(parameters)))
    # A search begins inside its bounds.
    least = [max(-search.furthest, parameter.least) for parameter in parameters]
    drawn = np.clip(drawn, least, search.furthest)
    return [np.zeros(len(parameters)), *drawn]


def _defect(
    whole: Problem, problem: Problem, parameters: tuple[Parameter, ...], scaled: Array
) -> Array:
    """Difference between the residuals at full and at coarse time resolution."""
    fine, coarse = (whitened(one, _errors(one, parameters, scaled)) for one in (whole, problem))
    return fine - coarse


def _search(
    problem: Problem,
    parameters: tuple[Parameter, ...],
    slopes: Slopes,
    defect: Array,
    search: Search,
    held: Flags | None = None,
) -> Found:
    """Search from the parameters of the slopes; those that are `held` stay at zero."""
    least, highest = np.array([parameter.least for parameter in parameters]), 3.0
    # Bounds that fix a parameter would block the steps of all of them (dogbox).
    free = np.ones(least.size, dtype=bool) if held is None else ~held
    # Rounding may have moved a parameter at its bound beyond it.
    begun = np.where(free, np.clip(slopes.at, least, highest), 0.0)
    if not np.array_equal(begun, slopes.at):
        slopes = slopes.moved(begun, _errors(problem, parameters, begun))
    first, evaluations = defect + whitened(problem, slopes.errors), 0
    # Trials since the last slopes.
    tried: list[tuple[Array, Array]] = []

    def every(searched: Array) -> Array:
        scaled = begun.copy()
        scaled[free] = searched
        return scaled

    def of(searched: Array) -> Array:
        scaled = every(searched)
        if np.array_equal(scaled, begun):
            return np.concatenate([first, searched, [UNIT]])
        try:
            tried.append((scaled, _errors(problem, parameters, scaled)))
            penalty = defect + whitened(problem, tried[-1][1])
        except ConvergenceError:
            # Trial step too large: return a cost above the initial one, so that it is shortened.
            tried.extend([(scaled, slopes.errors)] * (1 + MISLED))
            penalty = 10.0 * first
        return np.concatenate([penalty, searched, [UNIT]])

    def slope(searched: Array) -> Array:
        nonlocal slopes, evaluations
        if len(tried) > 1 + MISLED:
            slopes = slopes_at(problem, parameters, every(searched), search)
            evaluations += 1 + begun.size
        else:
            for at, found in tried:
                slopes = slopes.moved(at, found)
        tried.clear()
        own, priors = slopes.jacobian(problem)[:, free], np.eye(searched.size + 1)[:, :-1]
        return np.vstack([own, priors])

    result = least_squares(
        of,
        begun[free],
        slope,
        method="dogbox",
        bounds=(least[free], highest),
        xtol=search.close,
        ftol=search.close,
        gtol=1e-8,
        max_nfev=search.evaluations,
    )
    left, jacobian = result.fun[: defect.size], slopes.jacobian(problem)
    evaluations += int(result.nfev)
    cost = float(result.cost) - 0.5 * UNIT**2
    return Found(every(result.x), left, jacobian, cost, evaluations, slopes)


def _fit(
    problem: Problem,
    parameters: tuple[Parameter, ...],
    found: Found,
    starts: tuple[Start, ...],
    evaluations: int,
) -> Fit:
    left = _errors(problem, parameters, found.at)
    linear = fit_linear(problem, *_apart(problem, left))
    return Fit(
        parameters=parameters,
        coordinates=_spread_of(parameters) * found.at,
        errors=left,
        residuals=whitened(problem, left),
        jacobian=found.jacobian,
        slopes=found.slopes,
        discrepancy=linear.discrepancy,
        offset=linear.offset,
        noise=reading_noise(problem, linear.temperature),
        residual_temperature=np.sqrt(np.mean(linear.temperature**2, axis=0)),
        residual_displacement=np.sqrt(np.mean(linear.displacement**2, axis=0, where=problem.read))
        / [channel.weight for channel in problem.displacement],
        trust=problem.trust,
        doubt=problem.doubt,
        starts=starts,
        evaluations=evaluations,
    )
