"""Backup of a service while it runs, and restore into an empty folder.

A backup is a .tar.gz that only its owner can read: the settings' file, the files named in it and in
the files of its targets, and the folder of the service, with a SHA-256 of each. The stores are
copied by SQLite, so they are consistent although the service writes meanwhile. Secrets and keys
named in the settings are left out.
"""

from __future__ import annotations

import gzip
import json
import os
import posixpath
import shutil
import sqlite3
import tarfile
import time
import zlib
from collections.abc import Iterator
from contextlib import closing
from hashlib import sha256
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import IO, Any, NamedTuple

from pydantic import BaseModel

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import whole_file
from thermojoint.artefacts.folders import whole_folder
from thermojoint.artefacts.json_file import JsonKind, parse_json
from thermojoint.artefacts.settings import toml
from thermojoint.live import access_store
from thermojoint.live.settings import CsvSource, Secret, read_service
from thermojoint.live.targets.settings import read_target

_KIND = JsonKind(
    "thermojoint-backup", 1, "backup", "by 'thermojoint backup'", "take another backup"
)
_MANIFEST = "manifest.json"
#: Not copied: SQLite's logs beside its stores, the lock, rejected certificates.
_LEFT_OUT = (".sqlite-wal", ".sqlite-shm", "lock")
_CHUNK = 1 << 20


class Named(NamedTuple):
    """A file or folder named in the settings."""

    #: Place in the settings.
    key: str
    path: Path
    #: Whether it is a password, a token or a private key.
    secret: bool


def back_up(file: Path, out: Path) -> list[str]:
    """Write a backup of the service of a file, which may be running; `out` is replaced whole.

    The result is the omitted secrets: the place of each in the settings, and its path.

    Raises
    ------
    InputError
        The settings are invalid, or a file named in them cannot be read.
    """
    service, base = read_service(file), file.resolve().parent
    targets = [one.target for one in service.machines.values() if one.target is not None]
    named = list(_named(service.given))
    for path in targets:
        named += _named(read_target(path), f"{path}: ")
    places = {
        one.path: _archive_name(one.path, base, k)
        for k, one in enumerate(named)
        if not one.secret and one.path.exists()
    }
    settings = {file: "service.toml"} | {path: places.pop(path) for path in targets}
    digests: dict[str, str] = {}
    with whole_file(out) as part, TemporaryDirectory(dir=out.parent) as scratch:
        part.chmod(0o600)
        with tarfile.open(part, "w:gz", compresslevel=3) as tar:
            for path, place in settings.items():
                written = Path(scratch) / "settings.toml"
                written.write_text(_with_archive_names(path, place, places | settings), "utf-8")
                _add(tar, written, place, digests)
            for path, place in places.items():
                for member in [path] if path.is_file() else sorted(path.rglob("*")):
                    if member.is_file() and not member.name.endswith(_LEFT_OUT):
                        name = PurePosixPath(place, *member.relative_to(path).parts)
                        _add(tar, _readable(member, Path(scratch)), str(name), digests)
            manifest = Path(scratch) / _MANIFEST
            content = _KIND.header | {"time_s": time.time(), "sha256": digests}
            manifest.write_text(json.dumps(content, indent=1), "utf-8")
            tar.add(manifest, _MANIFEST)
    return [f"{one.key}: {one.path}" for one in named if one.secret]


def restore(archive: Path, folder: Path) -> Path:
    """Restore a backup into an empty folder; return the settings' file in it.

    Raises
    ------
    InputError
        The folder is not empty, or the backup is damaged: then nothing is restored.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is not empty; restore into a new folder")
    try:
        _read_to_its_end(archive)
        with tarfile.open(archive) as tar, whole_folder(folder) as work:
            manifest = parse_json(
                _member(tar, _MANIFEST).read().decode("utf-8"), _KIND, str(archive)
            )
            for name, digest in manifest["sha256"].items():
                target = work / name
                if ".." in target.parts or not target.is_relative_to(work):
                    raise InputError(f"{archive}: {name}: leads out of the folder")
                target.parent.mkdir(parents=True, exist_ok=True)
                handle = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
                with os.fdopen(handle, "wb") as file:
                    if _copied(_member(tar, name), file) != digest:
                        raise InputError(f"{archive}: {name} is damaged; take another backup")
    except (OSError, EOFError, zlib.error, tarfile.TarError, KeyError, ValueError) as error:
        raise InputError(f"{archive}: not a whole backup ({error}); take another one") from error
    return folder / "service.toml"


def _named(value: Any, above: str = "", secret: bool = False) -> Iterator[Named]:  # noqa: ANN401
    """Yield the files and folders named in settings, except sources of readings."""
    if isinstance(value, Path):
        key = above.removesuffix(".")
        yield Named(key, value, secret or key.endswith("key_file"))
    elif isinstance(value, dict | BaseModel) and not isinstance(value, CsvSource):
        for name, one in dict(value).items():
            yield from _named(one, f"{above}{name}.", isinstance(value, Secret))


def _archive_name(path: Path, base: Path, number: int) -> str:
    """Return the name in the backup: relative to the settings' file, or in a folder of its own."""
    if path.resolve().is_relative_to(base) and path.resolve() != base:
        return path.resolve().relative_to(base).as_posix()
    return f"files/{number}/{path.name}"


def _with_archive_names(file: Path, name: str, places: dict[Path, str]) -> str:
    """Return settings, stored as `name`, with the names of the files in the backup."""
    text, base = toml.read_text(file, "settings"), file.resolve().parent
    for raw in set(_strings(toml.parse(text, str(file)))):
        for path, place in places.items():
            if (base / raw).resolve() == path.resolve():
                there = posixpath.relpath(place, posixpath.dirname(name) or ".")
                for quote in ('"', "'"):
                    text = text.replace(f"{quote}{raw}{quote}", f'"{there}"')
    return text


def _strings(value: Any) -> Iterator[str]:  # noqa: ANN401
    if isinstance(value, str):
        yield value
    for one in value.values() if isinstance(value, dict) else ():
        yield from _strings(one)


def _readable(path: Path, scratch: Path) -> Path:
    """Return a file to read; for a store of SQLite a consistent copy without sessions."""
    if path.suffix != ".sqlite":
        return path
    copy = scratch / path.name
    copy.touch(mode=0o600)
    uri = f"{path.resolve().as_uri()}?mode=ro"
    with closing(sqlite3.connect(uri, uri=True)) as store, closing(sqlite3.connect(copy)) as target:
        store.backup(target)
        if path.name == access_store.NAME:
            target.execute("DELETE FROM sessions")
            target.commit()
        # The copy must be a single file.
        target.execute("PRAGMA journal_mode = DELETE")
    return copy


def _add(tar: tarfile.TarFile, path: Path, name: str, digests: dict[str, str]) -> None:
    """Add a file with its present content; data appended meanwhile are left out."""
    with path.open("rb") as file:
        about = tar.gettarinfo(arcname=name, fileobj=file)
        hashing = _Hashing(file)
        tar.addfile(about, hashing)
    digests[name] = hashing.digest.hexdigest()


class _Hashing:
    """A file that is hashed while it is read."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self.digest = file, sha256()

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        content = self._file.read(size)
        self.digest.update(content)
        return content


def _read_to_its_end(archive: Path) -> None:
    """Read a .gz to its end: its checksum also covers data without a digest, e.g. tar headers."""
    with gzip.open(archive) as file:
        while file.read(_CHUNK):
            pass


def _member(tar: tarfile.TarFile, name: str) -> IO[bytes]:
    file = tar.extractfile(name)
    if file is None:
        raise KeyError(f"{name} is not a file")
    return file


def _copied(source: IO[bytes], target: IO[bytes]) -> str:
    """Copy to the end, and return the SHA-256."""
    hashing = _Hashing(source)
    shutil.copyfileobj(hashing, target, _CHUNK)
    return hashing.digest.hexdigest()
