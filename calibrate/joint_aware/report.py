"""Report of a calibration: estimates, uncertainties, value of further runs.

All content is plain numbers and text, as for a JSON file.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calibrate.joint_aware.calibration import JointAwareCalibration
from calibrate.joint_aware.identifiability import further_runs, profiles
from calibrate.joint_aware.physics_fit import Fit
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA
from thermojoint.reduced.parameters import NEW_CONDENSATION

#: Searches agree if their costs are within this of the best, in halves of a squared standard
#: deviation.
AGREE = 0.5
#: A singular value above this is determined by the data: the prior contributes less than a tenth.
DECIDED = 3.0
#: A parameter whose uncertainty is still this fraction of the prior one is undetermined: the data
#: contain less information about it than the prior (1/sqrt(2) is equal information).
PREDICTION_ONLY = 0.7


def report(fit: Fit) -> dict[str, object]:
    """Return the results for the parameters, as content of a JSON file.

    Returns
    -------
    dict
        parameters: factor on the case's value, standard deviation of its logarithm before and
        after, in W/m2K if the name has that unit; directions: singular value and main parameters
        (|weight| > 0.3), with those determined by the data (`DECIDED`); residuals; doubt: factor on
        the assumed errors.
    """
    after = np.sqrt(np.diag(fit.covariance))
    singular, directions = fit.directions
    return {
        "parameters": [
            {
                "parameter": parameter.name,
                "factor": parameter.factor(float(value)),
                "prior_std": parameter.spread,
                "std": float(deviation),
            }
            for parameter, value, deviation in zip(
                fit.parameters, fit.coordinates, after, strict=True
            )
        ],
        "directions": [
            {
                "singular_value": float(value),
                "decided_by": "data" if value > DECIDED else "prior",
                "of": _named(fit, direction),
            }
            for value, direction in zip(singular, directions, strict=True)
        ],
        "residual_temperature_K": fit.residual_temperature.tolist(),
        "residual_displacement_um": (MEGA * fit.residual_displacement).tolist(),
        "doubt": fit.doubt,
        "evaluations": fit.evaluations,
    }


def short_report(calibrated: JointAwareCalibration) -> dict[str, Any]:
    """Return `report` with the information of further runs.

    Returns
    -------
    dict
        Content of `report`; unchecked_runs: those on which the band was not checked; recorded_days:
        those from which deviations from the case are learned, but no parameters;
        unknown_heat_W: standard deviation of the heat of each face that is estimated beside that of
        the sources, zero without it; further_runs:
        standard deviation of every parameter and of the displacement in a day, um, root mean
        square, without and with each.
    """
    machine, fit = calibrated.machine, calibrated.fit
    names = [parameter.name for parameter in fit.parameters]
    return report(fit) | {
        "unchecked_runs": list(calibrated.unchecked),
        "recorded_days": list(calibrated.days),
        "unknown_heat_W": calibrated.unknown_heat,
        "further_runs": [
            {
                "run": further_run.name,
                "std": dict(zip(names, further_run.deviation.tolist(), strict=True)),
                "day_std_um": dict(
                    zip(machine.axes, (MEGA * further_run.day).tolist(), strict=True)
                ),
            }
            for further_run in further_runs(machine, calibrated.runs, fit)
        ],
    }


def whole_report(calibrated: JointAwareCalibration) -> dict[str, Any]:
    """Return `short_report` with the results that need most marches.

    Returns
    -------
    dict
        Content of `short_report`; offsets_K and noise_K of the sensors; prediction_only: parameters
        determined by the prior; starts: cost above the best and distance from the fit, in standard
        deviations, of every search; profiles: factor and cost above the fit of each point;
        condensation: parameters that reuse one, and those that need a new one.
    """
    machine, runs, fit = calibrated.machine, calibrated.runs, calibrated.fit
    sensors = calibrated.model.sensors
    after = np.sqrt(np.diag(fit.covariance))
    names = [parameter.name for parameter in fit.parameters]
    return short_report(calibrated) | {
        "offsets_K": dict(zip(sensors, fit.offset.tolist(), strict=True)),
        "noise_K": dict(zip(sensors, fit.noise.tolist(), strict=True)),
        "prediction_only": [
            name
            for name, share in zip(names, after / fit.spread, strict=True)
            if share > PREDICTION_ONLY
        ],
        "starts": _starts(fit),
        "profiles": [
            {
                "parameter": profile.parameter,
                "factor": profile.factor.tolist(),
                "cost_above_fit": profile.cost.tolist(),
            }
            for profile in profiles(machine, runs, fit)
        ],
        "condensation": {"reuse_one": names, "need_a_new_one": list(NEW_CONDENSATION)},
    }


def _starts(fit: Fit) -> list[dict[str, Any]]:
    if not fit.starts:
        return []
    best = min(start.cost for start in fit.starts)
    known = np.linalg.cholesky(np.linalg.inv(fit.covariance)).T
    return [
        {
            "cost_above_best": start.cost - best,
            "distance": float(np.linalg.norm(known @ (start.reached - fit.coordinates))),
            "agrees": bool(start.cost - best <= AGREE),
        }
        for start in fit.starts
    ]


def _named(fit: Fit, direction: Array) -> dict[str, float]:
    return {
        parameter.name: round(float(weight), 3)
        for parameter, weight in zip(fit.parameters, direction, strict=True)
        if abs(weight) > 0.3
    }
