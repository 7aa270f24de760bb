"""Settings from a file, or from nested dictionaries, by their schema."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import pydantic

from thermojoint.artefacts.settings.refusal import refusal
from thermojoint.artefacts.settings.toml import parse, read_text

Schema = TypeVar("Schema", bound=pydantic.BaseModel)


def read_settings(schema: type[Schema], path: Path, what: str) -> Schema:
    """Read a file of settings (TOML); files named in it are relative to its folder.

    Raises
    ------
    InputError
        The file is missing or not TOML, a key is unknown or missing, or a value is out of range;
        one line for each mistake.
    """
    return settings_from(schema, parse(read_text(path, what), str(path)), str(path), path.parent)


def settings_from(schema: type[Schema], data: dict[str, Any], where: str, folder: Path) -> Schema:
    """Return settings given as nested dictionaries; file names are relative to `folder`.

    Raises
    ------
    InputError
        As `read_settings`.
    """
    try:
        return schema.model_validate(data, context=folder)
    except pydantic.ValidationError as error:
        raise refusal(schema, error, where) from error
