"""Import of python-control, an optional dependency."""

from __future__ import annotations

from types import ModuleType

from thermojoint.artefacts.errors import InputError


def python_control() -> ModuleType:
    """Return python-control.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        import control
    except ImportError as error:
        raise InputError(
            "heater: its transfer functions need python-control; pip install 'thermojoint[control]'"
        ) from error
    return control
