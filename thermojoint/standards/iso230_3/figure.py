"""Figure of a test: displacement, tilt and temperature against time, with the parameters marked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.figures import SHADES, WIDTH, legend_above, stacked_panels
from thermojoint.standards.iso230_3.evaluation import Evaluation
from thermojoint.standards.iso230_3.parameters import FIRST, Parameter
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import Quantity, Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Quantity to the factor from SI and the axis label.
SHOWN: dict[Quantity, tuple[float, str, str]] = {
    "displacement": (1e6, "µm", "displacement (µm)"),
    "tilt": (1e6, "µm/m", "tilt (µm/m)"),
    "temperature": (1.0, "K", "temperature (°C or K)"),
}
_STYLES = ("-", "--", "-.", ":")
#: Time shown before and after the test, relative to its length.
_BEFORE, _AFTER = 0.1, 0.5
#: Width of the column of a range, and largest width of all columns, relative to the panel.
_COLUMN, _COLUMNS = 0.06, 0.6
#: In a panel with more ranges than this, only those over the whole period are drawn.
_MOST = 8
#: Space between a label and its arrow, pt.
_GAP = 3.5


def figure_of(record: Record, evaluation: Evaluation) -> Figure:
    """Return the figure: a panel for each quantity, one above the other, time in hours.

    To the right of the curves an arrow spans the range of each displacement and tilt over each
    period (with many ranges only over the whole one); dots on the curves mark its ends. Vertical
    lines are the ends of the periods.
    """
    groups = {
        quantity: channels
        for quantity, channels in record.channels.items()
        if channels or quantity == "displacement"
    }
    figure, panels = stacked_panels(len(groups), WIDTH, 0.5 + 3.0 * len(groups))
    first, last = _shown(record, evaluation)
    inside = (record.times >= first) & (record.times <= last)
    marked = {quantity: _drawn(evaluation, quantity) for quantity in ("displacement", "tilt")}
    columns = max(map(len, marked.values())) + 0.5 * bool(any(marked.values()))
    taken = min(_COLUMN * columns, _COLUMNS)
    column = (last - first) * taken / (1.0 - taken) / max(columns, 1.0)
    for panel, (quantity, channels) in zip(panels, groups.items(), strict=True):
        shown = {name: values[inside] for name, values in channels.items()}
        _draw(panel, record.times[inside], quantity, shown)
        _mark_periods(panel, evaluation)
        if quantity != "temperature":
            _mark_ranges(panel, list(channels), marked[quantity], (last, column))
    panels[-1].set_xlim(first / 3600.0, (last + columns * column) / 3600.0)
    panels[-1].set_xlabel("time (h)")
    return figure


def _drawn(evaluation: Evaluation, quantity: str) -> list[Parameter]:
    every = [one for one in evaluation.parameters if one.quantity == quantity]
    if len(every) <= _MOST:
        return every
    return [one for one in every if one.period == evaluation.period]


def _shown(record: Record, evaluation: Evaluation) -> tuple[float, float]:
    """Return the range of time shown, s: the test and some time before and after it."""
    begin, end = evaluation.period
    first = max(float(record.times[0]), begin - _BEFORE * evaluation.period.length)
    last = min(float(record.times[-1]), end + _AFTER * evaluation.period.length)
    return first, last


def _draw(panel: Axes, times: Array, quantity: Quantity, channels: Mapping[str, Array]) -> None:
    factor, _, label = SHOWN[quantity]
    for k, (name, values) in enumerate(channels.items()):
        read = np.isfinite(values)
        panel.plot(
            times[read] / 3600.0,
            factor * values[read],
            color=_shade(k),
            linestyle=_STYLES[(k // len(SHADES)) % len(_STYLES)],
            linewidth=1.2,
            label=name,
        )
    panel.set_ylabel(label)
    panel.grid(visible=True, color="0.88", linewidth=0.6)
    legend_above(panel)


def _mark_periods(panel: Axes, evaluation: Evaluation) -> None:
    begin, end = evaluation.period
    moments = [begin, end]
    if evaluation.protocol is not Protocol.ETVE:
        moments.insert(1, begin + FIRST)
    for moment in moments:
        panel.axvline(moment / 3600.0, color="0.4", linewidth=0.8, linestyle=":")


def _mark_ranges(
    panel: Axes, channels: list[str], parameters: list[Parameter], columns: tuple[float, float]
) -> None:
    """Draw an arrow from the lowest to the highest value of a period, each in its own column.

    `columns` is the start of the columns, and their width, s.
    """
    last, width = columns
    for column, parameter in enumerate(parameters, start=1):
        k = channels.index(parameter.channel)
        factor = SHOWN[parameter.quantity][0]
        extremes = parameter.extremes
        at = (last + column * width) / 3600.0
        low, high = factor * extremes.low, factor * extremes.high
        arrow = {
            "arrowstyle": "<->",
            "color": _shade(k),
            "linewidth": 0.9,
            "shrinkA": 0.0,
            "shrinkB": 0.0,
        }
        panel.annotate("", xy=(at, low), xytext=(at, high), arrowprops=arrow)
        middle = 0.5 * (low + high)
        panel.annotate(
            parameter.symbol,
            (at, middle),
            (-_GAP, 0.0),
            textcoords="offset points",
            color=_shade(k),
            fontsize=8,
            rotation=90,
            ha="right",
            va="center",
        )
        for moment, value in ((extremes.low_at, low), (extremes.high_at, high)):
            panel.plot(moment / 3600.0, value, "o", markersize=2.5, color=_shade(k))


def _shade(index: int) -> str:
    return SHADES[index % len(SHADES)]
