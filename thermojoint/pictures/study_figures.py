"""Pictures of a batch: fans of curves, every pair of columns, maps of a figure over two values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.figures import WIDTH
from thermojoint.pictures.figures import empty_grid

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: Quantiles of a fan, from the outermost pair inwards; each pair bounds one shade.
PAIRS = ((0.05, 0.95), (0.25, 0.75))
_SHADES, _LINE, _POINT = ("#c9d8ea", "#8fb0d6"), "#1f3f66", "#1f5fa8"
#: Side of a panel of pairs, in.
_SIDE = 1.7


def fan_figure(minutes: Array, curves: Array, label: str) -> Figure:
    """Return the median, the ranges between quantiles, and the extremes of curves.

    `minutes` has shape (times,), `curves` (cases, times): NaN where a case has no value; between
    its own times a case is interpolated.
    """
    figure = empty_grid(1, 1, (WIDTH, 3.4))
    (axes,) = figure.axes
    curves = np.array([_between(minutes, curve) for curve in curves])
    some = ~np.isnan(curves).all(axis=0)
    minutes, curves = minutes[some], curves[:, some]
    for (low, high), shade in zip(PAIRS, _SHADES, strict=True):
        ends = np.nanquantile(curves, [low, high], axis=0)
        name = f"{100 * low:.0f} to {100 * high:.0f} % of the cases"
        axes.fill_between(minutes, *ends, color=shade, label=name, linewidth=0.0)
    axes.plot(minutes, np.nanmedian(curves, axis=0), color=_LINE, label="median")
    for name, extreme in (("extremes", np.nanmin), ("", np.nanmax)):
        axes.plot(minutes, extreme(curves, axis=0), ":", color=_LINE, linewidth=0.8, label=name)
    axes.set_xlabel("time (min)")
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def _between(times: Array, values: Array) -> Array:
    """Return values (n,) with those missing between others interpolated over time.

    Otherwise, of cases with steps of different lengths, neighbouring times had different cases.
    """
    read = ~np.isnan(values)
    if not read.any():
        return values
    return np.interp(times, times[read], values[read], left=np.nan, right=np.nan)


def pair_figure(columns: pd.DataFrame) -> Figure:
    """Return every pair of columns as points, and the distribution of each on the diagonal."""
    names = list(columns)
    count = len(names)
    figure = empty_grid(count, count, (_SIDE * count + 0.6, _SIDE * count + 0.4))
    for at, axes in enumerate(figure.axes):
        row, column = divmod(at, count)
        across, up = columns[names[column]], columns[names[row]]
        if row == column:
            axes.hist(across, bins=20, color=_SHADES[1])
        else:
            axes.plot(across, up, "o", color=_POINT, markersize=2.5, alpha=0.6)
        axes.tick_params(labelsize=6)
        if row == count - 1:
            axes.set_xlabel(_short(names[column]), fontsize=7)
        if column == 0:
            axes.set_ylabel(_short(names[row]), fontsize=7)
    return figure


def map_figure(across: pd.Series, up: pd.Series, height: pd.Series) -> Figure:
    """Return a figure of the cases as colour over two of their values, with contour lines.

    Lines are only drawn if the cases span an area.
    """
    figure = empty_grid(1, 1, (WIDTH, 3.6))
    (axes,) = figure.axes
    points = axes.scatter(across, up, c=height, cmap="viridis", s=24, zorder=3)
    if _span_an_area(across.to_numpy(), up.to_numpy()) and np.ptp(height):
        lines = axes.tricontour(across, up, height, levels=7, colors="0.4", linewidths=0.7)
        axes.clabel(lines, fontsize=7)
        axes.use_sticky_edges = False
        axes.autoscale()
    figure.colorbar(points, label=str(height.name))
    axes.set_xlabel(str(across.name))
    axes.set_ylabel(str(up.name))
    return figure


def strongest(columns: pd.DataFrame, paths: Sequence[str], figure: str) -> list[str]:
    """Return the paths of a figure by the size of their rank correlation with it, largest first."""
    ranks = columns.rank()
    sizes = {path: abs(ranks[path].corr(ranks[figure])) for path in paths}
    return sorted(paths, key=lambda path: -np.nan_to_num(sizes[path]))


def _span_an_area(across: Array, up: Array) -> bool:
    """Whether a triangulation of the points exists: more than three, not on one line."""
    spread = np.ptp(across), np.ptp(up)
    if across.size < 4 or not all(spread):
        return False
    centred = np.column_stack([across / spread[0], up / spread[1]])
    return bool(np.linalg.svd(centred - centred.mean(axis=0), compute_uv=False)[1] > 1e-6)


def _short(name: str) -> str:
    """Return the last two parts of a path, one below the other."""
    return "\n".join(name.split(".")[-2:])
