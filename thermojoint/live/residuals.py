"""Residuals, reading minus prediction, of every sensor.

A faulty sensor shows here before and after it is left out; what all sensors have in common is the
model's error.
"""

from __future__ import annotations

import numpy as np

from thermojoint.live.machine import Machine
from thermojoint.live.served import Served


def residuals_of(served: Served, machine: Machine) -> dict[str, float | None] | None:
    """Return the residual of each reading of a machine, K; None before the first sample.

    Parameters
    ----------
    served : Served
        Its kind of estimator may have no residuals; then the result is None.
    machine : Machine
    """
    residuals, usable = served.residuals, machine.usable
    if residuals is None or usable.number == 0:
        return None
    values, _ = served.intake.convert(tuple(usable.readings.tolist()), machine.cold)
    differences = residuals(served.estimator, machine.state, np.array(values)).tolist()
    return {
        name: round(value, 4) if np.isfinite(value) else None
        for name, value in zip(served.layout.readings, differences, strict=False)
    }
