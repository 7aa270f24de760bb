"""Data of a TOML file checked by a schema: the first mistake in one line."""

from __future__ import annotations

from typing import Any, TypeVar

import pydantic

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.refusal import first_error, keys_at, refusal

Schema = TypeVar("Schema", bound=pydantic.BaseModel)


def validated(schema: type[Schema], data: dict[str, Any], where: str) -> Schema:
    """Return what nested dictionaries say by a schema.

    Parameters
    ----------
    schema : type
        Of the whole file.
    data : dict
        E.g. from `thermojoint.artefacts.toml.parse`.
    where : str
        What the error calls it.

    Raises
    ------
    InputError
        A key is unknown or missing, or a value is out of range.
    """
    try:
        return schema.model_validate(data)
    except pydantic.ValidationError as error:
        raise _one_line(schema, error, where) from error


def _one_line(
    schema: type[pydantic.BaseModel], error: pydantic.ValidationError, where: str
) -> InputError:
    first = first_error(error)
    place = [str(part) for part in first["loc"]]
    if first["type"] != "extra_forbidden":
        return refusal(first, ": ".join([where, ".".join(place)] if place else [where]))
    *section, key = place
    return unknown_name("key", key, keys_at(schema, section), ".".join([where, *section]))
