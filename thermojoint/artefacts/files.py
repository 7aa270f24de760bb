"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from shutil import rmtree
from tempfile import gettempdir

from thermojoint.artefacts.unfinished import cleared_at_stop

#: Exceptions raised when a damaged or foreign NPZ file is read: zip files fail in many ways.
DAMAGED_ARCHIVE = (
    OSError,
    EOFError,
    ValueError,
    AttributeError,
    NotImplementedError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path with the suffix of `path`, renamed to it if the block succeeds.

    The rename is atomic on one file system, so a reader sees the old file, the new file, or none,
    and a failed or killed writer leaves nothing under the final name. The content is synchronised
    before the rename, so even a power cut leaves no empty file.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{os.urandom(4).hex()}{path.suffix}")
    remove = partial(part.unlink, missing_ok=True)
    with cleared_at_stop(remove):
        try:
            part.touch(exist_ok=False)
            yield part
            with part.open("r+b") as file:
                os.fsync(file.fileno())
            part.replace(path)
        except OSError as error:
            # A full disk is reported without a file name.
            error.filename = error.filename or str(path)
            raise
        finally:
            remove()


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Give a temporary folder that is removed after the block."""
    place = Path(gettempdir()) / f"thermojoint-{os.urandom(8).hex()}"
    remove = partial(rmtree, place, ignore_errors=True)
    with cleared_at_stop(remove):
        try:
            place.mkdir(mode=0o700)
            yield place
        finally:
            remove()


def write_bytes(path: Path, content: bytes) -> None:
    """Write `content` to `path`, whole or not at all.

    HDF5 is created in memory and written here: its library aborts the process on a full disk.
    """
    with whole_file(path) as part:
        part.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8) to `path`, whole or not at all."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
