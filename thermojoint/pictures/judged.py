"""Measured and estimated displacement: one panel each, with the confidence band."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA
from thermojoint.pictures.figures import empty_grid, mark_alone, write_figure

_HOUR = 3600.0


class Judged(NamedTuple):
    """One displacement of one run."""

    #: Run and displacement.
    title: str
    #: Shape (k,): times, s; a further run follows the previous one.
    times: Array
    #: Shape (k,): m; NaN where unknown.
    truth: Array
    estimate: Array
    band: Array


def write_judged(panels: Sequence[Judged], path: Path) -> None:
    """Draw measured and estimated displacements, whole or not at all."""
    figure = empty_grid(len(panels), 1, (9.0, 0.6 + 2.4 * len(panels)))
    axes = figure.axes
    for axis, panel in zip(axes, panels, strict=True):
        steps = np.diff(panel.times, prepend=panel.times[0])
        hours = np.maximum(steps, 0.0).cumsum() / _HOUR
        low, high = (MEGA * (panel.estimate + sign * panel.band) for sign in (-1.0, 1.0))
        if np.isfinite(panel.band).any():
            axis.fill_between(hours, low, high, color="C0", alpha=0.2, linewidth=0.0, label="95 %")
        axis.plot(hours, MEGA * panel.estimate, color="C0", linewidth=1.2, label="estimate")
        (measured,) = axis.plot(hours, MEGA * panel.truth, "black", linewidth=1.0, label="measured")
        mark_alone(measured)
        axis.set_title(panel.title, loc="left", fontsize="medium")
        axis.set_ylabel("displacement (µm)")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", fontsize="small", frameon=False)
    axes[-1].set_xlabel("time since the first sample (h)")
    write_figure(figure, path, dpi=110)
