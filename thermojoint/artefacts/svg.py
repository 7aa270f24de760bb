"""A figure as SVG that depends on nothing but the figure."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def as_svg(figure: Figure, salt: str) -> bytes:
    """Return a figure as SVG, the same bytes for the same figure.

    Parameters
    ----------
    figure : Figure
    salt : str
        Makes the names inside differ from those of another kind of figure on the same page.
    """
    import matplotlib as mpl

    target = BytesIO()
    with mpl.rc_context({"svg.hashsalt": salt}):
        figure.savefig(target, format="svg", metadata={"Date": None})
    return target.getvalue()
