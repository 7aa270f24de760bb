"""What a model file says of its origin, gathered from the calibrations."""

from __future__ import annotations

from importlib.metadata import version

from calibrate.fictitious import FictitiousCalibration
from calibrate.fit_result import report
from calibrate.linear import LinearCalibration
from calibrate.model_file import Provenance

_MICRO = 1e6


def provenance_of(
    linear: LinearCalibration, fictitious: FictitiousCalibration, case: str
) -> Provenance:
    """Return errors (K, µm), fit reports and versions of a calibration.

    Parameters
    ----------
    linear, fictitious : LinearCalibration, FictitiousCalibration
        Tables 1, and 2 and 3.
    case : str
        The case (text) or the name of what was measured.
    """
    axes = [name for name in linear.fits if name.startswith("deformation.")]
    kelvin = {"thermal": linear.fits["thermal"].max_abs_error}
    kelvin |= {f"direct.{role}": error for role, error in linear.direct_errors.items()}
    kelvin |= {"sources": fictitious.joint.fit.max_abs_error}
    micro = {name: _MICRO * linear.fits[name].max_abs_error for name in axes}
    micro |= {
        f"sources.{level}.{axis}": _MICRO * error
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
        reports={name: report(name, fit) for name, fit in fits.items()},
    )
