"""Table 3: Eq. 18 for every fictitious source, from the displacement deviations of all inputs.

    δ_NL(t) = Σ_i q_i D_i(t),        D_i of Eq. 18 with rates c, d, e, f of its own,

with the strengths q_i of Table 2. All inputs are fitted at once, one axis at a time.
"""

from __future__ import annotations

import numpy as np

from artefacts.errors import InputError
from calibrate import deformation, steps
from calibrate.fit_result import Fit
from calibrate.least_squares import Separable, fit
from calibrate.linear import rate_bounds
from calibrate.model import DeformationModel


def _deformation_problem(t: np.ndarray, data: np.ndarray, strengths: np.ndarray) -> Separable:
    """Return the joint fit of Eq. 18 for every source to δ_NL, shape (inputs, n)."""
    sources, inputs = strengths.shape
    bounds = rate_bounds(t)

    def basis(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns = np.empty((inputs, t.size, sources, 4))
        slopes = np.zeros((inputs, t.size, sources, 4, 4 * sources))
        for i in range(sources):
            own = slice(4 * i, 4 * i + 4)
            shape, by_rate = deformation.basis(t, theta[own])
            columns[:, :, i] = strengths[i][:, None, None] * shape
            slopes[:, :, i, :, own] = strengths[i][:, None, None, None] * by_rate
        rows = inputs * t.size
        return columns.reshape(rows, -1), slopes.reshape(rows, 4 * sources, -1)

    return Separable(
        basis=basis,
        data=data.reshape(-1, 1),
        names=tuple(f"{name}{i + 1}" for i in range(sources) for name in "cdef"),
        linear_names=tuple(f"{name}{i + 1}" for i in range(sources) for name in "CDEF"),
        lower=(bounds[0],) * (4 * sources),
        upper=(bounds[1],) * (4 * sources),
        unit="m",
    )


def fit_source_deformation(
    t: np.ndarray,
    deviations: np.ndarray,
    strengths: np.ndarray,
    *,
    starts: int = 8,
    seed: int = 0,
) -> tuple[tuple[DeformationModel, ...], Fit]:
    """Return Eq. 18 of every source along one axis, fitted to all inputs at once.

    The strengths' pseudo-inverse splits the deviations into one curve per source; each is fitted
    by itself, and those rates are one guess for the joint search.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s.
    deviations : ndarray, shape (inputs, n)
        δ_NL at each input, m.
    strengths : ndarray, shape (sources, inputs)
        q_i.
    starts, seed : int
        Of the joint search (`least_squares.fit`).

    Raises
    ------
    InputError
        Shapes disagree.
    """
    sources, inputs = strengths.shape
    if deviations.shape != (inputs, t.size):
        raise InputError(
            f"fictitious sources: displacement deviations are {deviations.shape}, expected "
            f"(inputs, samples) = {(inputs, t.size)}"
        )
    thin = steps.thinned(t.size)
    coarse = _deformation_problem(t[thin], deviations[:, thin], strengths)
    own = np.linalg.pinv(strengths.T, rcond=1e-6) @ deviations[:, thin]
    guess: list[float] = []
    for curve in own:
        single = _deformation_problem(t[thin], curve[None, :], np.ones((1, 1)))
        found = fit(single, starts=16, seed=seed, polished=1)
        guess += [found.values[name] for name in single.names]
    problem = _deformation_problem(t, deviations, strengths)
    found = fit(problem, coarse=coarse, starts=starts, guesses=[guess], seed=seed)
    models = []
    for i in range(1, sources + 1):
        coefficients = [found.values[f"{name}{i}"] for name in "CDEF"]
        models.append(
            deformation.model_from(coefficients, [found.values[f"{name}{i}"] for name in "cdef"])
        )
    return tuple(models), found


def source_displacements(
    t: np.ndarray, models: tuple[DeformationModel, ...], strengths: np.ndarray
) -> np.ndarray:
    """Return Σ_i q_i D_i(t), m, shape (inputs, n), for strengths of shape (sources, inputs)."""
    shapes = np.array([deformation.step_response(t, model) for model in models])
    return strengths.T @ shapes
