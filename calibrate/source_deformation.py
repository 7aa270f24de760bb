"""Fit of Eq. 18 for every fictitious source to the displacement deviations (Table 3).

    δ_NL(t) = Σ_i q_i D_i(t),        D_i of Eq. 18 with rates c, d, e, f of its own,

with the strengths q_i of Table 2. All inputs are fitted at once, one axis at a time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibrate.fit_result import Fit
from calibrate.least_squares import Separable, fit
from calibrate.linear import deformation_bounds
from thermojoint.artefacts import steps
from thermojoint.artefacts.errors import InputError
from thermojoint.models import deformation
from thermojoint.models.parameters import DeformationModel

#: Cost of a term of Eq. 18 as large as δ_NL, as an error relative to it (`least_squares`).
RIDGE = 3e-6

#: (source, its unit step response (n, p)) to the response at every input (inputs, n, p).
Respond = Callable[[int, np.ndarray], np.ndarray]


def eq18_problem(t: np.ndarray, data: np.ndarray, sources: int, respond: Respond) -> Separable:
    """Return the joint fit of Eq. 18 for every source to δ_NL.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s.
    data : ndarray, shape (inputs, n)
        δ_NL at each input, m.
    sources : int
        Number of sources.
    respond : callable
        Response of a source to the inputs, given its step response.
    """
    inputs = len(data)
    lower, upper = deformation_bounds(t, 4)

    def basis(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns = np.empty((inputs, t.size, sources, 4))
        slopes = np.empty_like(columns)
        for i in range(sources):
            shapes = deformation.basis(t, theta[4 * i : 4 * i + 4])
            driven = respond(i, np.hstack(shapes))
            columns[:, :, i] = driven[:, :, :4]
            slopes[:, :, i] = driven[:, :, 4:]
        rows = inputs * t.size
        return columns.reshape(rows, -1), slopes.reshape(rows, -1)

    return Separable(
        basis=basis,
        data=data.reshape(-1, 1),
        names=tuple(f"{name}{i + 1}" for i in range(sources) for name in "cdef"),
        linear_names=tuple(f"{name}{i + 1}" for i in range(sources) for name in "CDEF"),
        lower=lower * sources,
        upper=upper * sources,
        unit="m",
        column_of=tuple(range(4 * sources)),
        ridge=RIDGE,
        # c >= d and e <= f.
        alike=tuple(
            pair for i in range(0, 4 * sources, 4) for pair in ((i, i + 1), (i + 3, i + 2))
        ),
    )


def eq18_models(fit: Fit, sources: int) -> tuple[DeformationModel, ...]:
    """Return the model of every source from a fit of `eq18_problem`."""
    value = fit.values
    return tuple(
        deformation.model_from(
            [value[f"{name}{i}"] for name in "CDEF"], [value[f"{name}{i}"] for name in "cdef"]
        )
        for i in range(1, sources + 1)
    )


def _step_problem(t: np.ndarray, data: np.ndarray, strengths: np.ndarray) -> Separable:
    """Eq. 18 driven by steps of `strengths`, shape (sources, inputs)."""
    return eq18_problem(
        t, data, len(strengths), lambda i, shapes: strengths[i, :, None, None] * shapes
    )


def fit_source_deformation(
    t: np.ndarray,
    deviations: np.ndarray,
    strengths: np.ndarray,
    *,
    starts: int = 16,
) -> tuple[tuple[DeformationModel, ...], Fit]:
    """Return Eq. 18 of every source along one axis, fitted to all inputs at once.

    The pseudo-inverse of the strengths splits the deviations into one curve per source; each is
    fitted separately from many starts, and the joint fit continues from those rates. It has no
    starts of its own: with the rates of all sources free it has many optima that fit equally well
    within a few per cent and predict differently, and rounding would decide between them.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s.
    deviations : ndarray, shape (inputs, n)
        δ_NL at each input, m.
    strengths : ndarray, shape (sources, inputs)
        q_i.
    starts : int
        Of each source's own fit (`least_squares.fit`).

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
    coarse = _step_problem(t[thin], deviations[:, thin], strengths)
    own = np.linalg.pinv(strengths.T, rcond=1e-6) @ deviations[:, thin]
    guess: list[float] = []
    for curve in own:
        single = _step_problem(t[thin], curve[None, :], np.ones((1, 1)))
        best = fit(single, starts=starts)
        guess += [best.values[name] for name in single.names]
    problem = _step_problem(t, deviations, strengths)
    best = fit(problem, coarse=coarse, starts=0, guesses=[guess])
    return eq18_models(best, sources), best


def source_displacements(
    t: np.ndarray, models: tuple[DeformationModel, ...], strengths: np.ndarray
) -> np.ndarray:
    """Return Σ_i q_i D_i(t), m, shape (inputs, n), for strengths of shape (sources, inputs)."""
    shapes = np.array([deformation.step_response(t, model) for model in models])
    return strengths.T @ shapes
