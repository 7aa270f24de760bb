"""A scene as a file, for a renderer in another process."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermojoint.scenes import Array, Marker, Panel, Scene, Surface


def save_scene(scene: Scene, path: Path) -> None:
    """Write a scene to `path` (NPZ), for a renderer in another process."""
    arrays: dict[str, Array | NDArray[np.int64]] = {}
    panels = []
    for p, panel in enumerate(scene.panels):
        surfaces = []
        for s, surface in enumerate(panel.surfaces):
            key = f"{p}.{s}"
            arrays[f"{key}.points"], arrays[f"{key}.faces"] = surface.points, surface.faces
            if surface.values is not None:
                arrays[f"{key}.values"] = surface.values
            surfaces.append({"colour": surface.colour, "opacity": surface.opacity})
        markers = [[list(marker.position), marker.label, marker.left] for marker in panel.markers]
        panels.append(
            {"title": panel.title, "surfaces": surfaces, "markers": markers, "view": panel.view}
        )
    head = np.array(json.dumps({"bar": scene.bar, "panels": panels}))
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, head=head, **arrays)


def load_scene(path: Path) -> Scene:
    """Read a scene that `save_scene` wrote."""
    with np.load(path, allow_pickle=False) as file:
        head = json.loads(str(file["head"]))
        panels = []
        for p, panel in enumerate(head["panels"]):
            surfaces = tuple(
                Surface(
                    points=file[f"{p}.{s}.points"],
                    faces=file[f"{p}.{s}.faces"],
                    values=file.get(f"{p}.{s}.values"),
                    **look,
                )
                for s, look in enumerate(panel["surfaces"])
            )
            markers = tuple(Marker(tuple(at), label, left) for at, label, left in panel["markers"])
            panels.append(Panel(panel["title"], surfaces, markers, tuple(panel["view"])))
    return Scene(tuple(panels), head["bar"])
