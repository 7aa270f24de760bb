"""Folders that are replaced whole or not at all.

::

    results/                      for readers: all old or all new
      contents.json               list of the files that this program wrote
    .results.x7k2m_3q/            beside it, during a run
      unfinished                  locked by the run; contains the name of the final folder
      new/                        the folder being built; after the exchange, the old one
      old/                        the old folder, where the exchange takes two steps

A killed run leaves the folder beside; the next run removes it, and restores ``old`` if the kill
came between the two steps.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import glob
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.unfinished import cleared_at_stop

#: Lists the files of a folder that this program wrote. All others belong to the user.
CONTENTS = "contents.json"
SCHEMA = "thermojoint-contents"

_MARK = "unfinished"
#: renameat2(2): relative to the current folder, and the flag for an atomic exchange.
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


def check_place(path: Path, folder: Path) -> None:
    """Refuse a path if its folder, which may not exist yet, cannot be written.

    Raises
    ------
    InputError
        The folder, or the nearest one that exists, is a file or not writable.
    """
    nearest = next(place for place in (folder, *folder.parents) if place.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        raise InputError(f"{path}: nothing can be written in {nearest}; choose another place")


def check_replaceable(path: Path) -> None:
    """Refuse a folder that `whole_folder` would not replace.

    Raises
    ------
    InputError
        It is a file, a mount point, or contains files but none of this program.
    """
    place = Path(path).resolve()
    if not place.exists():
        return
    if not place.is_dir():
        raise InputError(f"{path}: is a file; give a folder")
    if place.is_mount():
        raise InputError(f"{path}: is a mount, which cannot be replaced; give a folder below it")
    if any(place.iterdir()) and _contents(place) is None:
        raise InputError(
            f"{path}: holds files of another origin (no {CONTENTS} of this program); give a new "
            "folder"
        )


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Give an empty folder beside `path`, which replaces `path` if the block succeeds.

    Until then the old folder remains, even if the process is killed. Files in the old folder that
    this program did not write are carried over.

    Raises
    ------
    InputError
        The existing folder must not be replaced (`check_replaceable`), or cannot be.
    """
    place = Path(path).resolve()
    place.parent.mkdir(parents=True, exist_ok=True)
    _clear_up_after_killed(place)
    check_replaceable(path)
    work = place.with_name(f".{place.name}.{os.urandom(4).hex()}")
    settle = partial(_settle, work, place)
    with cleared_at_stop(settle):
        try:
            work.mkdir(mode=0o700)
            with (work / _MARK).open("w", encoding="utf-8") as mark:
                with suppress(OSError):  # some file systems have no locks
                    fcntl.flock(mark, fcntl.LOCK_EX)
                mark.write(place.name)
                mark.flush()
                new = work / "new"
                new.mkdir()
                yield new
                names = [
                    file.relative_to(new).as_posix() for file in new.rglob("*") if file.is_file()
                ]
                listed = {"schema": SCHEMA, "schema_version": 1, "files": sorted(names)}
                write_text(new / CONTENTS, json.dumps(listed, indent=2) + "\n")
                _put_in_place(path, place, work)
        except OSError as error:
            # The folder beside is removed before anybody reads its name; a full disk gives none.
            if error.filename is None or str(error.filename).startswith(str(work)):
                error.filename = str(path)
            raise
        finally:
            settle()


def write_folder(path: Path, texts: Mapping[str, str]) -> list[Path]:
    """Replace a folder by files with these texts, whole or not at all; return their paths.

    Raises
    ------
    InputError
        As `whole_folder`.
    """
    with whole_folder(path) as part:
        for name, text in texts.items():
            write_text(part / name, text)
    return [path / name for name in texts]


def _contents(folder: Path) -> set[str] | None:
    """Return the files of a folder that this program wrote; None without a list of them."""
    try:
        contents = json.loads((folder / CONTENTS).read_text(encoding="utf-8"))
        return {CONTENTS, *contents["files"]} if contents["schema"] == SCHEMA else None
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _put_in_place(path: Path, place: Path, work: Path) -> None:
    new = work / "new"
    try:
        if place.exists():
            _carry_over(place, new)
            shutil.copymode(place, new)
            _swap(place, new, work / "old")
        else:
            new.rename(place)
    except OSError as error:
        kept = Path(tempfile.mkdtemp(prefix=f"{place.name}-new-", dir=place.parent))
        new.rename(kept)
        raise InputError(
            f"{path}: cannot be replaced ({error.strerror or error}); the new one is in {kept}"
        ) from error


def _carry_over(old: Path, new: Path) -> None:
    """Copy the user's own files from `old` to `new`, as ``NAME.old`` if the name is taken."""
    ours = _contents(old) or set()
    for above, folders, files in os.walk(old):
        links = [name for name in folders if (Path(above) / name).is_symlink()]
        for name in [*files, *links]:
            source = Path(above) / name
            relative = source.relative_to(old)
            if relative.as_posix() in ours:
                continue
            at = new / relative
            while at.is_symlink() or at.exists():
                at = at.with_name(at.name + ".old")
            at.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(source, at, follow_symlinks=False)
            except OSError:
                shutil.copy2(source, at, follow_symlinks=False)
        if not folders and not files:
            (new / Path(above).relative_to(old)).mkdir(parents=True, exist_ok=True)


def replace_folder(place: Path, new: Path) -> None:
    """Put a complete folder in the place of another, if there is one, which is deleted."""
    if not place.exists():
        new.rename(place)
        return
    old = new.with_name(f"{new.name}.old")
    _swap(place, new, old)
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)


def _swap(place: Path, new: Path, old: Path) -> None:
    """Exchange a folder for a new one; `old` is its name where that takes two steps."""
    try:
        _exchange(place, new)
    except OSError:  # other systems and file systems: for a moment there is no folder
        place.rename(old)
        new.rename(place)


def _exchange(old: Path, new: Path) -> None:
    """Exchange two folders atomically; OSError where the system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, TypeError) as error:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS)) from error
    paths = os.fsencode(old), os.fsencode(new)
    if rename(_AT_FDCWD, paths[0], _AT_FDCWD, paths[1], ctypes.c_uint(_RENAME_EXCHANGE)):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(old))


def _settle(work: Path, place: Path) -> None:
    """Remove the working folder; `place` is then a complete folder, or missing as before."""
    if (work / "old").exists() and not place.exists():
        (work / "old").rename(place)
    shutil.rmtree(work, ignore_errors=True)


def _clear_up_after_killed(place: Path) -> None:
    for work in place.parent.glob(f".{glob.escape(place.name)}.????????"):
        with suppress(OSError), (work / _MARK).open("r+", encoding="utf-8") as mark:
            # A running process holds the lock.
            fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if mark.read() == place.name:
                _settle(work, place)
