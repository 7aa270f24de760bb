"""JSON files with a schema and a version: reading, validation and writing."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text

T = TypeVar("T")


@dataclass(frozen=True)
class JsonKind:
    """A kind of JSON file."""

    #: Values of ``schema`` and ``schema_version``.
    schema: str
    version: int
    #: Name for messages, e.g. "model".
    name: str
    #: Origin, e.g. "written by 'thermojoint calibrate'".
    made_by: str
    #: Advice for a damaged or old file, e.g. "calibrate again".
    remedy: str

    @property
    def header(self) -> dict[str, Any]:
        """The first two entries of a file."""
        return {"schema": self.schema, "schema_version": self.version}


def write_json(path: Path | str, content: object, indent: int | None = 2) -> None:
    """Write content as JSON, whole or not at all.

    Raises
    ------
    ValueError
        A number is not finite.
    """
    write_text(Path(path), json.dumps(content, indent=indent, allow_nan=False) + "\n")


def read_json(path: Path | str, kind: JsonKind) -> dict[str, Any]:
    """Return the content of a file of a kind, without its header.

    Raises
    ------
    InputError
        The file is missing, not text, truncated, of another kind or of another version.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a {kind.name} {kind.made_by}")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; {kind.remedy}") from error
    return parse_json(text, kind, str(path))


def parse_json(text: str, kind: JsonKind, where: str) -> dict[str, Any]:
    """Return the content of a file from its text; see `read_json`."""
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{where}: not valid JSON at line {error.lineno}, perhaps truncated; {kind.remedy}"
        ) from error
    return without_header(content, kind, where)


def without_header(content: Any, kind: JsonKind, where: str) -> dict[str, Any]:  # noqa: ANN401
    """Return parsed content without its header.

    Raises
    ------
    InputError
        The content is of another kind or of another version.
    """
    if not isinstance(content, dict) or content.get("schema") != kind.schema:
        raise InputError(f"{where}: not a {kind.schema!r} file; give a {kind.name} {kind.made_by}")
    if content.get("schema_version") != kind.version:
        raise InputError(
            f"{where}: {kind.name} of version {content.get('schema_version')!r}, expected "
            f"{kind.version}; {kind.remedy}"
        )
    return {key: value for key, value in content.items() if key not in kind.header}


def validated(
    kind: TypeAdapter[T],
    content: Any,  # noqa: ANN401
    where: str,
    remedy: str,
    members: Collection[str] = (),
) -> T:
    """Return content without its header as the object that it describes.

    `members` are the classes of unions, which are left out of the place in the message.

    Raises
    ------
    InputError
        A value is missing, unknown or invalid; the message names its place.
    """
    try:
        # As JSON: in strict mode only then may lists become tuples, and keys numbers.
        return kind.validate_json(json.dumps(content))
    except ValidationError as error:
        # A missing key may be misspelt: the unknown key is the better message.
        first = min(error.errors(), key=lambda mistake: mistake["type"] == "missing")
        place = ".".join(part for part in map(str, first["loc"]) if part not in members)
        raise InputError(f"{where}: {place}: {first['msg']}; {remedy}") from error
