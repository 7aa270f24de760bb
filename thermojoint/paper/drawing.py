"""Figures of a reproduction: actual against estimated, the paper's Figures 6-11, fields."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimator.fchs.judging import Validated
from estimator.fchs.stream import Signals
from estimator.noise import joint_noise
from estimator.superposition import superposed
from fesim.case.schema import Case
from fesim.setup.machine import Setup
from thermojoint.console import Report
from thermojoint.models.parameters import Model
from thermojoint.models.sensors import roles_in
from thermojoint.paper.inputs import (
    CASES,
    EXTRAPOLATION,
    NOISY,
    PRESSURE,
    REFERENCE,
    TRIANGLE,
)
from thermojoint.paper.report import Picture
from thermojoint.pictures.figures import (
    DEVIATION,
    NONLINEAR,
    estimates_figure,
    heat_text,
    panels_figure,
    pressure_figure,
    write_figure,
)
from thermojoint.pictures.scenes import Scene
from thermojoint.pictures.view import FIELDS, field_scene, run_to_end

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

CAPTIONS = {
    **{f"estimate-{name}": f"Actual and estimated displacement, {name}" for name in CASES},
    "figure-06-structure": "Figure 6: the structure, its contact strips, sensors and heat source Q",
    "figure-07-contact-pressure": "Figure 7: change of the contact pressure, heat input 2.0",
    "figure-08-temperature-deviation": "Figure 8: temperature deviation from the linear structure "
    "at T1 and T2, heat input 3.0",
    "figure-09-nonlinear-displacement": "Figure 9: actual and estimated nonlinear displacement, "
    "heat input 3.0",
    "figure-10-noisy-deviation": "Figure 10: temperature deviation under the triangle, and with "
    "the sensor noise put on it",
    "figure-11-noisy-displacement": "Figure 11: actual and estimated nonlinear displacement under "
    "the triangle, with sensor noise",
    "temperature": "Temperature at the end of the step, heat input 2.0",
    "deformation": "Deformed shape at the end of the step, heat input 2.0",
    "pressure": "Contact pressure at the end of the step, heat input 2.0",
}


def paper_figures(
    model: Model, responses: Mapping[str, xr.Dataset], estimates: Mapping[str, Signals]
) -> dict[str, Figure]:
    """Return the paper's Figures 7-11, by file name without its suffix.

    `estimates` are the estimates of FCHS for "step-3.0", "triangle" and "triangle-noise".
    """
    reference = responses[REFERENCE]
    steep, triangle = responses[EXTRAPOLATION], responses[TRIANGLE]
    times, noisy = estimates[EXTRAPOLATION], estimates[NOISY]
    sensors = list(model.linear.direct)
    on_steep = deviations(model, reference, steep)
    on_triangle = deviations(model, reference, triangle)
    noise = joint_noise(triangle)
    return {
        "figure-07-contact-pressure": pressure_figure(responses[PRESSURE]),
        "figure-08-temperature-deviation": panels_figure(
            np.asarray(times.time),
            {
                sensor: {"simulated": on_steep[:, j], "estimator": times.deviation[:, j]}
                for j, sensor in enumerate(sensors)
            },
            heat_text(steep),
            *DEVIATION,
        ),
        "figure-09-nonlinear-displacement": panels_figure(
            np.asarray(times.time),
            _nonlinear(model, reference, steep, times),
            heat_text(steep),
            *NONLINEAR,
        ),
        "figure-10-noisy-deviation": panels_figure(
            triangle["time"].to_numpy(),
            {
                sensor: {
                    "with noise": on_triangle[:, j] + noise.get(sensor, 0.0),
                    "simulated": on_triangle[:, j],
                }
                for j, sensor in enumerate(sensors)
            },
            heat_text(triangle),
            *DEVIATION,
        ),
        "figure-11-noisy-displacement": panels_figure(
            np.asarray(noisy.time),
            _nonlinear(model, reference, triangle, noisy),
            heat_text(triangle),
            *NONLINEAR,
        ),
    }


def deviations(model: Model, reference: xr.Dataset, response: xr.Dataset) -> np.ndarray:
    """Return the deviation of T1, T2 ... from the superposed reference, K, shape (k, sensors)."""
    roles = roles_in(response, model)
    probes = [roles[role] for role in model.linear.direct]
    part, base = response.sel(probe=probes), reference.sel(probe=probes)
    return part["temperature"].to_numpy() - superposed(base, part, "temperature")


def estimate_figures(validated: Validated) -> dict[str, Figure]:
    """Return figures of actual and estimated displacement, by file name without its suffix."""
    axes = list(dict.fromkeys(str(row["axis"]) for row in validated.rows))
    return {
        f"estimate-{name}": estimates_figure(validated.times[name], errors, axes, name)
        for name, errors in validated.errors.items()
    }


def field_scenes(case: Case, setup: Setup, report: Report) -> dict[str, Scene]:
    """Return the fields at the end of `case`, by file name without its suffix."""
    _, _, last = run_to_end(case, report, setup)
    return {str(show): field_scene(show, case, setup, last) for show in FIELDS}


def draw_views(folder: Path, structure: Scene, fields: Mapping[str, Scene]) -> list[str]:
    """Write the 3-D pictures, a file for each view; return their names."""
    from thermojoint.pictures.stills import write_pictures

    # Side by side the views would be too small on a narrow page.
    views = {
        f"{name}{f'-{k}' * (k > 1)}": replace(scene, panels=(panel,))
        for name, scene in ({"figure-06-structure": structure} | dict(fields)).items()
        for k, panel in enumerate(scene.panels, start=1)
    }
    write_pictures({folder / f"{name}.png": scene for name, scene in views.items()})
    return list(views)


def draw_figures(folder: Path, figures: Mapping[str, Figure], views: list[str]) -> list[Picture]:
    """Write the figures and return all pictures; `views` are already written."""
    for name, figure in figures.items():
        write_figure(figure, folder / f"{name}.png")
    drawn = [*figures, *views]
    return [
        Picture(folder / f"{name}.png", text)
        for first, text in CAPTIONS.items()
        for name in drawn
        if re.fullmatch(rf"{first}(-\d)?", name)
    ]


def _nonlinear(
    model: Model, reference: xr.Dataset, response: xr.Dataset, estimate: Signals
) -> dict[str, dict[str, np.ndarray]]:
    """Axis to the actual and the estimated nonlinear displacement, m."""
    linear = superposed(reference, response, "displacement")
    known = [str(name) for name in response["axis"].to_numpy()]
    actual = response["displacement"].to_numpy() - linear
    return {
        axis: {"actual": actual[:, known.index(axis)], "estimated": estimate.nonlinear[:, k]}
        for k, axis in enumerate(model.linear.deformation)
    }
