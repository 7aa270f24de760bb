"""JSON files with a kind and a version: reading and recognition."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from thermojoint.artefacts.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class JsonKind:
    """A kind of JSON file.

    Attributes
    ----------
    schema, version
        What stands under ``schema`` and ``schema_version``.
    name : str
        What a person calls it, e.g. "model".
    made_by : str
        Where one comes from, e.g. "written by 'thermojoint calibrate'".
    remedy : str
        What to do if it is damaged or old, e.g. "calibrate again".
    """

    schema: str
    version: int
    name: str
    made_by: str
    remedy: str

    @property
    def header(self) -> dict[str, Any]:
        """The first two entries of a file."""
        return {"schema": self.schema, "schema_version": self.version}


def read_json(path: Path | str, kind: JsonKind) -> dict[str, Any]:
    """Return the content of a file of a kind, without its header.

    Raises
    ------
    InputError
        The file is missing, no text, truncated, of another kind or of another version.
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
    """Return the content of the text of a file; see `read_json`."""
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
        It is of another kind or of another version.
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
    """Return content without its header as what it describes.

    Parameters
    ----------
    kind : TypeAdapter
        Of what it describes.
    content : object
        As JSON has it.
    where, remedy : str
        For the error message.
    members : collection of str
        Classes of unions: which of them was tried is no place in the file.

    Raises
    ------
    InputError
        Something is missing, unknown or no value of its kind: says what and where.
    """
    try:
        # As JSON, not as Python objects: there lists are tuples and keys numbers.
        return kind.validate_json(json.dumps(content))
    except ValidationError as error:
        # What is missing may only be misspelt: the unknown key says more.
        first = min(error.errors(), key=lambda mistake: mistake["type"] == "missing")
        place = ".".join(part for part in map(str, first["loc"]) if part not in members)
        raise InputError(f"{where}: {place}: {first['msg']}; {remedy}") from error
