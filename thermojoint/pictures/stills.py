"""PNG files of scenes: panels with titles, labels, axes and colour bars on one sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from thermojoint.artefacts.units import MEGA
from thermojoint.pictures.colour_scale import ColourScale
from thermojoint.pictures.figures import check_png, write_figure
from thermojoint.pictures.labels import place_labels
from thermojoint.pictures.renderer import Pixels, painted, pixel_size, rendered
from thermojoint.pictures.scenes import Curve, Panel, Scene, finished

#: Height of the panels of a still picture, pixels.
HEIGHT = 840
FALLBACK_NOTE = "drawn with matplotlib: pyvista cannot render here"
#: Measures of a sheet, inches; the height of a panel does not depend on its pixels.
_PANEL, _ABOVE, _BELOW, _GAP = 6.0, 0.75, 0.95, 0.2
_TRIAD = 0.85
_PAST: dict[str, Any] = {"linewidth": 2.2, "marker": "o", "markevery": [-1]}
#: Width of the curve beside the panels, inches, with room for its labels on the left.
_CURVE, _LABELS, _MINUTE = 4.2, 0.85, 60.0
_ARROW: dict[str, Any] = {"arrowstyle": "-|>", "lw": 1.4, "shrinkA": 0, "shrinkB": 0}


@dataclass(frozen=True)
class Sheet:
    """A figure and its parts that change from scene to scene of a film."""

    figure: Figure
    images: tuple[AxesImage, ...]
    caption: Text
    curves: tuple[Line2D, ...] = ()

    def show(self, scene: Scene, images: Sequence[Pixels]) -> None:
        """Change to another scene of the same film."""
        for artist, image in zip(self.images, images, strict=True):
            artist.set_data(image)
        self.caption.set_text(scene.caption)
        if scene.curve is not None:
            for line, values in zip(self.curves, scene.curve.displacement.T, strict=True):
                past = scene.curve.times <= scene.curve.now * (1.0 + 1e-9)
                line.set_data(scene.curve.times[past] / _MINUTE, MEGA * values[past])


def write_pictures(pictures: Mapping[Path, Scene], height: int = HEIGHT) -> dict[Path, str]:
    """Write each scene to its PNG file, with pyvista if possible; panels `height` pixels high.

    The result maps each file to its renderer: "pyvista" or "matplotlib".

    Raises
    ------
    InputError
        A file has another suffix than ``.png``.
    """
    for path in pictures:
        check_png(path)
    films = [finished([scene]) for scene in pictures.values()]
    used = {}
    for path, (scene,), images in zip(pictures, films, rendered(films, height), strict=True):
        write_figure(sheet(scene, images, height).figure, path, dpi=height / _PANEL)
        used[path] = "matplotlib" if images is None else "pyvista"
    return used


def sheet(scene: Scene, images: Sequence[Pixels] | None, height: int) -> Sheet:
    """Lay out a `finished` scene: panels, labels, axes, bars.

    The images are those of `renderer.rendered`, `height` pixels high; without them the panels are
    painted here.
    """
    widths = [_PANEL * pixel_size(panel.frame, height)[0] / height for panel in scene.panels]
    lefts = _GAP + np.concatenate([[0.0], np.cumsum(np.add(widths, _GAP))])
    total, high = float(lefts[-1]), _ABOVE + _PANEL + _BELOW
    if scene.curve is not None:
        total += _LABELS + _CURVE + _GAP
    figure = Figure(figsize=(total, high), dpi=height / _PANEL)
    FigureCanvasAgg(figure)
    caption = figure.text(0.5, 1.0 - 0.12 / high, scene.caption, fontsize=12, ha="center", va="top")
    if images is None:
        note = 1.0 - _GAP / total
        figure.text(note, 0.03 / high, FALLBACK_NOTE, fontsize=7, ha="right", va="bottom")
    shown = images if images is not None else [painted(panel, height) for panel in scene.panels]
    artists = []
    before = None
    for panel, image, left, width in zip(scene.panels, shown, lefts, widths, strict=False):
        axes = figure.add_axes((left / total, _BELOW / high, width / total, _PANEL / high))
        axes.set_axis_off()
        artists.append(axes.imshow(image, extent=panel.frame, aspect="auto"))
        axes.set(xlim=panel.frame[:2], ylim=panel.frame[2:])
        axes.set_title(panel.title, fontsize=11)
        _name_points(axes, panel)
        if panel.camera != before:
            corner = (left / total, 0.05 / high, _TRIAD / total, _TRIAD / high)
            _draw_triad(figure.add_axes(corner), panel)
        before = panel.camera
    for scale, start, end in _bars(scene, lefts, widths):
        across = min(end - start, 1.2 * _PANEL)
        left = start + 0.5 * (end - start - across)
        bar = figure.add_axes((left / total, 0.58 / high, across / total, 0.2 / high))
        _draw_bar(bar, scale)
    curves: tuple[Line2D, ...] = ()
    if scene.curve is not None:
        left = float(lefts[-1]) + _LABELS
        place = (left / total, _BELOW / high, _CURVE / total, _PANEL / high)
        curves = _draw_curve(figure.add_axes(place), scene.curve)
    sheet = Sheet(figure, tuple(artists), caption, curves)
    sheet.show(scene, shown)
    return sheet


def _draw_curve(axes: Axes, curve: Curve) -> tuple[Line2D, ...]:
    """Draw the whole run with thin lines; return the lines up to the present, still empty."""
    minutes, lines = curve.times / _MINUTE, []
    for k, (name, values) in enumerate(zip(curve.axes, curve.displacement.T, strict=True)):
        axes.plot(minutes, MEGA * values, color=f"C{k}", linewidth=0.8, alpha=0.4)
        lines += axes.plot([], [], label=name, color=f"C{k}", **_PAST)
    axes.set_title(curve.title, fontsize=11)
    axes.set_xlabel("time (min)")
    axes.set_ylabel("displacement (µm)")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return tuple(lines)


def _bars(
    scene: Scene, lefts: np.ndarray, widths: Sequence[float]
) -> list[tuple[ColourScale, float, float]]:
    """Colour scales with the left and the right end of their bars, inches.

    Adjacent panels with the same scale and camera share a bar.
    """
    bars: list[tuple[ColourScale, float, float]] = []
    before = None
    for panel, left, width in zip(scene.panels, lefts, widths, strict=False):
        if panel.scale is not None:
            start = float(left) + _TRIAD + _GAP
            if bars and before == (panel.scale, panel.camera):
                start = bars.pop()[1]
            bars.append((panel.scale, start, float(left + width)))
        before = (panel.scale, panel.camera)
    return bars


def _draw_bar(axes: Axes, scale: ColourScale) -> None:
    bar = axes.figure.colorbar(
        ScalarMappable(scale.norm, scale.colours),
        cax=axes,
        orientation="horizontal",
        spacing="uniform",
        ticks=list(scale.levels),
    )
    bar.ax.set_xticklabels([f"{level:.4g}" for level in scale.levels], fontsize=9)
    bar.ax.minorticks_off()
    bar.set_label(scale.title, fontsize=10)


def _draw_triad(axes: Axes, panel: Panel) -> None:
    """Draw the directions x, y and z as the panel's camera sees them."""
    axes.set(xlim=(-1.4, 1.4), ylim=(-1.4, 1.4))
    axes.set_axis_off()
    arrows = panel.camera.project(np.eye(3))
    for k in np.argsort(arrows[:, 2]):  # the arrow towards the eye last
        name, colour = "xyz"[k], ("#c0392b", "#2e7d32", "#1f5fa8")[k]
        x, y = arrows[k, :2]
        axes.annotate("", (x, y), (0.0, 0.0), arrowprops=_ARROW | {"color": colour})
        away = np.array([x, y]) / max(np.hypot(x, y), 0.35)
        along, above = np.array([x, y]) + 0.28 * away
        axes.text(along, above, name, color=colour, fontsize=10, ha="center", va="center")


def _name_points(axes: Axes, panel: Panel) -> None:
    """Write the markers' labels without overlaps, with lines to their points."""
    if not panel.markers:
        return
    points = panel.camera.project(np.array([marker.position for marker in panel.markers]))[:, :2]
    axes.plot(*points.T, "o", color="black", markersize=4, markeredgecolor="white")
    texts = [
        axes.text(0.0, 0.0, marker.label, fontsize=11, weight="bold", ha="center", va="center")
        for marker in panel.markers
    ]
    scale = (panel.frame[3] - panel.frame[2]) / axes.get_window_extent().height
    boxes = [text.get_window_extent() for text in texts]
    sizes = scale * np.array([(box.width + 6.0, box.height + 2.0) for box in boxes])
    for text, point, middle in zip(
        texts, points, place_labels(points, sizes, panel.frame), strict=True
    ):
        text.set_position(middle)
        text.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
        axes.plot(*np.transpose([point, middle]), color="black", linewidth=0.7, zorder=1.5)
