"""Separable least squares by variable projection: nonlinear search over the rates only.

The generalised models are linear in some parameters and not in others: y ≈ Φ(θ) c. For given θ the
best c is a linear least-squares problem; put back, it leaves a problem in θ alone (variable
projection; Golub & Pereyra 1973). The Jacobian of the projected residual is analytic.

Nonlinear parameters are positive; they are searched as logarithms within bounds, from many
starts: a scrambled Sobol sequence with a fixed seed, plus the caller's own guesses.

Two nearly equal rates make two columns of Φ nearly parallel, and c could then be huge and
cancelling. A ridge prevents that: each term's own rms over the data, times `ridge`, counts as an
error. With the default 1e-6 a term as large as the data costs as much as an rms error of 1e-6 of
the data, and one a hundred times larger 1e-4: far below the model errors, yet enough to select the
smaller of two equally good solutions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr, solve_triangular
from scipy.optimize import least_squares

from calibrate.fit_result import INDISTINCT, Fit, covariance
from thermojoint.artefacts.errors import InputError

#: A parameter this close to its bound, in ln, counts as at the bound.
_AT_BOUND = 1e-3
#: Starts whose rms is within this of the best, relative, reached the same optimum.
_SAME = 1e-3

#: theta -> (columns, shape (n, p); derivatives by ln(theta), shape (n, len(theta)), each of the
#: column that the parameter belongs to)
Basis = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Separable:
    """The problem data ≈ basis(theta) @ coefficients."""

    #: Positive nonlinear parameters, shape (k,), to the columns, shape (n, p), and the derivatives,
    #: shape (n, k), by the parameters' logarithms. A parameter belongs to one column.
    basis: Basis
    #: Shape (n, m): right-hand sides; each has its own coefficients, all share theta.
    data: np.ndarray
    #: Of the nonlinear parameters.
    names: tuple[str, ...]
    #: Of the coefficients, in the order of ``coefficients.ravel()``: p·m names, m fastest.
    linear_names: tuple[str, ...]
    #: Bounds of the nonlinear parameters, positive.
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    #: Unit of the data, for the report.
    unit: str
    #: Column of each nonlinear parameter.
    column_of: tuple[int, ...]
    #: See the module docstring.
    ridge: float = 1e-6
    #: Pairs of parameters whose columns may be exchanged: a fit makes the first the larger one, so
    #: that rounding does not decide which is which.
    alike: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class _Projection:
    """Φ with its columns scaled to unit rms, factorised with the ridge, and the solution."""

    scale: np.ndarray  # (p,) rms of the columns
    orthogonal: np.ndarray  # (n + p, p)
    triangle: np.ndarray  # (p, p)
    scaled: np.ndarray  # (p, m) coefficients of the scaled columns
    residual: np.ndarray  # (n + p, m)


def _project(columns: np.ndarray, data: np.ndarray, ridge: float) -> _Projection:
    n, p = columns.shape
    scale = np.sqrt((columns**2).mean(axis=0))
    scale[scale == 0.0] = 1.0
    stacked = np.vstack([columns / scale, ridge * np.sqrt(n) * np.eye(p)])
    target = np.vstack([data, np.zeros((p, data.shape[1]))])
    orthogonal, triangle = qr(stacked, mode="economic", check_finite=False)
    seen = orthogonal.T @ target
    scaled = solve_triangular(triangle, seen, check_finite=False)
    return _Projection(scale, orthogonal, triangle, scaled, target - orthogonal @ seen)


def solve_linear(columns: np.ndarray, data: np.ndarray, ridge: float) -> np.ndarray:
    """Return the coefficients, shape (p, m), of `columns` (n, p) that fit `data` (n, m).

    Least squares with the ridge of the module docstring; a column of zeros gets 0.
    """
    part = _project(columns, data, ridge)
    return part.scaled / part.scale[:, None]


def _jacobian(
    part: _Projection, columns: np.ndarray, slopes: np.ndarray, column_of: tuple[int, ...]
) -> np.ndarray:
    """Return d(residual)/d(ln theta), shape (n + p, m, k): Golub & Pereyra, both terms.

    `slopes` (n, k) are those of the columns `column_of`; all others stay as they are.
    """
    (n, p), m, k = columns.shape, part.residual.shape[1], slopes.shape[1]
    of = list(column_of)
    unit = columns[:, of] / part.scale[of]
    # The scaling follows theta: d(φ/s) = dφ/s - (φ/s) · mean(φ/s · dφ/s).
    scaled = slopes / part.scale[of]
    scaled = scaled - unit * ((unit * scaled).sum(axis=0) / float(n))
    # d(columns) @ coefficients is `scaled` times the coefficients of the columns, (m, k).
    by = part.scaled[of].T
    seen = np.zeros((p, m, k))
    seen[of, :, range(k)] = scaled.T @ part.residual[:n]
    back = solve_triangular(
        part.triangle, seen.reshape(p, m * k), trans="T", check_finite=False
    ).reshape(p, m, k)
    orthogonal = part.orthogonal
    inside = (orthogonal[:n].T @ scaled)[:, None, :] * by - back
    out = (orthogonal @ inside.reshape(p, m * k)).reshape(n + p, m, k)
    out[:n] -= scaled[:, None, :] * by
    return out


@dataclass(frozen=True)
class _End:
    theta: np.ndarray
    cost: float
    evaluations: int
    message: str


def _descend(problem: Separable, start: np.ndarray, scale: float, limit: int) -> _End:
    """Return the local optimum reached from the parameters `start`."""
    data = problem.data / scale

    latest: dict[bytes, tuple[np.ndarray, np.ndarray, _Projection]] = {}
    evaluations = 0

    def at(log_theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, _Projection]:
        # Residual and Jacobian are evaluated at the same point, one after the other.
        nonlocal evaluations
        key = log_theta.tobytes()
        if key not in latest:
            latest.clear()
            evaluations += 1
            columns, slopes = problem.basis(np.exp(log_theta))
            latest[key] = columns, slopes, _project(columns, data, problem.ridge)
        return latest[key]

    def residual(log_theta: np.ndarray) -> np.ndarray:
        return at(log_theta)[2].residual.ravel()

    def jacobian(log_theta: np.ndarray) -> np.ndarray:
        columns, slopes, part = at(log_theta)
        return _jacobian(part, columns, slopes, problem.column_of).reshape(-1, log_theta.size)

    lower, upper = np.log(problem.lower), np.log(problem.upper)
    inset = 1e-9 * (upper - lower)
    solution = least_squares(
        residual,
        np.clip(np.log(start), lower + inset, upper - inset),
        jac=jacobian,
        bounds=(lower, upper),
        xtol=1e-10,
        ftol=1e-10,
        gtol=1e-14,
        max_nfev=limit,
    )
    return _End(np.exp(solution.x), float(solution.cost), evaluations, solution.message)


def _starts(problem: Separable, count: int) -> np.ndarray:
    """Return `count` starts, log-uniform within the bounds, shape (count, k)."""
    from scipy.stats import qmc

    sampler = qmc.Sobol(len(problem.names), seed=0)
    points = sampler.random_base2(max(0, int(np.ceil(np.log2(max(1, count))))))[:count]
    lower, upper = np.log(problem.lower), np.log(problem.upper)
    return np.exp(lower + points * (upper - lower))


def _check(problem: Separable) -> None:
    if problem.data.ndim != 2 or not bool(np.isfinite(problem.data).all()):
        raise InputError("fit: the data must be finite, one column per right-hand side")
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    if not bool(((lower > 0.0) & (lower < upper) & np.isfinite(upper)).all()):
        raise InputError("fit: bounds must be positive and finite, lower below upper")
    if not len(problem.names) == lower.size == upper.size:
        raise InputError("fit: one name and two bounds per nonlinear parameter are needed")


def fit(
    problem: Separable,
    *,
    coarse: Separable | None = None,
    starts: int = 24,
    guesses: Sequence[Sequence[float]] = (),
    polished: int = 3,
) -> Fit:
    """Return the best fit found from many starts.

    Parameters
    ----------
    problem : Separable
        The problem to fit.
    coarse : Separable, optional
        The same problem on fewer samples: the starts are compared on it, and the best `polished`
        results are refined on `problem`. Default: `problem` itself.
    starts : int
        Scrambled Sobol starts, besides `guesses`.
    guesses : sequence
        Further starts, in the units of the parameters.
    polished : int
        Number of the best results, at different parameters, to be refined.

    Raises
    ------
    InputError
        Data or bounds are out of range, or there is no start.
    """
    _check(problem)
    if starts + len(guesses) < 1:
        raise InputError("fit: at least one start is needed")
    trial = coarse or problem
    scale = float(np.abs(problem.data).max()) or 1.0
    points = [*np.asarray(guesses, dtype=float), *_starts(problem, starts)]
    ends = [_descend(trial, point, scale, 60) for point in points]
    ends.sort(key=lambda end: end.cost)
    best = ends[0]
    # cost is half a sum of squares, so an rms ratio of 1 + x is a cost ratio of about 1 + 2x.
    ceiling = best.cost * (1.0 + 2.0 * _SAME) + trial.data.size * 1e-20
    at_best = sum(end.cost <= ceiling for end in ends)
    finals = [_descend(problem, end.theta, scale, 200) for end in _distinct(ends)[:polished]]
    winner = min(finals, key=lambda end: end.cost)
    evaluations = sum(end.evaluations for end in (*ends, *finals))
    return replace(
        _assess(problem, replace(winner, theta=_in_order(problem, winner.theta))),
        starts=len(points),
        starts_at_best=at_best,
        evaluations=evaluations,
    )


def _in_order(problem: Separable, theta: np.ndarray) -> np.ndarray:
    """Return the parameters with the larger one of each `alike` pair first."""
    ordered = theta.copy()
    for first, second in problem.alike:
        ordered[[first, second]] = max(theta[[first, second]]), min(theta[[first, second]])
    return ordered


def _distinct(ends: Sequence[_End]) -> list[_End]:
    """Return the ends without those at the parameters of an earlier one."""
    found: list[_End] = []
    for end in ends:
        if all(np.abs(np.log(end.theta / other.theta)).max() > _SAME for other in found):
            found.append(end)
    return found


def fit_linear(problem: Separable, theta: Sequence[float]) -> Fit:
    """Return the fit of the coefficients alone, the nonlinear parameters being given."""
    _check(problem)
    end = _End(np.asarray(theta, dtype=float), 0.0, 1, "nonlinear parameters were given")
    return _assess(problem, end, free=False)


def _assess(problem: Separable, end: _End, *, free: bool = True) -> Fit:
    """Return the `Fit` at `end`; `free`: whether the nonlinear parameters were searched."""
    columns, slopes = problem.basis(end.theta)
    coefficients = solve_linear(columns, problem.data, problem.ridge)
    residual = problem.data - columns @ coefficients
    n, m = problem.data.shape
    k = end.theta.size if free else 0
    by_theta = slopes[:, None, :k] * coefficients[list(problem.column_of)[:k]].T
    by_linear = np.einsum("np,qm->nqpm", columns, np.eye(m)).reshape(n * m, -1)
    errors, correlation, condition = covariance(
        np.hstack([by_theta.reshape(n * m, k), by_linear]), residual
    )
    names = (*(problem.names if free else ()), *problem.linear_names)
    # The search is in ln(theta): its standard error is relative.
    errors[:k] *= end.theta[:k]
    order = list(problem.names) + list(problem.linear_names)
    values = dict(zip(order, [*end.theta, *coefficients.ravel()], strict=True))
    log_theta = np.log(end.theta)
    near = np.minimum(log_theta - np.log(problem.lower), np.log(problem.upper) - log_theta)
    pairs = tuple(
        (names[i], names[j], float(correlation[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > INDISTINCT
    )
    return Fit(
        values={name: float(value) for name, value in values.items()},
        standard_errors=dict(zip(names, map(float, errors), strict=True)),
        condition_number=condition,
        max_abs_error=float(np.abs(residual).max()),
        rms_error=float(np.sqrt((residual**2).mean())),
        unit=problem.unit,
        at_bound=tuple(
            name
            for name, room in zip(problem.names, near, strict=True)
            if free and room < _AT_BOUND
        ),
        indistinct=pairs,
        starts=0,
        starts_at_best=0,
        evaluations=end.evaluations,
        message=end.message,
    )
