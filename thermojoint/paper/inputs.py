"""The paper's heat inputs, checks of a case for them, and the simulated responses."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from calibrate.drivable import check_drivable
from estimator.noise import sensor_noise
from fesim.case.schema import Case, step_count
from fesim.case.thermal_sections import StepInput, TriangleInput
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.console import Report

if TYPE_CHECKING:
    import xarray as xr

HeatInput = StepInput | TriangleInput

CALIBRATION: dict[str, HeatInput] = {
    "step-0.5": StepInput(kind="step", level=0.5),
    "step-1.0": StepInput(kind="step", level=1.0),
    "step-2.0": StepInput(kind="step", level=2.0),
}
VALIDATION: dict[str, HeatInput] = {
    "step-1.5": StepInput(kind="step", level=1.5),
    "step-3.0": StepInput(kind="step", level=3.0),
    "triangle": TriangleInput(kind="triangle", peak=2.0, duration_min=10.0),
}
#: The response to the reference step.
REFERENCE = "step-1.0"
#: The response of Figure 7, and of the field pictures.
PRESSURE = "step-2.0"
#: Time at which the paper's pressures have reached most of their change, s (section 5.3.2).
EARLY = 60.0
#: The responses of Figures 8 and 9, and of 10 and 11 (the last one with noise for the estimate).
EXTRAPOLATION, TRIANGLE, NOISY = "step-3.0", "triangle", "triangle-noise"
#: Longer runs than the paper's (`thermojoint.paper.long_runs`).
DAY, COOL_DOWN, WARM_START = "day", "cool-down", "warm-start"
#: All validation cases, in this order.
CASES = (*VALIDATION, NOISY, DAY, COOL_DOWN, WARM_START)


def check_placeable(case: Case) -> None:
    """Refuse a case whose responses cannot be used for a calibration and its validation.

    Raises
    ------
    InputError
        There is no joint, the march is too short to compare pressures with the paper's, or the
        steps are too few or too long for noise on the sensors.
    """
    if not case.joints:
        raise InputError("joints: without a joint nothing is nonlinear; add [joints.NAME]")
    times = case.march.step_s * np.arange(step_count(case.march) + 1, dtype=float)
    if times[-1] <= EARLY:
        raise InputError(
            f"march: it ends after {times[-1]:g} s, and pressures are compared after {EARLY:g} s; "
            "give a longer duration_min"
        )
    try:
        sensor_noise(times)
    except InputError as error:
        raise InputError(f"march: {error}; take a shorter step_s, or a longer march") from error


def simulate_inputs(
    case: Case,
    inputs: Mapping[str, HeatInput],
    *,
    setup: Setup | None = None,
    progress: Report | None = None,
) -> dict[str, xr.Dataset]:
    """Return the responses of one structure to several heat inputs, by name.

    Raises
    ------
    InputError
        Something other than the heat inputs acts on the structure.
    """
    check_drivable(case)
    ready = setup if setup is not None else set_up(case)

    def run(name: str, heat: HeatInput) -> xr.Dataset:
        own = case.model_copy(update={"heat_input": heat, "title": f"{case.title}, {name}"})
        report = None if progress is None else partial(progress, name)
        return simulate(own, setup=ready, progress=report).response

    return {name: run(name, heat) for name, heat in inputs.items()}
