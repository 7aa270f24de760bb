"""A machine with its joint linearised at the preload, for a linear Kalman filter.

Every contact element keeps its conductance and stiffness at preload, and sticks. The rest of the
machine is linear, and the joint-aware estimator on it is the Kalman filter of the reduced model
with a linear joint: a baseline, calibrated and run in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from calibrate.joint_aware.calibration import (
    USUAL,
    Effort,
    JointAwareCalibration,
    calibrate_machine,
)
from calibrate.joint_aware.sticking import sticking_tangent
from estimator.joint_aware.filter_design import Noise
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.machine import ReducedMachine, own_modes


def with_linear_joint(machine: ReducedMachine) -> ReducedMachine:
    """Return a machine without contact elements that behaves like this one near its preload.

    The joint's conductance becomes part of the conduction, and its stiffness part of the
    displacement per temperature.

    Raises
    ------
    InputError
        It has a moving axis, something other than heat acts on it, or it starts warm.
    """
    if machine.guide is not None:
        raise InputError("kalman-linear: knows no moving axis; take joint-aware")
    if machine.acting is not None or machine.start.any():
        raise InputError(
            "kalman-linear: knows no loads, bolts or initial temperatures; take joint-aware"
        )
    elastic, held = machine.elastic, machine.at_preload
    nothing = np.zeros(0)
    return replace(
        machine,
        conduction=machine.conduction + machine.jump.T @ (held[:, None] * machine.jump),
        jump=machine.jump[:0],
        mean=machine.mean[:0],
        elastic=replace(
            elastic,
            compliance=np.zeros((0, 0)),
            thermal_gap=elastic.thermal_gap[:0],
            probe_compliance=elastic.probe_compliance[:, :0],
            probe_thermal=sticking_tangent(own_modes(machine), machine.laws),
            reference=nothing,
            area=nothing,
        ),
        joints=(),
    )


def calibrate_linear_joint(
    machine: ReducedMachine,
    responses: Mapping[str, xr.Dataset],
    noise: Noise | None = None,
    fitted: Sequence[str] | None = None,
    effort: Effort = USUAL,
) -> JointAwareCalibration:
    """Return the Kalman filter of a machine; as `calibrate.joint_aware.calibration`."""
    # Its joint is known to be wrong, which is no evidence about the other parameters.
    effort = replace(effort, search=replace(effort.search, doubted=1.0))
    calibrated = calibrate_machine(with_linear_joint(machine), responses, noise, fitted, effort)
    return replace(calibrated, model=replace(calibrated.model, kind="kalman-linear"))
