"""Films of the fields: temperature, deformation and contact pressure side by side."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.extras import require
from thermojoint.artefacts.files import whole_file
from thermojoint.pictures.renderer import Pixels, painted, rendered
from thermojoint.pictures.scenes import Scene, finished
from thermojoint.pictures.stills import sheet

FRAMES_PER_SECOND = 12
#: Suffix to the height of the panels, pixels: a GIF holds every frame almost uncompressed.
HEIGHTS = {".mp4": 560, ".gif": 400}

Report = Callable[[int, int], None]


def check_film(path: Path) -> None:
    """Refuse a file name that is not a film's, before any work.

    Raises
    ------
    InputError
        The suffix is neither ``.mp4`` nor ``.gif``, or the extra 'view' is not installed.
    """
    if path.suffix.lower() not in HEIGHTS:
        raise InputError(f"{path}: a film is MP4 or GIF; name it {path.stem}.mp4")
    require(f"{path}: a film", "view", "imageio", "imageio_ffmpeg")


def write_film(
    scenes: Sequence[Scene], path: Path, report: Report, height: int | None = None
) -> None:
    """Write one frame for each scene to `path` (MP4, GIF), whole or not at all.

    Camera, window and colour scale are the same for all scenes, which have the same panels and
    surfaces. `report` is called with (frames done, frames in total). The default height of the
    panels, pixels, is taken from `HEIGHTS`.

    Raises
    ------
    InputError
        See `check_film`.
    """
    check_film(path)
    height = height or HEIGHTS[path.suffix.lower()]
    # After an error the writer must be closed, otherwise ffmpeg would continue to write.
    with (
        whole_file(path) as part,
        closing(_writer(part)) as writer,
        closing(frames(scenes, height)) as pictures,
    ):
        for done, frame in enumerate(pictures, start=1):
            writer.append_data(frame)
            report(done, len(scenes))


def frames(scenes: Sequence[Scene], height: int) -> Generator[Pixels, None, None]:
    """Yield the picture of every scene, all of the same even size, shape (rows, columns, 3)."""
    film = finished(scenes)
    pictures = rendered([film], height)
    first = next(pictures)
    page = sheet(film[0], first, height)
    canvas = page.figure.canvas
    if not isinstance(canvas, FigureCanvasAgg):
        raise TypeError("a sheet has an Agg canvas")
    for scene, images in zip(film, chain([first], pictures), strict=True):
        if images is None:
            images = [painted(panel, height) for panel in scene.panels]
        page.show(scene, images)
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[:, :, :3]
        rows, columns = (size - size % 2 for size in pixels.shape[:2])
        yield pixels[:rows, :columns].copy()


def _writer(part: Path) -> Any:  # noqa: ANN401
    import imageio.v2

    if part.suffix.lower() == ".gif":
        return imageio.v2.get_writer(part, mode="I", duration=1000.0 / FRAMES_PER_SECOND, loop=0)
    return imageio.v2.get_writer(
        part,
        format="FFMPEG",
        mode="I",
        fps=FRAMES_PER_SECOND,
        codec="libx264",
        macro_block_size=2,
        ffmpeg_log_level="error",
    )
