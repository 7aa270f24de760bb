"""The folder that the pages work in: its files, and which of them may be written."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

from estimator.registry import known_schemas
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.schema import schema_of
from thermojoint.live.settings import read_service
from thermojoint.setup_pages.jobs import Jobs, Record

#: Data sent from a page: name to values.
Given = Mapping[str, Sequence[str]]

TABLES = (".csv", ".txt", ".tsv", ".xlsx", ".parquet")
CAD = (".step", ".stp", ".iges", ".igs", ".brep")
MESHES = (".msh", ".inp", ".med", ".vtu", ".vtk")
RESPONSES = (".nc",)
#: Suffixes of accepted files: logs, models, parts, a control's files and certificates.
TAKEN = (
    *(*TABLES, *CAD, *MESHES, *RESPONSES),
    *(".json", ".h5", ".toml", ".ini", ".der", ".pem", ".crt"),
)
#: Suffixes of displayed files: no secrets, whose names have another suffix or none.
SHOWN = (*TAKEN, ".png", ".former")
#: Names of accepted or displayed files: no folder, no hidden file, nothing like an option.
_NAME = re.compile(r"[^\W_][\w .,()+-]{0,120}")
#: Longest name, bytes: file systems take 255, and a file that is kept beside it has a longer one.
_LONGEST = 200
MAPPING = "columns.toml"
#: Outputs of the steps that are tables, not logs.
_OWN_TABLES = ("estimate.csv", "offsets.csv", "writes.csv")


class ExistsError(InputError):
    """Files (`names`) that the pages did not write would be replaced; the user is asked first."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        listed = ", ".join(names)
        super().__init__(f"{listed}: exists already; tick that it may be replaced, or move it away")


@dataclass(frozen=True, eq=False)
class Place:
    """The folder and the commands that run in it."""

    #: Absolute path of the folder.
    folder: Path
    jobs: Jobs

    def path(self, name: str) -> Path:
        """Return the path of a file in the folder, which need not exist.

        Raises
        ------
        InputError
            The name leads out of the folder, or the file is hidden.
        """
        path = self.folder / name
        fits = _NAME.fullmatch(name) and len(name.encode()) <= _LONGEST
        if not fits or not path.resolve().is_relative_to(self.folder.resolve()):
            raise InputError(
                f"{name[:120]!r}: not the name of a file in this folder; use letters, digits, _ - ."
            )
        return path

    def existing(self, name: str) -> str:
        """Return the name of a file if it exists; raises InputError otherwise."""
        if not self.path(name).is_file():
            raise InputError(f"{name}: no such file in {self.folder}; choose one that is there")
        return name

    def has(self, name: str) -> bool:
        """Whether a file exists."""
        return (self.folder / name).is_file()

    def text(self, name: str) -> str:
        """Return the content of a text file, without a byte order mark; empty if it is missing.

        Raises
        ------
        InputError
            It is not in UTF-8.
        """
        try:
            return self.path(name).read_text("utf-8-sig") if self.has(name) else ""
        except UnicodeDecodeError as error:
            raise InputError(f"{name}: is not in UTF-8; save it in UTF-8") from error

    def all_files(self) -> list[str]:
        """Return the files that the pages show."""
        files = (path for path in self.folder.iterdir() if path.suffix.lower() in SHOWN)
        return sorted(one.name for one in files if _NAME.fullmatch(one.name) and one.is_file())

    def files(self, *suffixes: str) -> list[str]:
        """Return the files with one of some suffixes."""
        return [name for name in self.all_files() if Path(name).suffix.lower() in suffixes]

    def tables(self) -> list[str]:
        """Return the files that may be logs."""
        return [name for name in self.files(*TABLES) if name not in _OWN_TABLES]

    def models(self) -> list[str]:
        """Return the files of models, of any installed kind."""
        return [name for name in self.files(".json", ".h5") if self._is_model(name)]

    def _is_model(self, name: str) -> bool:
        try:
            return schema_of(self.folder / name) in known_schemas()
        except (InputError, OSError):
            return False

    def record(self, step: str) -> Record:
        """Return the record of a step."""
        return self.jobs.record(step)

    def is_done(self, step: str) -> bool:
        """Whether a step has succeeded, and none of the files that it read has changed since."""
        record = self.record(step)
        made = all(self.has(name) for name in record.written)
        return record.code == 0 and made and not self.changed_since(step)

    def changed_since(self, step: str) -> list[str]:
        """Return the files read by a step that may have changed since.

        Files changed while the step ran are included, since it is unknown which content was read.
        """
        record = self.record(step)
        return [
            name
            for name in (*record.read, *self._models_of(record))
            if not self.has(name) or (self.folder / name).stat().st_mtime > record.begun
        ]

    def _models_of(self, record: Record) -> list[str]:
        """Return the files of models used by the services that a step has started or checked."""
        found: list[Path] = []
        for command, *words in record.commands:
            if command == "serve":
                with suppress(InputError):
                    service = read_service(self.path(words[0]))
                    found += [model.file for model in service.given.models.values()]
        return [path.name if path.parent == self.folder else str(path) for path in found]

    def check_replaced(self, names: Sequence[str], given: Given) -> None:
        """Refuse to replace files that no step wrote, or that were changed afterwards.

        Raises
        ------
        ExistsError
            There are some, and the user has not allowed their replacement.
        """
        written: dict[str, float] = {}
        for record in self.jobs.all_records():
            for name in record.written:
                written[name] = max(record.ended, written.get(name, 0.0))
        foreign = [
            name
            for name in names
            if self.path(name).exists() and self.path(name).stat().st_mtime > written.get(name, 0.0)
        ]
        if foreign and "replace" not in given:
            raise ExistsError(foreign)

    def run(self, step: str, given: Given, *commands: Sequence[str]) -> None:
        """Run the commands of a step.

        Raises
        ------
        InputError
            Another step runs, or files would be replaced without the user's permission.
        """
        self.check_replaced(Record(tuple(map(list, commands))).written, given)
        self.jobs.start(step, *commands)

    def begin(self, name: str, text: str, given: Given) -> None:
        """Write a new file of settings; an existing one is kept as NAME.former, if allowed.

        Raises
        ------
        ExistsError
            The file exists, and the user has not allowed its replacement.
        """
        path = self.path(name)
        if path.exists():
            if path.read_bytes() == text.encode():
                return
            if "replace" not in given:
                raise ExistsError([name])
            self.set_aside(name)
        write_text(path, text)

    def set_aside(self, name: str) -> None:
        """Rename a file to NAME.TIME.former, to keep it."""
        stamp = time.strftime("%Y%m%d-%H%M%S")
        # Several files within a second are numbered.
        marks = chain([""], (f"-{number}" for number in count(2)))
        names = (f"{name}.{stamp}{mark}.former" for mark in marks)
        free = next(one for one in names if not self.path(one).exists())
        self.path(name).replace(self.path(free))


def one(given: Given, name: str, usual: str = "") -> str:
    """Return a sent value."""
    values = given.get(name) or [usual]
    return values[0].strip()


def chosen(given: Given, name: str, known: Sequence[str], what: str) -> str:
    """Return a value that must be one of some; raises InputError."""
    value = one(given, name)
    if value not in known:
        raise InputError(f"{what}: choose one of {', '.join(known) or 'none; there is none yet'}")
    return value
