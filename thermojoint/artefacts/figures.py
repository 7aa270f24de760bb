"""Figures of panels one above the other, and figures as SVG for a page."""

from __future__ import annotations

import base64
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Width of a figure of curves in a report, inches: on a page of 400 pixels its smallest text (8 pt)
#: is 9 pixels high.
WIDTH = 4.4
#: Colours of curves, which also differ in greyscale.
SHADES = ("#000000", "#b2341f", "#1f5fa8", "#3c7d3c", "#8a5a00", "#6b4c9a", "#777777")


def legend_above(panel: Axes) -> None:
    """Put the legend above a panel: beside it, it would narrow the panel."""
    panel.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)


def stacked_panels(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure of `count` panels one above the other with a common axis below; inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])


def svg_address(figure: Figure, salt: str) -> str:
    """Return a figure as an SVG data URL; the same figure gives the same text.

    `salt` makes the ids inside differ from those of other figures on the same page.
    """
    import matplotlib as mpl

    target = BytesIO()
    with mpl.rc_context({"svg.hashsalt": salt}):
        figure.savefig(target, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(target.getvalue()).decode('ascii')}"
