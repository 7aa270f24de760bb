"""Result of a fit: values, standard errors, correlations, parameters at a bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Two parameters whose estimates correlate more than this are not distinguishable.
INDISTINCT = 0.99


@dataclass(frozen=True)
class Fit:
    """Result of a fit and its statistics.

    Standard errors assume independent, equally uncertain residuals. For simulated data the residual
    is the model error, smooth in time, and they are only an indication.
    """

    #: Name to value, nonlinear parameters first, SI.
    values: dict[str, float]
    #: Name to standard error, same units; infinite where the data do not determine it. Given
    #: parameters have none.
    standard_errors: dict[str, float]
    #: Of the Jacobian with its columns scaled to unit length.
    condition_number: float
    #: Of the residual, in `unit`.
    max_abs_error: float
    rms_error: float
    #: Unit of the data.
    unit: str
    #: Nonlinear parameters that ended at a bound.
    at_bound: tuple[str, ...]
    #: Pairs that the data cannot distinguish, and their correlation.
    indistinct: tuple[tuple[str, str, float], ...]
    #: Number of starts, and number of them that reached the best optimum.
    starts: int
    starts_at_best: int
    #: Evaluations of the basis, in all starts.
    evaluations: int
    #: Reason why the search ended.
    message: str


def covariance(jacobian: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return standard errors, correlation and condition number at a least-squares solution.

    Parameters
    ----------
    jacobian : ndarray, shape (data, parameters)
        Of the model, unscaled.
    residual : ndarray
        As many values as data.

    Returns
    -------
    errors : ndarray, shape (parameters,)
        Infinite in directions that the data do not determine.
    correlation : ndarray, shape (parameters, parameters)
    condition : float
        Of the Jacobian with its columns scaled to unit length.
    """
    length = np.linalg.norm(jacobian, axis=0)
    safe = np.where(length > 0.0, length, 1.0)
    _, singular, right = np.linalg.svd(jacobian / safe, full_matrices=False)
    smallest, largest = float(singular.min()), float(singular.max())
    floor = largest * np.finfo(float).eps * max(jacobian.shape)
    inverse = 1.0 / np.maximum(singular, floor)
    spread = (right.T * inverse) @ ((right.T * inverse).T)
    freedom = max(1, residual.size - jacobian.shape[1])
    variance = float((residual**2).sum()) / freedom
    diagonal = np.diag(spread)
    correlation = spread / np.sqrt(np.multiply.outer(diagonal, diagonal))
    # Directions that the data do not determine have no standard error.
    blind = (right[singular <= floor] ** 2).sum(axis=0) > 1e-6
    errors = np.where(blind, np.inf, np.sqrt(variance * diagonal) / safe)
    condition = largest / smallest if smallest > floor else float("inf")
    return errors, correlation, condition


def report(title: str, result: Fit) -> str:
    """Return the fit as text: values, standard errors, parameters at a bound or indistinct."""
    lines = [
        title,
        f"  error: max {result.max_abs_error:.3g} {result.unit}, "
        f"rms {result.rms_error:.3g} {result.unit}",
        f"  condition number {result.condition_number:.2g}; {result.starts_at_best} of "
        f"{result.starts} starts reached the best; {result.evaluations} evaluations; "
        f"{result.message}",
    ]
    for name, value in result.values.items():
        error = result.standard_errors.get(name)
        note = "fixed" if error is None else f"± {error:.2g}"
        bound = "  (at its bound)" if name in result.at_bound else ""
        lines.append(f"  {name:12s} {value: .6g}  {note}{bound}")
    lines.extend(
        f"  {first} and {other} cannot be told apart (correlation {value:+.4f})"
        for first, other, value in result.indistinct
    )
    return "\n".join(lines)
