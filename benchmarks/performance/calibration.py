"""Tables 1-3 from saved responses, against the same fits with finite-difference gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
import xarray as xr
from scipy.optimize import OptimizeResult, least_squares

from benchmarks.performance.cases import REFERENCE, calibrated, calibration_responses, others
from benchmarks.performance.timing import Row, paired
from calibrate import chain
from calibrate.driven_deformation import driver
from thermojoint.artefacts.response import read_response, write_response
from thermojoint.models.ring_source import step_response

REPEATS = 3
Array = np.ndarray


def rows(repeats: int = REPEATS) -> Iterator[Row]:
    """Yield the rows of the calibration."""
    found, named = calibrated()
    results: dict[str, chain.Calibrated] = {}
    distances = None if found.placement is None else found.placement.distances.tolist()
    with TemporaryDirectory() as name:
        folder = Path(name)
        chosen = _written(named, folder / "named")
        unnamed = _written(calibration_responses(), folder / "candidates")

        def calibrate(files: dict[str, Path], distances: list[list[float]] | None) -> None:
            read = {name: read_response(path) for name, path in files.items()}
            results["ours"] = chain.calibrate_responses(read[REFERENCE], others(read), distances)

        ours = partial(calibrate, chosen, distances)

        def numerically() -> None:
            mine = results["ours"]
            with finite_differences():
                ours()
            results["other"] = results["ours"]
            results["ours"] = mine

        times = paired(ours, numerically, repeats)
        errors = {side: fit_errors(one) for side, one in results.items()}
        apart = max(
            abs(errors["other"][name] / value - 1.0) for name, value in errors["ours"].items()
        )
        yield Row(
            "calibration",
            *times,
            "s",
            f"Tables 1-3 of the equal-heights machine from three response files, sensors named, "
            "against the same fits with finite differences in place of their gradients (none are "
            f"computed in vain); their rms errors agree to {apart:.0e}; median of {repeats}",
        )
        yield Row(
            "calibration-placement",
            *paired(partial(calibrate, unnamed, None), ours, repeats),
            "s",
            "the same with the sensors chosen among 238 candidates, against sensors named; median "
            f"of {repeats}",
        )


def fit_errors(found: chain.Calibrated) -> dict[str, float]:
    """Rms error of every fit of Tables 1-3."""
    fits = dict(found.linear.fits) | {"sources": found.fictitious.joint.fit}
    fits |= {f"sources.{axis}": fit for axis, fit in found.fictitious.deformation_fits.items()}
    return {name: fit.rms_error for name, fit in fits.items()}


@contextmanager
def finite_differences() -> Iterator[None]:
    """Let every fit take finite differences, and spare it the work on gradients it has no use for.

    Its standard errors mean nothing then; its parameters do.
    """

    def without_gradient(residual: Any, start: Array, jac: Any, **options: Any) -> OptimizeResult:
        return least_squares(residual, start, jac="2-point", **options)

    def response_alone(t: Array, *parameters: float) -> tuple[Array, Array]:
        response = step_response(t, *parameters)
        return response, np.zeros((*response.shape, 4))

    def columns_alone(strengths: Array) -> Callable[[Array], Array]:
        respond = driver(strengths)

        def first_half(shapes: Array) -> Array:
            # The other half of the step responses are derivatives.
            driven = respond(shapes[:, : shapes.shape[1] // 2])
            return np.concatenate([driven, np.zeros_like(driven)], axis=2)

        return first_half

    with ExitStack() as stack:
        for name, value in {
            "calibrate.least_squares.least_squares": without_gradient,
            "thermojoint.models.ring_source.step_response_gradient": response_alone,
            "calibrate.driven_deformation.driver": columns_alone,
        }.items():
            stack.enter_context(patch(name, value))
        yield


def _written(responses: dict[str, xr.Dataset], folder: Path) -> dict[str, Path]:
    for name, response in responses.items():
        write_response(response, folder / f"{name}.nc")
    return {name: folder / f"{name}.nc" for name in responses}
