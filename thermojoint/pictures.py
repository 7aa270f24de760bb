"""Scenes to PNG files: with pyvista off-screen where that works, else with matplotlib.

VTK can end the whole process where there is no OpenGL, so it renders in a process of its own
(``python -m thermojoint.pictures scene.npz picture.png ...``). What it leaves undone is drawn by
matplotlib, and the picture says so.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

from artefacts.files import whole_file
from thermojoint.figures import check_png, write_figure
from thermojoint.scene_file import load_scene, save_scene
from thermojoint.scenes import Array, Panel, Scene, Surface

#: A renderer that takes longer than this hangs, s.
TIMEOUT_S = 180.0
_COLOURS = "viridis"
_PANEL_PIXELS = (900, 800)
_BAR = {
    "vertical": True,
    "position_x": 0.86,
    "position_y": 0.2,
    "height": 0.6,
    "width": 0.06,
    "n_labels": 5,
    "color": "black",
    "title_font_size": 16,
    "label_font_size": 16,
}


def write_pictures(pictures: Mapping[Path, Scene], pyvista: bool = True) -> dict[Path, str]:
    """Write each scene to its file; every file exists afterwards.

    Parameters
    ----------
    pictures : mapping
        PNG file to scene.
    pyvista : bool
        Try pyvista first.

    Returns
    -------
    dict
        File to the renderer that drew it: "pyvista" or "matplotlib".

    Raises
    ------
    InputError
        A file has another suffix than ``.png``.
    """
    for path in pictures:
        check_png(path)
    drawn = _with_pyvista(pictures) if pyvista and find_spec("pyvista") else {}
    used = {}
    for path, scene in pictures.items():
        if path in drawn:
            with whole_file(path) as part:
                part.write_bytes(drawn[path])
            used[path] = "pyvista"
        else:
            write_figure(matplotlib_picture(scene), path, dpi=110)
            used[path] = "matplotlib"
    return used


def _with_pyvista(pictures: Mapping[Path, Scene]) -> dict[Path, bytes]:
    """Render in another process; what it did not finish is left out."""
    with tempfile.TemporaryDirectory(prefix="thermojoint-") as name:
        folder = Path(name)
        arguments, results = [], {}
        for k, (path, scene) in enumerate(pictures.items()):
            source, results[path] = folder / f"{k}.npz", folder / f"{k}.png"
            save_scene(scene, source)
            arguments += [str(source), str(results[path])]
        # Should it hang, what is finished is used and matplotlib draws the rest.
        with suppress(subprocess.TimeoutExpired):
            subprocess.run(
                [sys.executable, "-m", "thermojoint.pictures", *arguments],
                capture_output=True,
                timeout=TIMEOUT_S,
                check=False,
            )
        return {path: png.read_bytes() for path, png in results.items() if _is_png(png)}


def _is_png(path: Path) -> bool:
    """Tell whether a PNG file is there to its last chunk."""
    return path.is_file() and path.read_bytes()[-8:-4] == b"IEND"


def render(scene: Scene, path: Path) -> None:
    """Draw `scene` with pyvista, off-screen, into `path`; may end the process without OpenGL."""
    import pyvista

    count = len(scene.panels)
    # Its stubs want literals where names are meant.
    plotter: Any = pyvista.Plotter(
        off_screen=True,
        shape=(1, count),
        border=False,
        window_size=[_PANEL_PIXELS[0] * count, _PANEL_PIXELS[1]],
    )
    limits = _limits(scene)
    for k, panel in enumerate(scene.panels):
        plotter.subplot(0, k)
        plotter.set_background("white")
        plotter.add_text(panel.title, font_size=11, color="black", position="upper_edge")
        for surface in panel.surfaces:
            size = np.full((len(surface.faces), 1), surface.faces.shape[1])
            mesh = pyvista.PolyData(surface.points, np.hstack([size, surface.faces]).ravel())
            look: dict[str, Any] = {"opacity": surface.opacity, "show_edges": surface.opacity > 0.5}
            look |= {"edge_color": "#5a5f66", "line_width": 0.5}
            if surface.values is None:
                plotter.add_mesh(mesh, color=surface.colour, ambient=0.35, **look)
            else:
                plotter.add_mesh(
                    mesh,
                    scalars=surface.values,
                    clim=limits,
                    cmap=_COLOURS,
                    lighting=False,  # shading would change what the colours mean
                    scalar_bar_args=_BAR | {"title": scene.bar, "fmt": _number_format(limits[1])},
                    **look,
                )
        for marker in panel.markers:  # one by one: VTK leaves out labels of a set that overlap
            plotter.add_point_labels(
                np.array([marker.position]),
                [f"{marker.label} •" if marker.left else f"• {marker.label}"],
                always_visible=True,
                show_points=False,
                font_size=22,
                text_color="black",
                shape=None,
                justification_horizontal="right" if marker.left else "left",
                justification_vertical="center",
            )
        plotter.view_vector(panel.view, viewup=(0.0, 1.0, 0.0))
    plotter.screenshot(str(path))
    plotter.close()


def matplotlib_picture(scene: Scene) -> Figure:
    """Draw `scene` with matplotlib: the same surfaces, sorted by depth face by face."""
    count = len(scene.panels)
    figure = Figure(figsize=(7.5 * count, 6.8), layout="constrained")
    FigureCanvasAgg(figure)
    norm = Normalize(*_limits(scene))
    for k, panel in enumerate(scene.panels):
        axes = figure.add_subplot(1, count, k + 1, projection="3d")
        axes.set_title(panel.title, fontsize=10)
        every = _turned(np.concatenate([surface.points for surface in panel.surfaces]))
        low, high = every.min(axis=0), every.max(axis=0)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        axes.set_box_aspect(high - low)
        axes.set_axis_off()
        view = _turned(np.array([panel.view]))[0]
        axes.view_init(
            elev=np.degrees(np.arctan2(view[2], np.hypot(view[0], view[1]))),
            azim=np.degrees(np.arctan2(view[1], view[0])),
        )
        axes.add_collection3d(_polygons(panel, norm))
        for marker in panel.markers:
            x, y, z = _turned(np.array([marker.position]))[0]
            text = f"{marker.label} •" if marker.left else f"• {marker.label}"
            side = "right" if marker.left else "left"
            axes.text(x, y, z, text, fontsize=11, zorder=1000, ha=side, va="center")
    if scene.bar:
        figure.colorbar(ScalarMappable(norm, _COLOURS), ax=figure.axes, label=scene.bar, shrink=0.6)
    figure.supxlabel("drawn with matplotlib: pyvista cannot render here", fontsize=8)
    return figure


def _polygons(panel: Panel, norm: Normalize) -> Poly3DCollection:
    """All faces of a panel in one collection, so that they are sorted together."""
    light = np.array([0.3, -0.6, 0.75]) / np.linalg.norm([0.3, -0.6, 0.75])
    polygons: list[Array] = []
    colours = []
    for surface in panel.surfaces:
        corners = _turned(surface.points)[surface.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        facing = np.abs(normal / np.where(length > 0.0, length, 1.0) @ light)
        shade = _base_colours(surface, norm)
        shade[:, :3] *= (0.65 + 0.35 * facing)[:, None]
        shade[:, 3] = surface.opacity
        polygons += list(corners)
        colours.append(shade)
    return Poly3DCollection(
        polygons,
        facecolors=np.concatenate(colours),
        edgecolors=(0.4, 0.4, 0.4, 0.25),
        linewidths=0.3,
    )


def _base_colours(surface: Surface, norm: Normalize) -> Array:
    """Colour of every face, RGBA, shape (m, 4)."""
    if surface.values is None:
        return np.tile(np.array(to_rgba(surface.colour)), (len(surface.faces), 1))
    values = surface.values
    if len(values) == len(surface.points):
        values = values[surface.faces].mean(axis=1)
    return np.asarray(colormaps[_COLOURS](norm(values)), dtype=float)


def _turned(points: Array) -> Array:
    """From y up to z up, as matplotlib has it."""
    return np.column_stack([points[:, 0], -points[:, 2], points[:, 1]])


def _limits(scene: Scene) -> tuple[float, float]:
    """Range of the values drawn over all panels."""
    values = [
        surface.values[surface.faces].ravel()
        if len(surface.values) == len(surface.points)
        else surface.values
        for panel in scene.panels
        for surface in panel.surfaces
        if surface.values is not None
    ]
    if not values:
        return 0.0, 1.0
    every = np.concatenate(values)
    low, high = float(every.min()), float(every.max())
    return (low, high) if high > low else (low, low + 1.0)


def _number_format(largest: float) -> str:
    """Format with three digits or so for numbers up to `largest`."""
    power = int(np.floor(np.log10(abs(largest)))) if largest else 0
    return f"%.{max(0, 2 - power)}f"


def _main(arguments: list[str]) -> None:
    for source, target in zip(arguments[::2], arguments[1::2], strict=True):
        render(load_scene(Path(source)), Path(target))


if __name__ == "__main__":
    _main(sys.argv[1:])
