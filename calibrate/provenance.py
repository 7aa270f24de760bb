"""Provenance of a model file, from the calibrations."""

from __future__ import annotations

from importlib.metadata import version

from calibrate.chain import Calibrated
from calibrate.fit_result import report
from calibrate.source_thermal import largest_ratio
from thermojoint.artefacts.units import MEGA
from thermojoint.models.model_file import Provenance


def provenance_of(calibrated: Calibrated, case: str) -> Provenance:
    """Return errors (K, µm), fit reports, active bounds and versions of a calibration.

    Parameters
    ----------
    calibrated : Calibrated
        Tables 1-3.
    case : str
        The case (text) or the name of the measured object.
    """
    linear, fictitious = calibrated.linear, calibrated.fictitious
    axes = [name for name in linear.fits if name.startswith("deformation.")]
    kelvin = {"thermal": linear.fits["thermal"].max_abs_error}
    kelvin |= {f"direct.{role}": error for role, error in linear.direct_errors.items()}
    kelvin |= {"sources": fictitious.joint.fit.max_abs_error}
    micro = {name: MEGA * linear.fits[name].max_abs_error for name in axes}
    micro |= {
        f"sources.{level}.{axis}": MEGA * error
        for axis, errors in fictitious.deformation_errors.items()
        for level, error in errors.items()
    }
    fits = dict(linear.fits) | {"sources": fictitious.joint.fit}
    fits |= {f"sources.{axis}": fit for axis, fit in fictitious.deformation_fits.items()}
    return Provenance(
        case=case,
        versions={name: version(name) for name in ("thermojoint", "numpy", "scipy")},
        max_abs_error_K=kelvin,
        max_abs_error_um=micro,
        reports={name: report(name, fit) for name, fit in fits.items()}
        | {"averaging": averaging_report(calibrated)},
        at_bound={name: list(fit.at_bound) for name, fit in fits.items() if fit.at_bound},
    )


def averaging_report(calibrated: Calibrated) -> str:
    """Return as text how the loop of Figure 4 ended and how well inputs separate the sources."""
    averaging, joint = calibrated.averaging, calibrated.fictitious.joint
    alone, ratio = averaging.result.fit, largest_ratio(joint, averaging.result)
    differ = f"differ, by up to {ratio:.3g} times"
    return "\n".join(
        [
            "averaging, the loop of Figure 4; the model uses the joint fit, sources",
            f"  {averaging.reason}",
            f"  a and alpha of the two {'agree within 1 %' if ratio < 1.01 else differ}",
            f"  error: max {alone.max_abs_error:.3g} K, rms {alone.rms_error:.3g} K; "
            f"joint fit: max {joint.fit.max_abs_error:.3g} K, rms {joint.fit.rms_error:.3g} K",
            f"  condition number of the strengths {calibrated.fictitious.strength_condition:.2g}",
        ]
    )
