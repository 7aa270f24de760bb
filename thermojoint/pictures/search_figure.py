"""Picture of a search: progress of the aim, and positions of the cases in the ranges."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.pictures.figures import empty_grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HELD, _BROKEN, _FOUND = "#1f5fa8", "#bbbbbb", "#b2341f"


def search_figure(
    name: str, aims: Array, held: Flags, values: Mapping[str, Array], found: int
) -> Figure:
    """Return the picture: the aim over each value, the optimum as a red star.

    All arrays have shape (cases,): the aims, NaN without a result; whether all limits hold; the
    varied values, by path. `found` is the index of the optimum.
    """
    figure = empty_grid(len(values), 1, (7.0, 0.6 + 2.2 * len(values)))
    usable = ~np.isnan(aims)
    for axes, (path, column) in zip(figure.axes, values.items(), strict=True):
        for which, colour, label in (
            (usable & ~held, _BROKEN, "a limit does not hold"),
            (usable & held, _HELD, "all limits hold"),
        ):
            if which.any():
                axes.plot(column[which], aims[which], "o", color=colour, ms=4, label=label)
        axes.plot(column[found], aims[found], "*", color=_FOUND, ms=13, label="found")
        axes.set_xlabel(path)
        axes.set_ylabel(name, fontsize=8)
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    return figure
