"""The estimators that are judged: each calibrated from a plant's responses, each free-running."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from calibrate.baselines import fit_baselines
from calibrate.chain import calibrate_responses
from calibrate.joint_aware.calibration import Effort, calibrate_machine
from calibrate.joint_aware.linear_joint import calibrate_linear_joint
from calibrate.joint_aware.physics_fit import Search
from calibrate.joint_aware.report import report
from estimator.baselines.kind import regressions
from estimator.fchs.judging import validate
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.readings import samples_in
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import columns_of
from thermojoint.models.sensors import rises
from thermojoint.reduced.loosened import Loosening
from thermojoint.reduced.machine import ReducedMachine

REFERENCE = "step-1.0"


class Errors(NamedTuple):
    """Errors of an estimator in a run.

    `axes`: of the displacement. `error` (n, axes): estimated less actual, m. `band` (n, axes): half
    of the width of 95 %, m; None for an estimator that has none.
    """

    axes: tuple[str, ...]
    error: Array
    band: Array | None


class Known(NamedTuple):
    """What an estimator knows of a plant: `machine` with its sensors, and what else it may have."""

    machine: ReducedMachine
    loosening: Loosening | None


#: A run, and whether it begins on a machine of whose past nothing is known, to estimator -> errors.
Judge = Callable[[xr.Dataset, bool], dict[str, Errors]]


class Calibrated(NamedTuple):
    """Calibrated estimators.

    `judge`: runs them. `report`: of the calibration, for the file.
    """

    judge: Judge
    report: dict[str, object]


def joint_aware(known: Known, responses: Mapping[str, xr.Dataset]) -> Calibrated:
    """Calibrate the joint-aware estimator."""
    # One search for each: that others come to the same is reported for single machines.
    found = calibrate_machine(
        known.machine,
        responses,
        effort=Effort(Search(starts=0)),
        loosening=lambda: known.loosening,
    )
    return Calibrated(observing(JointAware(found.model)), report(found.fit))


def kalman_linear(known: Known, responses: Mapping[str, xr.Dataset]) -> Calibrated:
    """Calibrate the Kalman filter on the machine with a linear joint."""
    found = calibrate_linear_joint(known.machine, responses, effort=Effort(Search(starts=0)))
    return Calibrated(observing(JointAware(found.model)), report(found.fit))


def observing(estimator: JointAware) -> Judge:
    """Return what runs an observer, warm where nothing is known of the start."""

    def judge(response: xr.Dataset, warm: bool) -> dict[str, Errors]:
        state = estimator.warm_state() if warm else estimator.initial_state()
        samples = samples_in(response, estimator.model.sensors)
        found = [one for _, one in follow(estimator, samples, state)]
        actual = columns_of(response, "displacement", estimator.axes)
        error = np.array([one.displacement for one in found]) - actual
        band = np.array([one.band for one in found])
        return {estimator.kind: Errors(estimator.axes, error, band)}

    return judge


def fchs(known: Known, responses: Mapping[str, xr.Dataset]) -> Calibrated:
    """Calibrate FCHS and its linear part by the steps among the responses.

    Raises `ThermojointError`: the sensors give no stable estimator on this plant.
    """
    steps = {name: one for name, one in responses.items() if name.startswith("step-")}
    others = {float(one["heat_input"][-1]): one for name, one in steps.items() if name != REFERENCE}
    calibrated = calibrate_responses(steps[REFERENCE], others)
    axes = tuple(calibrated.model.linear.deformation)

    def judge(response: xr.Dataset, warm: bool) -> dict[str, Errors]:
        # They know of no warm start: the run begins at rest for them.
        del warm
        judged = validate(response, calibrated.model).errors
        return {name: Errors(axes, judged[name], None) for name in ("linear", "fchs")}

    return Calibrated(judge, {})


def baselines(known: Known, responses: Mapping[str, xr.Dataset]) -> Calibrated:
    """Fit the regressions to every response, and add the uncompensated displacement."""
    fitted = regressions(fit_baselines(list(responses.values())), known.machine.step)

    def judge(response: xr.Dataset, warm: bool) -> dict[str, Errors]:
        del warm
        samples = np.column_stack((response["time"].to_numpy(), rises(response))).tolist()
        axes = known.machine.axes
        nothing = -columns_of(response, "displacement", axes)
        found = {"none": Errors(axes, nothing, None)}
        for one in fitted:
            estimates = [each for _, each in follow(one, samples, one.initial_state())]
            actual = columns_of(response, "displacement", one.axes)
            error = np.array([each.displacement for each in estimates]) - actual
            found[one.kind] = Errors(one.axes, error, None)
        return found

    return Calibrated(judge, {})


#: Estimators that are calibrated with a plant's responses; add another one here.
ESTIMATORS: dict[str, Callable[[Known, Mapping[str, xr.Dataset]], Calibrated]] = {
    "joint-aware": joint_aware,
    "kalman-linear": kalman_linear,
    "fchs": fchs,
    "baselines": baselines,
}
#: Those that take nothing but the steps of a calibration.
BY_STEPS = ("fchs",)
