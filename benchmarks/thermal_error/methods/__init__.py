"""The methods of the leaderboard: name to a function of a training log and a test log."""

from __future__ import annotations

from pkgutil import resolve_name

from benchmarks.thermal_error.scoring import Method
from thermojoint.artefacts.errors import InputError

#: Name to module:function, loaded when it is asked for.
METHODS = {
    "none": "benchmarks.thermal_error.methods.regressions:nothing",
    "mlr": "benchmarks.thermal_error.methods.regressions:multiple_linear",
    "ridge": "benchmarks.thermal_error.methods.regressions:ridge",
    "arx": "benchmarks.thermal_error.methods.regressions:autoregression",
    "learned": "benchmarks.thermal_error.methods.learning:learned",
    "linear": "benchmarks.thermal_error.methods.generalised:linear",
    "fchs": "benchmarks.thermal_error.methods.generalised:fchs",
    "kalman-linear": "benchmarks.thermal_error.methods.machine_physics:kalman_linear",
    "joint-aware": "benchmarks.thermal_error.methods.machine_physics:joint_aware",
}


def method_named(text: str) -> tuple[str, Method]:
    """Return name and function of a method: one of `METHODS`, or ``package.module:function``.

    Raises
    ------
    InputError
        There is no such name, module or function, or the module fails.
    """
    place = METHODS.get(text, text)
    if ":" not in place:
        raise InputError(
            f"--method {text}: known are {', '.join(METHODS)}; or give package.module:function"
        )
    try:
        found = resolve_name(place)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"--method {text}: cannot be loaded ({error}); is it on the path?"
        ) from error
    except Exception as error:
        raise InputError(f"--method {text}: {type(error).__name__}, {error}") from error
    if not callable(found):
        raise InputError(f"--method {text}: is no function; give one of (training, test)")
    return text, found
