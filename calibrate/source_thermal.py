"""Fit of Eq. 16 to temperature deviations, jointly and by averaging (Table 2).

With deviations ∂T_j of sensor j and S the unit-gain step response of Eq. 2,

    ∂T_j(t) = Σ_i P_i S(t; a_i, alpha_i, r_ij, r0_i)                 (Eq. 16, P_i = K_i q_i)

The distances r_ij are fixed by the geometry; a_i and alpha_i belong to the source, whatever the
heat input; the products P_i differ from input to input and are linear. `fit_jointly` shares a_i and
alpha_i between all inputs from the outset; `fit_by_averaging` is the loop of Figure 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.fit_result import Fit
from calibrate.least_squares import Separable, fit, fit_linear
from calibrate.linear import ring_bounds
from thermojoint.artefacts import steps
from thermojoint.artefacts.errors import InputError
from thermojoint.models import ring_source

#: Radius of the ring that represents a fictitious source, relative to the distance of its sensor.
SOURCE_RADIUS = 0.4
#: Of Figure 4's loop: starts of the search in the first round, most rounds, and how well the rates
#: of the inputs must agree (in ln).
FIRST_STARTS, ROUNDS, TOLERANCE = 8, 20, 1e-3


@dataclass(frozen=True)
class SourceGeometry:
    """Distances of the fictitious sources."""

    #: Shape (sources, sensors): r_ij, m, from source i to sensor j.
    distances: np.ndarray
    #: Shape (sources,): r0_i, m.
    radii: np.ndarray


def make_geometry(distances: Sequence[Sequence[float]] | np.ndarray) -> SourceGeometry:
    """Return a checked geometry; the radii are `SOURCE_RADIUS` of the own distances.

    Raises
    ------
    InputError
        A distance is missing, not positive or not finite.
    """
    table = np.asarray(distances, dtype=float)
    if table.ndim != 2 or not table.size:
        raise InputError("fictitious sources: distances must be one row per source, m")
    own = table[np.arange(len(table)), np.minimum(np.arange(len(table)), table.shape[1] - 1)]
    if not bool((np.isfinite(table) & (table > 0.0)).all()):
        raise InputError("fictitious sources: distances must be positive and finite, m")
    return SourceGeometry(table, SOURCE_RADIUS * own)


@dataclass(frozen=True)
class SourceFit:
    """Rates and products of the fictitious sources."""

    #: Shape (sources,): 1/m2 and m2/s.
    a: np.ndarray
    alpha: np.ndarray
    #: Shape (sources, inputs): p_i = K_i q_i at each input, K.
    products: np.ndarray
    #: Of the temperature deviations.
    fit: Fit


@dataclass(frozen=True)
class Averaging:
    """Outcome of Figure 4's loop: the sources, and how it ended."""

    result: SourceFit
    reason: str


def unit_responses(
    t: np.ndarray, rates: np.ndarray, geometry: SourceGeometry
) -> tuple[np.ndarray, np.ndarray]:
    """Return S(t; a_i, alpha_i, r_ij, r0_i) and its derivatives by the logarithms of the rates.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s.
    rates : ndarray, shape (2·sources,)
        a_1, alpha_1, a_2, alpha_2 ...
    geometry : SourceGeometry

    Returns
    -------
    columns : ndarray, shape (sensors·n, sources)
        Sensor by sensor, one below the other; dimensionless (K per K of product).
    slopes : ndarray, shape (sensors·n, 2·sources)
        Each of the column of its source.
    """
    sources, sensors = geometry.distances.shape
    n = t.size
    columns = np.empty((sensors * n, sources))
    slopes = np.empty((sensors * n, 2 * sources))
    for i, j in np.ndindex(sources, sensors):
        a, alpha = rates[2 * i], rates[2 * i + 1]
        rows = slice(j * n, (j + 1) * n)
        response, gradient = ring_source.step_response_gradient(
            t, 1.0, a, alpha, float(geometry.distances[i, j]), float(geometry.radii[i])
        )
        columns[rows, i] = response
        slopes[rows, 2 * i] = a * gradient[:, 1]
        slopes[rows, 2 * i + 1] = alpha * gradient[:, 2]
    return columns, slopes


def _problem(
    t: np.ndarray, deviations: np.ndarray, inputs: Sequence[float], geometry: SourceGeometry
) -> Separable:
    """Return the fit of deviations, shape (inputs, sensors, n), sharing the rates."""
    sources = geometry.distances.shape[0]
    pairs = [(f"a{i + 1}", f"alpha{i + 1}") for i in range(sources)]
    bounds = [ring_bounds(t, radius / SOURCE_RADIUS) for radius in geometry.radii]
    return Separable(
        basis=lambda rates: unit_responses(t, rates, geometry),
        data=deviations.reshape(len(inputs), -1).T,
        names=tuple(name for pair in pairs for name in pair),
        linear_names=tuple(f"P{i + 1}@{level:g}" for i in range(sources) for level in inputs),
        lower=tuple(value for low, _ in bounds for value in low),
        upper=tuple(value for _, high in bounds for value in high),
        unit="K",
        column_of=tuple(i for i in range(sources) for _ in range(2)),
    )


def _source_fit(fit: Fit, sources: int, inputs: int) -> SourceFit:
    values = np.array(list(fit.values.values()))
    rates = values[: 2 * sources]
    return SourceFit(rates[0::2], rates[1::2], values[2 * sources :].reshape(sources, inputs), fit)


def _check_deviations(
    t: np.ndarray, deviations: np.ndarray, inputs: Sequence[float], geometry: SourceGeometry
) -> None:
    sources, sensors = geometry.distances.shape
    if deviations.shape != (len(inputs), sensors, t.size):
        raise InputError(
            f"fictitious sources: deviations are {deviations.shape}, expected (inputs, sensors, "
            f"samples) = {(len(inputs), sensors, t.size)}"
        )
    if len(inputs) < sources:
        raise InputError(
            f"fictitious sources: {len(inputs)} calibration inputs for {sources} sources; give at "
            "least as many inputs as sources"
        )


def fit_jointly(
    t: np.ndarray,
    deviations: np.ndarray,
    inputs: Sequence[float],
    geometry: SourceGeometry,
) -> SourceFit:
    """Return one a_i and alpha_i per source, fitted to all inputs at once (Eq. 16).

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s.
    deviations : ndarray, shape (inputs, sensors, n)
        ∂T_j at each input, K.
    inputs : sequence of float
        The heat inputs; at least as many as sources.
    geometry : SourceGeometry

    Raises
    ------
    InputError
        Shapes disagree or there are fewer inputs than sources.
    """
    _check_deviations(t, deviations, inputs, geometry)
    thin = steps.thinned(t.size)
    best = fit(
        _problem(t, deviations, inputs, geometry),
        coarse=_problem(t[thin], deviations[:, :, thin], inputs, geometry),
    )
    return _source_fit(best, geometry.distances.shape[0], len(inputs))


def fit_by_averaging(
    t: np.ndarray,
    deviations: np.ndarray,
    inputs: Sequence[float],
    geometry: SourceGeometry,
) -> Averaging:
    """Return the sources found by the loop of Figure 4.

    Each input is fitted separately; if the inputs' a_i and alpha_i differ, their geometric means
    (they are positive) are the next round's initial guess. The first round searches from
    `FIRST_STARTS` points. The loop ends when every rate is within `TOLERANCE` (in ln) of its mean,
    when the means no longer change (the optima of the inputs differ, and a good optimiser returns
    to them from any guess), or after `ROUNDS`. The products are then fitted with the means.
    Parameters as of `fit_jointly`.
    """
    _check_deviations(t, deviations, inputs, geometry)
    thin = steps.thinned(t.size)
    alone = [
        (
            _problem(t, part, [level], geometry),
            _problem(t[thin], part[:, :, thin], [level], geometry),
        )
        for part, level in zip(deviations[:, None], inputs, strict=True)
    ]
    names = alone[0][0].names
    guesses: list[list[float]] = []
    reason = f"the inputs did not agree within {ROUNDS} rounds"
    for index in range(ROUNDS):
        count = 0 if guesses else FIRST_STARTS
        ends = [
            fit(full, coarse=thin_one, starts=count, guesses=guesses, polished=1)
            for full, thin_one in alone
        ]
        rates = np.array([[end.values[name] for name in names] for end in ends])
        averages = np.exp(np.log(rates).mean(axis=0))
        before, guesses = guesses, [averages.tolist()]
        if float(np.abs(np.log(rates / averages)).max()) < TOLERANCE:
            reason = f"the inputs agree after {index + 1} rounds"
            break
        if before and float(np.abs(np.log(averages / before[0])).max()) < TOLERANCE:
            reason = f"the means stopped moving after {index + 1} rounds; the inputs differ"
            break
    best = fit_linear(_problem(t, deviations, inputs, geometry), guesses[0])
    result = _source_fit(best, geometry.distances.shape[0], len(inputs))
    return Averaging(result, reason)


def largest_ratio(joint: SourceFit, averaged: SourceFit) -> float:
    """Return the largest factor, >= 1, between an a or alpha of two fits."""
    ratios = np.concatenate([joint.a / averaged.a, joint.alpha / averaged.alpha])
    return float(np.exp(np.abs(np.log(ratios)).max()))
