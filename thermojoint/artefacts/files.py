"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: What reading a damaged or foreign NPZ file raises: zip files fail in many ways.
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
    """Give a temporary path beside `path`; move it there only if the block succeeds.

    The rename is atomic on one file system, so a reader sees the old file, the new file, or none,
    and a failed or killed writer leaves nothing under the final name. The content is on the disk
    before the name is, so not even a power cut leaves an empty file.

    Parameters
    ----------
    path : Path
        The final name; its folder is made if it is missing.

    Yields
    ------
    Path
        Where to write; it has the same suffix as `path`.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        # mkstemp makes private files; results are for everybody the umask admits.
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o666 & ~umask)
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8) to `path`, whole or not at all."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
