"""Rendering of panels: pyvista off-screen in a separate process, or matplotlib polygons.

Without OpenGL, VTK can terminate the whole process, so it runs in another one
(``python -m thermojoint.pictures.renderer HEIGHT FOLDER ...``), which writes raw pixels to its
standard output. If fewer pictures than announced arrive, the rest are drawn by `painted`.
"""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from typing import IO, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.typing import NDArray

from thermojoint.artefacts.files import temporary_folder
from thermojoint.artefacts.unfinished import cleared_at_stop
from thermojoint.pictures.camera import Array, Camera, Window
from thermojoint.pictures.colour_scale import ColourScale
from thermojoint.pictures.scenes import Panel, Scene, Surface

Pixels = NDArray[np.uint8]

#: Time limit for one picture of the renderer, s.
TIMEOUT_S = 180.0
#: Greys that are visible on light and dark colours.
_LINE, _MESH_LINE = "#9aa0a8", "#7d838b"
#: Edges between faces at a larger angle are drawn, degrees.
_CREASE = 30.0


def pixel_size(window: Window, height: int) -> tuple[int, int]:
    """Width and height in pixels of a picture of a window."""
    left, right, bottom, top = window
    return round(height * (right - left) / (top - bottom)), height


def rendered(films: Sequence[Sequence[Scene]], height: int) -> Iterator[list[Pixels] | None]:
    """Yield the panels of every `finished` scene drawn by pyvista, or None if it cannot draw them.

    The scenes of one film show the same surfaces, moved and recoloured, so one plotter per panel
    suffices. A panel is a picture of shape (height, width, 3).
    """
    scenes = [scene for film in films for scene in film]
    if find_spec("pyvista") is None:
        yield from (None for _ in scenes)
        return
    with temporary_folder() as place:
        folders = [place / f"{k}" for k in range(len(films))]
        for folder, film in zip(folders, films, strict=True):
            folder.mkdir()
            for k, scene in enumerate(film):
                (folder / f"{k:06d}.pickle").write_bytes(pickle.dumps(scene))
        command = [
            sys.executable,
            "-m",
            "thermojoint.pictures.renderer",
            str(height),
            *map(str, folders),
        ]
        with (
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL
            ) as process,
            cleared_at_stop(process.kill),
        ):
            output = process.stdout or io.BytesIO()
            try:
                for scene in scenes:
                    yield _read_panels(process, output, scene, height)
            finally:
                process.kill()


def _read_panels(
    process: subprocess.Popen[bytes], output: IO[bytes], scene: Scene, height: int
) -> list[Pixels] | None:
    """Read the pictures of one scene from the renderer; None if it ends or hangs before."""
    watch = Timer(TIMEOUT_S, process.kill)
    watch.start()
    try:
        pictures = []
        for panel in scene.panels:
            width, _ = pixel_size(panel.frame, height)
            data = output.read(3 * width * height)
            if len(data) < 3 * width * height:
                return None
            pictures.append(np.frombuffer(data, dtype=np.uint8).reshape(height, width, 3))
        return pictures
    finally:
        watch.cancel()


def painted(panel: Panel, height: int) -> Pixels:
    """Draw a panel without OpenGL: faces sorted by depth, the nearest painted last."""
    window = panel.frame
    width, _ = pixel_size(window, height)
    figure = Figure(figsize=(width / 100.0, height / 100.0), dpi=100.0)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=window[:2], ylim=window[2:])
    axes.set_axis_off()
    # Transparent surfaces are painted first: sorted with opaque ones, they would cover these.
    for through in (True, False):
        surfaces = [surface for surface in panel.surfaces if (surface.opacity < 0.5) is through]
        if surfaces:
            axes.add_collection(_polygons(surfaces, panel))
    for surface in panel.surfaces:
        if not surface.opacity:
            points = panel.camera.project(surface.points)[:, :2]
            edges = points[creases(surface.points, surface.faces)]
            axes.add_collection(LineCollection(list(edges), colors=_LINE, linewidths=0.6))
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _polygons(surfaces: Sequence[Surface], panel: Panel) -> PolyCollection:
    """All faces in one collection, sorted together by depth."""
    polygons: list[Array] = []
    colours, depths = [], []
    for surface in surfaces:
        corners = panel.camera.project(surface.points)[surface.faces]
        polygons += list(corners[:, :, :2])
        depths.append(corners[:, :, 2].mean(axis=1))
        colours.append(_face_colours(surface, corners, panel.scale))
    order = np.argsort(np.concatenate(depths), kind="stable")
    faces = np.concatenate(colours)[order]
    edges = faces.copy()
    edges[:, :3] *= 0.9
    edges[faces[:, 3] < 0.5] = 0.0
    return PolyCollection(
        [polygons[k] for k in order], facecolors=faces, edgecolors=edges, linewidths=0.4
    )


def _face_colours(surface: Surface, corners: Array, scale: ColourScale | None) -> Array:
    """Colour of every face, RGBA, shape (m, 4); shaded by direction if there are no values."""
    if surface.values is None or scale is None:
        colour = np.tile(np.array(to_rgba(surface.colour)), (len(surface.faces), 1))
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        light = np.array([0.3, 0.75, 0.6]) / np.linalg.norm([0.3, 0.75, 0.6])
        facing = np.abs(normal / np.where(length > 0.0, length, 1.0) @ light)
        colour[:, :3] *= (0.65 + 0.35 * facing)[:, None]
    else:
        values = surface.values
        if len(values) == len(surface.points):
            values = values[surface.faces].mean(axis=1)
        colour = np.array(scale.colours(scale.norm(values)), dtype=float)
    colour[:, 3] = surface.opacity
    return colour


def creases(points: Array, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Boundary edges and sharp edges of a surface, shape (n, 2)."""
    count = faces.shape[1]
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(len(faces)), count)
    unique, which, shared = np.unique(
        np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    order = np.argsort(which.ravel(), kind="stable")
    first = np.concatenate([[0], np.cumsum(shared)[:-1]])
    face = owner[order[first]]
    other = owner[order[np.minimum(first + 1, len(order) - 1)]]
    # Faces may have either orientation: only the angle between their planes counts.
    bent = np.abs(np.einsum("ni,ni->n", normal[face], normal[other])) < np.cos(np.radians(_CREASE))
    return np.asarray(unique[(shared != 2) | bent])


class _View:
    """A pyvista plotter of one panel, reused for all scenes of a film."""

    def __init__(self, panel: Panel, height: int) -> None:
        import pyvista

        plotter: Any = pyvista.Plotter  # its type stubs are stricter than necessary
        self.plotter = plotter(off_screen=True, window_size=list(pixel_size(panel.frame, height)))
        self.plotter.set_background("white")
        self.plotter.enable_anti_aliasing("ssaa")
        self.meshes = []
        for surface in panel.surfaces:
            size = np.full((len(surface.faces), 1), surface.faces.shape[1])
            mesh = pyvista.PolyData(surface.points, np.hstack([size, surface.faces]).ravel())
            if surface.opacity:
                self._add(mesh, surface, panel.scale)
            edges = creases(surface.points, surface.faces)
            two = np.full((len(edges), 1), 2)
            lines = pyvista.PolyData(surface.points, lines=np.hstack([two, edges]).ravel())
            self.plotter.add_mesh(lines, color=_LINE, line_width=1.5, lighting=False)
            self.meshes.append((mesh, lines))
        self.shown = False

    def _add(self, mesh: Any, surface: Surface, scale: ColourScale | None) -> None:  # noqa: ANN401
        if surface.values is None or scale is None:
            self.plotter.add_mesh(
                mesh,
                color=surface.colour,
                ambient=0.35,
                opacity=surface.opacity,
                show_edges=surface.opacity > 0.5,
                edge_color=_MESH_LINE,
                line_width=0.5,
            )
            return
        data = mesh.point_data if len(surface.values) == len(surface.points) else mesh.cell_data
        data["shown"] = scale.position(surface.values)
        self.plotter.add_mesh(
            mesh,
            scalars="shown",
            clim=(0.0, len(scale.levels) - 1.0),
            cmap=scale.colours,
            n_colors=len(scale.levels) - 1,
            interpolate_before_map=True,
            lighting=False,  # shading would falsify the colours
            show_scalar_bar=False,
        )

    def picture(self, panel: Panel) -> Pixels:
        """Draw the panel of another scene of the same film."""
        for meshes, surface in zip(self.meshes, panel.surfaces, strict=True):
            for mesh in meshes:
                mesh.points = surface.points
            if surface.values is not None and panel.scale is not None:
                meshes[0]["shown"] = panel.scale.position(surface.values)
        _point(self.plotter, panel.camera, panel.frame, panel)
        if self.shown:
            self.plotter.render()
        else:
            # This call also renders; nothing else does.
            self.plotter.show(auto_close=False, interactive=False)
            self.shown = True
        return np.ascontiguousarray(self.plotter.screenshot(return_img=True)[:, :, :3])


def _point(plotter: Any, camera: Camera, window: Window, panel: Panel) -> None:  # noqa: ANN401
    """Set pyvista's camera so that the picture is the window."""
    right, up, towards = camera.basis
    left, right_end, bottom, top = window
    points = np.concatenate([surface.points for surface in panel.surfaces])
    depth = points @ towards
    centre = 0.5 * (left + right_end) * right + 0.5 * (bottom + top) * up
    lens = plotter.camera
    lens.parallel_projection = True
    lens.focal_point = centre + 0.5 * (depth.min() + depth.max()) * towards
    lens.position = np.asarray(lens.focal_point) + (np.ptp(depth) + top - bottom) * towards
    lens.up = up
    lens.parallel_scale = 0.5 * (top - bottom)
    plotter.renderer.reset_camera_clipping_range()


def _main(height: int, folders: Sequence[Path]) -> None:
    # Output of drivers is redirected: standard output is for pixels only.
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)
        for folder in folders:
            views: list[_View] = []
            for file in sorted(folder.iterdir()):
                # Written by the parent process into its private folder.
                panels = pickle.loads(file.read_bytes()).panels
                views = views or [_View(panel, height) for panel in panels]
                for view, panel in zip(views, panels, strict=True):
                    output.write(view.picture(panel).tobytes())
                output.flush()
            for view in views:
                view.plotter.close()


if __name__ == "__main__":
    _main(int(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
