"""A log as a picture: one panel for each quantity over the same time, pauses in grey."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.figures import stacked_panels
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import Column
from thermojoint.pictures.figures import mark_alone, write_figure

#: Largest number of points of a curve in a panel.
_POINTS = 8000
_HOUR = 3600.0
_LABELS = {
    "temperature": "temperature ({})",
    "length": "displacement (µm)",
    "position": "position (mm)",
    "way": "way (m)",
    "speed": "speed (rpm)",
    "feed": "feed (mm/s)",
    "power": "power (W)",
    "current": "current (A)",
    "torque": "torque (N m)",
    "load": "load (%)",
}
#: From SI to the unit of the label: scale and zero.
_SHOWN = {
    "length": (1e6, 0.0),
    "position": (1e3, 0.0),
    "speed": (30.0 / np.pi, 0.0),
    "feed": (1e3, 0.0),
    "load": (100.0, 0.0),
}


def write_log_picture(log: Log, path: Path) -> None:
    """Draw every column of a log over the hours since its first sample, as PNG.

    A run whose clock restarts is drawn after the previous one.
    """
    shown = {column.name: _shown(column) for column in log.columns}
    quantities = [quantity for quantity in _LABELS if quantity in shown.values()]
    figure, panels = stacked_panels(len(quantities), 9.0, 1.0 + 2.2 * len(quantities))
    hours = _hours(log)
    for panel, quantity in zip(panels, quantities, strict=True):
        scale, zero = _SHOWN.get(quantity, (1.0, 0.0))
        columns = [column for column in log.columns if shown[column.name] == quantity]
        for column in columns:
            absolute = quantity == "temperature" and column.unit != "K"
            values = scale * log.at(column.name) - (273.15 if absolute else zero)
            drawn = _drawn(values)
            (curve,) = panel.plot(hours[drawn], values[drawn], linewidth=1.0, label=column.name)
            mark_alone(curve)
        for begin, end in _pauses(log):
            panel.axvspan(begin, end, color="0.9", linewidth=0.0)
        # Columns in K are drawn in K: they may be above an ambient.
        units = sorted({"K" if column.unit == "K" else "°C" for column in columns})
        panel.set_ylabel(_LABELS[quantity].format(" and ".join(units)))
        panel.grid(alpha=0.3)
        panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)
    panels[-1].set_xlabel("time since the first sample (h)")
    write_figure(figure, path, dpi=110)


def _shown(column: Column) -> str:
    """Return the panel of a column: a stroke or a way would hide displacements."""
    if column.quantity != "length" or column.is_displacement:
        return column.quantity
    return "position" if column.is_position else "way"


def _drawn(values: Array) -> NDArray[np.int64]:
    """Return the indices, increasing, of at most `_POINTS` of values (n,) that show them.

    Of each stretch these are its lowest and its highest reading, so that a single misreading is
    seen; of one without readings any sample, so that the gap is.
    """
    length = max(1, -(-2 * values.size // _POINTS))
    stretches = np.full((-(-values.size // length), length), np.nan)
    stretches.ravel()[: values.size] = values
    lowest, highest = (
        np.where(np.isnan(stretches), np.inf, sign * stretches).argmin(axis=1)
        for sign in (1.0, -1.0)
    )
    begins = length * np.arange(len(stretches))
    return np.unique(np.concatenate([begins + lowest, begins + highest]))


def _hours(log: Log) -> np.ndarray:
    """Return the hours since the first sample; a run whose time restarts is appended."""
    steps = np.diff(log.times, prepend=log.times[0])
    steps[list(log.starts)] = 0.0
    return np.asarray(np.cumsum(steps) / _HOUR)


def _pauses(log: Log) -> list[tuple[float, float]]:
    if len(log.starts) > 1:
        return []
    return [
        ((begin - log.times[0]) / _HOUR, (end - log.times[0]) / _HOUR)
        for record in log.records
        for begin, end in record.pauses
    ]
