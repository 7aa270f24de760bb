"""Figures that sum up a simulated response: is it right, and how fast does the joint settle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from artefacts.errors import InputError
from fesim.reduced_march import DISPLACEMENT_ERROR, TEMPERATURE_ERROR

if TYPE_CHECKING:
    import xarray as xr

#: A contact pressure that moves by less than this part of the largest change has no share.
_STILL = 1e-3


@dataclass(frozen=True)
class Convergence:
    """What the solver says of a whole response.

    Attributes
    ----------
    gap_residual : float
        Largest residual of the gap equations, m.
    heat_balance : float
        Largest |in - stored - convected|, relative.
    iterations, most_iterations : int
        Newton iterations in all, and of the hardest step.
    cuts : int
        How often a step was cut, in all.
    steps : int
        Steps of the march.
    modes : int
        Of the reduced thermal model; 0 if the march had the full one.
    reduction_error : float
        Largest error found in an output of the reduced model, relative to what is allowed.
    """

    gap_residual: float
    heat_balance: float
    iterations: int
    most_iterations: int
    cuts: int
    steps: int
    modes: int
    reduction_error: float

    @property
    def thermal_model(self) -> str:
        """The thermal model in words, with its error if it is the reduced one."""
        if not self.modes:
            return "full"
        return (
            f"reduced to {self.modes} modes, error {self.reduction_error:.2g} of the allowed "
            f"{1e3 * TEMPERATURE_ERROR:g} mK and {1e9 * DISPLACEMENT_ERROR:g} nm"
        )


@dataclass(frozen=True)
class PressureShare:
    """How much of its final change each contact pressure has made by a given time.

    Attributes
    ----------
    at_s : float
        The time, s.
    contact : tuple of int
        Numbers of the contact elements.
    share : ndarray, shape (m,)
        (p(at) - p(0)) / (p(end) - p(0)); NaN where the pressure hardly changes.
    compressed : ndarray of bool, shape (m,)
        The pressure rises.
    """

    at_s: float
    contact: tuple[int, ...]
    share: NDArray[np.float64]
    compressed: NDArray[np.bool_]

    @property
    def least_compressed(self) -> float | None:
        """The smallest share among the elements whose pressure rises; None if there are none."""
        known = self.share[self.compressed & np.isfinite(self.share)]
        return float(known.min()) if known.size else None


@dataclass(frozen=True)
class SchemeErrors:
    """Largest errors of one validation case, µm.

    Attributes
    ----------
    case, axis : str
        The axis is "vector" for the length of the error in all directions together.
    linear : float
        Of the linear estimator.
    steps : float or None
        Of FCHS with Eq. 18 calibrated to steps, as the paper does.
    estimated : float
        Of FCHS with Eq. 18 calibrated to estimated strengths; what the estimator does.
    """

    case: str
    axis: str
    linear: float
    steps: float | None
    estimated: float


def convergence(response: xr.Dataset) -> Convergence:
    """Return the solver's figures of a simulated response.

    Raises
    ------
    InputError
        The response is not simulated: it has no such figures.
    """
    for name in ("gap_residual", "heat_balance", "iterations", "cuts"):
        _need(response, name)
    iterations = response["iterations"].to_numpy()
    return Convergence(
        gap_residual=float(response["gap_residual"].max()),
        heat_balance=float(np.abs(response["heat_balance"]).max()),
        iterations=int(iterations.sum()),
        most_iterations=int(iterations.max()),
        cuts=int(response["cuts"].sum()),
        steps=int(np.count_nonzero(response["time"].to_numpy() > 0.0)),
        modes=int(response.attrs.get("thermal_modes", 0)),
        reduction_error=float(response.attrs.get("reduction_error", 0.0)),
    )


def pressure_share(response: xr.Dataset, at_s: float = 60.0) -> PressureShare:
    """Return the share of the final change of pressure that is reached at a time.

    The paper's elements under compression reach 75 % within one minute (section 5.3.2).

    Parameters
    ----------
    response : xarray.Dataset
        Simulated response to a step; its last sample stands for the steady state.
    at_s : float
        The time, s.

    Raises
    ------
    InputError
        There is no pressure, or the response does not last beyond `at_s`.
    """
    _need(response, "pressure")
    time, pressure = response["time"].to_numpy(), response["pressure"].to_numpy()
    if not time[0] <= at_s < time[-1]:
        raise InputError(
            f"pressure share at {at_s:g} s: the response runs from {time[0]:g} to {time[-1]:g} s; "
            "simulate it for longer"
        )
    at = np.array([np.interp(at_s, time, column) for column in pressure.T])
    change = pressure[-1] - pressure[0]
    moves = np.abs(change) > _STILL * np.abs(change).max()
    share = np.full(change.shape, np.nan)
    share[moves] = (at - pressure[0])[moves] / change[moves]
    return PressureShare(
        at_s=at_s,
        contact=tuple(int(number) for number in response["contact"].to_numpy()),
        share=share,
        compressed=change > 0.0,
    )


def compare_schemes(
    rows: Sequence[Mapping[str, str | float]],
    as_printed: Sequence[Mapping[str, str | float]],
    vectors: Sequence[Mapping[str, str | float]],
) -> list[SchemeErrors]:
    """Return the largest errors of the linear estimator and of both FCHS calibrations.

    Parameters
    ----------
    rows, as_printed, vectors
        See `thermojoint.study.Validated`.

    Returns
    -------
    list of SchemeErrors
        Every case along every axis, and as the length of the whole vector where that is known.
    """
    error = {(row["case"], row["axis"], row["estimator"]): row["max_abs_error_um"] for row in rows}
    steps = {(row["case"], row["axis"]): row["max_abs_error_um"] for row in as_printed}
    length = {(row["case"], row["estimator"]): row["max_abs_error_um"] for row in vectors}
    found = [
        SchemeErrors(
            str(case),
            str(axis),
            float(linear),
            float(steps[case, axis]),
            float(error[case, axis, "fchs"]),
        )
        for (case, axis, estimator), linear in error.items()
        if estimator == "linear"
    ]
    found += [
        SchemeErrors(str(case), "vector", float(linear), None, float(length[case, "fchs"]))
        for (case, estimator), linear in length.items()
        if estimator == "linear"
    ]
    return found


def _need(response: xr.Dataset, name: str) -> None:
    if name not in response:
        raise InputError(f"response: variable {name!r} is missing; give a simulated response")
