"""Tornado picture: the largest effects on a figure as bars, one panel for each figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from thermojoint.pictures.figures import empty_grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Largest number of bars of a panel.
MOST = 12
_RISES, _FALLS = "#b2341f", "#1f5fa8"


@dataclass(frozen=True)
class Panel:
    """One panel."""

    #: Name of the figure.
    title: str
    #: Label of the effects, with their unit.
    axis: str
    #: Names of the bars, the largest first.
    names: Sequence[str]
    #: Lengths of the bars, and of their error bars.
    effects: Sequence[float]
    errors: Sequence[float]


def tornado_figure(panels: Sequence[Panel]) -> Figure:
    """Return the picture; effects that raise a figure are red, those that lower it blue."""
    tallest = max(min(len(panel.names), MOST) for panel in panels)
    figure = empty_grid(len(panels), 1, (7.0, len(panels) * (1.0 + 0.26 * tallest)))
    for axes, panel in zip(figure.axes, panels, strict=True):
        names, effects = panel.names[:MOST], panel.effects[:MOST]
        colours = [_RISES if effect >= 0.0 else _FALLS for effect in effects]
        axes.barh(range(len(names)), effects, color=colours, xerr=panel.errors[:MOST], height=0.7)
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.invert_yaxis()
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.grid(axis="x", alpha=0.3)
        axes.set_title(panel.title, loc="left", fontsize=10)
        axes.set_xlabel(panel.axis)
    return figure
