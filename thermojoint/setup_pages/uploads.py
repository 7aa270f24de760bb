"""Uploads from a browser, piece by piece, into the folder; whole or not at all."""

from __future__ import annotations

import hashlib
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.setup_pages.place import TAKEN, Place

#: Largest piece and largest file, bytes.
LARGEST_PIECE, LARGEST_FILE = 1 << 20, 1 << 30


def take_piece(place: Place, name: str, piece: bytes, at: str, size: str) -> None:
    """Append a piece of a file, which gets its name with the last piece.

    Parameters
    ----------
    place : Place
    name : str
        Name of the file; no existing file is replaced.
    piece : bytes
    at, size : str
        Start of the piece, and size of the whole file.

    Raises
    ------
    InputError
        The name, the kind or the size is not accepted, a file of this name exists, or a piece is
        missing.
    """
    path = place.path(name)
    if path.suffix.lower() not in TAKEN:
        raise InputError(f"{name}: files that end in {path.suffix!r} are not used here")
    if path.exists():
        raise InputError(f"{name}: exists already; send it under another name")
    numbers = [int(one) if one.isascii() and one.isdigit() else -1 for one in (at[:12], size[:12])]
    begin, whole = numbers
    if not 0 <= begin <= whole <= LARGEST_FILE or begin + len(piece) > whole:
        raise InputError(f"{name}: larger than {LARGEST_FILE} bytes, or in pieces that do not fit")
    digest = hashlib.sha256(name.encode()).hexdigest()[:16]
    part = place.jobs.records / f"upload-{digest}"
    try:
        place.jobs.records.mkdir(exist_ok=True)
        if begin == 0:
            part.unlink(missing_ok=True)
        with part.open("ab") as file:
            if file.tell() != begin:
                raise InputError(f"{name}: a piece is missing; send it again")
            file.write(piece)
        if begin + len(piece) == whole and not _moved(part, path):
            raise InputError(f"{name}: exists already; send it under another name")
    except OSError as error:
        why = f"cannot be written ({error.strerror})"
        raise InputError(f"{name}: {why}; check the folder and its space") from error


def _moved(part: Path, path: Path) -> bool:
    """Give a file its name; False if a file of this name has been created meanwhile."""
    try:
        path.hardlink_to(part)
        part.unlink()
    except FileExistsError:
        return False
    except OSError:
        # There are file systems without hard links, such as exFAT.
        try:
            path.touch(exist_ok=False)
        except FileExistsError:
            return False
        part.replace(path)
    return True
