"""The paper's heat inputs, checks of a case for them, and the simulated responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from fesim.case.history import read_history
from fesim.case.schema import Case, step_count
from fesim.case.thermal_sections import StepInput, TriangleInput
from fesim.setup.bolts import tightening
from fesim.setup.loads import held_history
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

HeatInput = StepInput | TriangleInput
Report = Callable[[str, int, int], None]

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
#: The responses of Figures 8 and 9, and of 10 and 11; the latter's noise is the estimate's.
EXTRAPOLATION, TRIANGLE, NOISY = "step-3.0", "triangle", "triangle-noise"
#: Longer runs than the paper's (`thermojoint.paper.long_runs`).
DAY, COOL_DOWN, WARM_START = "day", "cool-down", "warm-start"
#: All validation cases, in this order.
CASES = (*VALIDATION, NOISY, DAY, COOL_DOWN, WARM_START)


def check_drivable(case: Case) -> None:
    """Refuse a case in which something other than the heat input affects the response.

    Another heat source would contribute (1 - Q) times its effect to the deviation from
    proportionality, T(Q) - Q T(1), which would be attributed to the joint.

    Raises
    ------
    InputError
        There is no source, a source has its own heat input, a load acts, a bolt is tightened or
        settles, the machine starts warm, or the ambient or a held temperature changes.
    """
    if not case.sources:
        raise InputError("sources: nothing follows the heat input; add [sources.NAME]")
    for name, source in case.sources.items():
        if source.heat_input is not None:
            raise InputError(
                f"sources.{name}.heat_input: calibration drives all sources alike; leave it out"
            )
    if case.displacement is None:
        raise InputError("displacement: calibration needs one; add [displacement]")
    times = case.march.step_s * np.arange(step_count(case.march) + 1, dtype=float)
    if case.ambient is not None:
        ambient = read_history(case.ambient.file, "ambient_degC")(times)
        if np.ptp(ambient) > 0.0:
            raise InputError("ambient: calibration needs a steady ambient; leave [ambient] out")
    for name, load in case.loads.items():
        if load.file is None or read_history(load.file, "factor")(times).any():
            raise InputError(
                f"loads.{name}: calibration needs a machine that heat alone moves; leave it out"
            )
    for name, force in zip(case.bolts, tightening(case), strict=True):
        if np.ptp(force(times)) > 0.0:
            raise InputError(
                f"bolts.{name}: calibration needs a machine that heat alone moves; leave its file "
                "out"
            )
    if case.initial_temperature is not None:
        raise InputError("initial_temperature: calibration starts at the ambient; leave it out")
    for name, section in case.held_temperatures.items():
        if held_history(section)(times).any():
            raise InputError(
                f"held_temperatures.{name}: calibration needs the surface at the initial ambient; "
                "set rise_K = 0"
            )


def check_placeable(case: Case) -> None:
    """Refuse a case whose responses cannot be used for a calibration.

    Raises
    ------
    InputError
        There is no joint.
    """
    if not case.joints:
        raise InputError("joints: without a joint nothing is nonlinear; add [joints.NAME]")


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
