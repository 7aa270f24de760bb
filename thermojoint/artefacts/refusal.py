"""What pydantic found wrong with an input, said in one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.toml import as_key


def first_error(error: ValidationError) -> ErrorDetails:
    """Return the error to tell: the first, or the unknown key that was meant for a missing one."""
    found = error.errors()
    first = found[0]
    if first["type"] == "missing":
        for other in found:
            if other["type"] == "extra_forbidden" and other["loc"][:-1] == first["loc"][:-1]:
                return other
    return first


def refusal(found: ErrorDetails, at: str) -> InputError:
    """Return the error for a missing key or a bad value.

    Parameters
    ----------
    found : ErrorDetails
        One of ``ValidationError.errors()``.
    at : str
        File and key.
    """
    if found["type"] == "missing":
        return InputError(f"{at} is missing; add it")
    message = found["msg"].removeprefix("Value error, ")
    given = found.get("input")
    shown = f" (given: {given!r})" if isinstance(given, str | int | float) else ""
    return InputError(
        f"{at}: {message[0].lower()}{message[1:]}{shown}; {dotted_name(found) or 'change it'}"
    )


def dotted_name(found: ErrorDetails) -> str | None:
    """Return what to do about a table in place of a value: TOML makes one of a dotted name."""
    given, place = found.get("input"), found["loc"]
    wrong_kind = found["type"].endswith("_type") or found["type"] == "literal_error"
    if not (wrong_kind and place and given and isinstance(given, dict)):
        return None
    name = str(place[-1])
    while isinstance(given, dict) and given:
        key, given = next(iter(given.items()))
        name = f"{name}.{key}"
    return quoting(name)


def quoting(name: str) -> str:
    """Return what to do about a name with a dot in it that stands without quotes."""
    return f"if the name is {name}, write it in quotes: {as_key(name)}"


def keys_at(model: type[BaseModel], place: Sequence[str | int]) -> list[str]:
    """Return every key allowed at a place of a model, over all kinds that a section may have.

    Parameters
    ----------
    model : type
        Of the whole input.
    place : sequence of str and int
        Keys from the outside in, names that are free and numbers of list entries among them.
    """
    models: list[type[BaseModel]] = [model]
    named = False
    for part in place:
        if named:  # whatever it is called
            named = False
            continue
        found = [field[part] for field in map(_fields, models) if part in field]
        models = [inner for annotation in found for inner in _models_in(annotation)]
        named = any(get_origin(annotation) in (dict, list) for annotation in found)
    return sorted({str(key) for one in models for key in _fields(one)})


def _fields(model: type[BaseModel]) -> dict[str | int, Any]:
    """Return the annotation of each key as it stands in the input."""
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


def _models_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in getattr(annotation, "__args__", ()) for model in _models_in(part)]
