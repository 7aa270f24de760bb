"""Kinds of output files: a command only replaces files of the kind that it writes.

The kind is detected by content, since a typing error often gives a valid name to the wrong file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thermojoint.artefacts.schema import states


@dataclass(frozen=True)
class Kind:
    """A kind of output."""

    #: Description for messages.
    name: str
    #: Whether an existing file is of this kind.
    holds: Callable[[Path], bool]
    #: Required suffix of the name; empty if its writer checks the suffix.
    suffix: str = ""
    #: Whether ``-`` prints it on standard output, as all results of --json.
    printed: bool = False


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(1 << 16)


def _starts(start: bytes) -> Callable[[Path], bool]:
    return lambda path: _head(path).startswith(start)


def _schema(schema: str) -> Callable[[Path], bool]:
    """A file that states this schema."""
    return lambda path: states(path, schema)


def _json(*keys: str) -> Callable[[Path], bool]:
    """A JSON object with these keys."""

    def holds(path: Path) -> bool:
        content: Any = None
        with suppress(ValueError, RecursionError):
            content = json.loads(path.read_bytes())
        return isinstance(content, dict) and content.keys() >= {*keys}

    return holds


def _is_validation(path: Path) -> bool:
    """A validation of any kind of estimator: rows of errors."""
    if not _json("rows")(path):
        return False
    rows = json.loads(path.read_bytes())["rows"]
    return isinstance(rows, list) and all(
        isinstance(row, dict) and row.keys() >= {"case", "estimator", "axis"} for row in rows
    )


def _is_simulated(path: Path) -> bool:
    """A simulated response, by the case in it; a measured one could not be recovered."""
    import h5py

    with suppress(OSError, KeyError, RuntimeError), h5py.File(path, "r") as file:
        return file.attrs.get("schema") == "thermojoint-response" and "case" in file.attrs
    return False


def _is_march_state(path: Path) -> bool:
    import numpy as np

    from thermojoint.artefacts.files import DAMAGED_ARCHIVE

    with (
        suppress(*DAMAGED_ARCHIVE, KeyError, TypeError),
        np.load(path, allow_pickle=False) as content,
    ):
        return bool(json.loads(str(content["header"]))["schema"] == "thermojoint-march-state")
    return False


def _first_line(path: Path) -> bytes:
    return _head(path).partition(b"\n")[0].strip()


def _csv(first: bytes, last: bytes) -> Callable[[Path], bool]:
    """A CSV whose header has these first and last columns."""

    def holds(path: Path) -> bool:
        header = _first_line(path)
        return header.startswith(first) and header.endswith(last)

    return holds


def _is_of_target(path: Path) -> bool:
    """Output of `target`: lines for a control, or a table of writes."""
    first = _first_line(path)
    return (
        first.endswith(b": temperature compensation by thermojoint")
        or first == b"time_s,axis,node,value,unit"
    )


def _is_report(command: str) -> Callable[[Path], bool]:
    """A page that names the command that wrote it."""
    named = f'content="thermojoint {command}"'.encode()
    return lambda path: named in _head(path)[: 1 << 10]


def _is_fmu(path: Path) -> bool:
    import zipfile

    with suppress(OSError, KeyError, zipfile.BadZipFile), zipfile.ZipFile(path) as archive:
        return b'generationTool="thermojoint' in archive.read("modelDescription.xml")
    return False


def _is_backup(path: Path) -> bool:
    """A backup of a service begins with its settings."""
    import tarfile
    import zlib

    with suppress(OSError, EOFError, zlib.error, tarfile.TarError), tarfile.open(path) as archive:
        first = archive.next()
        return first is not None and first.name == "service.toml"
    return False


def _is_picture(path: Path) -> bool:
    start = _head(path)
    drawn = b"matplotlib" in (start + path.read_bytes()[-4096:]).lower()
    return (
        start.startswith((b"\x89PNG\r\n", b"GIF8"))
        or start[4:8] == b"ftyp"
        or (start.startswith((b"<?xml", b"%PDF")) and drawn)
    )


RESPONSE = Kind("a simulated response", _is_simulated, ".nc")
MARCH_STATE = Kind("the state of a simulation", _is_march_state, ".npz")
MODEL = Kind("a model file", _schema("thermojoint-model"), ".json")
LEARNED = Kind("a learned model", _schema("thermojoint-learned-model"), ".json")
OBSERVER = Kind("a joint-aware model", _schema("thermojoint-joint-aware-model"), ".h5")
SURFACE = Kind("the surface of a machine", _schema("thermojoint-surface"), ".h5")
CALIBRATION_REPORT = Kind(
    "the report of a calibration",
    _json("parameters", "directions", "profiles", "further_runs"),
    ".json",
)
BASELINES = Kind("a file of baselines", _schema("thermojoint-baselines"), ".json")
ESTIMATOR_STATE = Kind("the state of an estimator", _schema("thermojoint-estimator-state"), ".json")
ESTIMATE = Kind("an estimate", _csv(b"time_s,", b",status,quality"), ".csv", True)
ASSEMBLY = Kind("an assembled estimator", _schema("thermojoint-assembly"), ".json")
FMU = Kind("an FMU of this program", _is_fmu, ".fmu")
TABLES = Kind("tables of a model", _json("table1", "table2", "table3"), ".json")
VALIDATION = Kind("a validation", _is_validation, ".json")
VERIFICATION = Kind("a verification", _json("cases"), ".json")
OPTIMISATION = Kind("an optimisation", _json("found", "figures", "history"), ".json")
SENSITIVITY_TABLE = Kind("a table of a sensitivity study", _csv(b"figure,path,", b""), ".csv")
SENSITIVITY = Kind("a sensitivity study", _json("entries"), ".json")
VERIFICATION_PAGE = Kind("a page of the verification", _starts(b"# Verification\n"), ".md")
OFFSETS = Kind("a preview of offsets", _csv(b"time_s,offset_", b",state"), ".csv", True)
TEST_REPORT = Kind("a report of a thermal test", _is_report("iso230-3"), ".html")
TEST_PARAMETERS = Kind("parameters of a thermal test", _schema("thermojoint-iso230-3"), ".json")
TARGET = Kind("what 'target' writes", _is_of_target)
SENSORS = Kind(
    "a list of placed sensors", _starts(b"# Sensors placed by 'thermojoint place'"), ".toml"
)
STUDY_PAGE = Kind("a page of a batch", _is_report("batch"), ".html")
LOOP_REPORT = Kind("a report of a closed loop", _is_report("control"), ".html")
LOOP_FIGURES = Kind("figures of a closed loop", _schema("thermojoint-control"), ".json")
MESH = Kind("a mesh (MSH)", _starts(b"$MeshFormat"))
INSPECTION = Kind(
    "an inspection", _json("bodies", "surfaces", "joints", "quality", "worst_cell"), ".json"
)
#: A draft replaces no existing case, which may be complete.
DRAFT = Kind("to be replaced by a draft", lambda path: False)
BACKUP = Kind("a backup of a service", _is_backup)
PICTURE = Kind("a picture of this program", _is_picture)
