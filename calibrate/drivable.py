"""Check for a calibration by steps: that the heat input alone moves the machine of a case."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fesim.case.history import read_history
from fesim.case.schema import Case, case_from_data, step_count
from fesim.setup.bolts import tightening
from fesim.setup.loads import held_history
from thermojoint.artefacts.errors import InputError

if TYPE_CHECKING:
    import xarray as xr


def check_drivable(case: Case) -> None:
    """Refuse a case in which something other than the heat input affects the response.

    Another heat source would contribute (1 - Q) times its effect to the deviation from
    proportionality, T(Q) - Q T(1), which would be attributed to the joint.

    Raises
    ------
    InputError
        There is no source, a source has its own heat input, a load acts, a bolt is tightened or
        settles, the motion of an axis warms the machine, it starts warm, or the ambient or a held
        temperature changes.
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
    for name in case.axes:
        if _motion_heats(case, name):
            raise InputError(
                f"axes.{name}: calibration needs a machine that the heat input alone warms; let "
                "the axis stand (position_mm instead of file), without motor_heat_W"
            )
    if case.initial_temperature is not None:
        raise InputError("initial_temperature: calibration starts at the ambient; leave it out")
    for name, section in case.held_temperatures.items():
        if held_history(section)(times).any():
            raise InputError(
                f"held_temperatures.{name}: calibration needs the surface at the initial ambient; "
                "set rise_K = 0"
            )


def _motion_heats(case: Case, name: str) -> bool:
    """Whether an axis warms the machine by friction of its guides or by its drive."""
    axis = case.axes[name]
    rubs = any(
        joint.axis == name and joint.running_friction_coefficient > 0.0
        for joint in case.joints.values()
    )
    screw = axis.ball_screw
    if screw is not None:
        torques = (screw.nut_torque_Nm, screw.bearing_torque_Nm, screw.far_bearing_torque_Nm)
        rubs = rubs or any(torques)
    return (axis.file is not None and rubs) or (screw is not None and screw.motor_heat_W > 0.0)


def check_alone(response: xr.Dataset, where: str) -> None:
    """Refuse a simulated response that something other than the heat input has affected.

    A measured one has no case to check; a change of the ambient is in the response itself.

    Raises
    ------
    InputError
        As `check_drivable`.
    """
    try:
        data = json.loads(response.attrs["case"])
        case = case_from_data(data | {"ambient": None}, where, Path())
    except (InputError, KeyError, TypeError, ValueError):
        return
    try:
        check_drivable(case)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
