"""Storage of a scene for a renderer in another process."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermojoint.pictures.camera import Array, Camera
from thermojoint.pictures.colour_scale import ColourScale
from thermojoint.pictures.scenes import Marker, Panel, Scene, Surface


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
        if panel.close_to is not None:
            arrays[f"{p}.close_to"] = panel.close_to
        panels.append(
            {
                "title": panel.title,
                "surfaces": surfaces,
                "camera": asdict(panel.camera),
                "markers": [[list(marker.position), marker.label] for marker in panel.markers],
                "shows": panel.shows,
                "window": panel.window,
                "scale": None if panel.scale is None else asdict(panel.scale),
            }
        )
    head = np.array(json.dumps({"caption": scene.caption, "panels": panels}))
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
            camera, window, scale = panel["camera"], panel["window"], panel["scale"]
            panels.append(
                Panel(
                    panel["title"],
                    surfaces,
                    Camera(tuple(camera["view"]), tuple(camera["up"])),
                    tuple(Marker(tuple(at), label) for at, label in panel["markers"]),
                    panel["shows"],
                    file.get(f"{p}.close_to"),
                    None if window is None else tuple(window),
                    scale and ColourScale(scale["label"], tuple(scale["levels"]), scale["even"]),
                )
            )
    return Scene(tuple(panels), head["caption"])
