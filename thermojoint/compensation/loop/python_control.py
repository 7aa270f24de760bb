"""Import of python-control, an optional dependency."""

from __future__ import annotations

from types import ModuleType

from thermojoint.artefacts.extras import require


def python_control() -> ModuleType:
    """Return python-control.

    Raises
    ------
    InputError
        It is not installed.
    """
    require("heater: its transfer functions", "control", "control")
    import control

    return control
