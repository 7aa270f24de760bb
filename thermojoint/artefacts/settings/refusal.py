"""Validation errors of pydantic as messages with one line per mistake."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from thermojoint.artefacts.errors import InputError, InputErrors, unknown_name
from thermojoint.artefacts.settings.toml import as_key

#: A place in an input: keys from the outside in; entries of lists count from 1.
Place = tuple[str, ...]


@dataclass(frozen=True)
class Mistake:
    """One mistake: its place, the keys that are valid there, and pydantic's description."""

    place: Place
    keys: tuple[str, ...]
    details: ErrorDetails


def refusal(schema: type[BaseModel], error: ValidationError, where: str) -> InputError:
    """Return the error that lists every mistake of an input, one line each."""
    mistakes = [_mistake(schema, details) for details in error.errors()]
    meant = set(_meant(mistakes))
    lines: dict[Place, str] = {}
    for mistake in mistakes:
        # Each member of a union reports a mistake of its own: the first is enough.
        if mistake.place not in meant and mistake.place not in lines:
            lines[mistake.place] = _line(mistake, where)
    return (InputError if len(lines) == 1 else InputErrors)("\n".join(lines.values()))


def _meant(mistakes: list[Mistake]) -> Iterator[Place]:
    """Yield the missing keys that are present under a misspelt name or a name with a dot."""
    missing = [mistake.place for mistake in mistakes if mistake.details["type"] == "missing"]
    for mistake in mistakes:
        if mistake.details["type"] == "extra_forbidden":
            *section, key = mistake.place
            beside = [place for place in missing if list(place[:-1]) == section]
            if isinstance(mistake.details["input"], dict):
                yield from beside
            else:
                near = get_close_matches(key, mistake.keys, n=1, cutoff=0.5)
                yield from (place for place in beside if place[-1] in near)


def _line(mistake: Mistake, where: str) -> str:
    kind, given = mistake.details["type"], mistake.details["input"]
    if kind == "extra_forbidden":
        *section, key = mistake.place
        line = str(unknown_name("key", key, mistake.keys, _at(where, section)))
        if section and isinstance(given, dict):
            return f"{line}; {_quoting(f'{section[-1]}.{key}')}"
        return line
    at = _at(where, mistake.place)
    if kind == "missing":
        return f"{at} is missing; add it"
    message = mistake.details["msg"].removeprefix("Value error, ")
    shown = f" (given: {given!r})" if isinstance(given, str | int | float) else ""
    return f"{at}: {message[0].lower()}{message[1:]}{shown}; {_dotted_name(mistake) or 'change it'}"


def _at(where: str, place: Place | list[str]) -> str:
    return f"{where}: {'.'.join(place)}" if place else where


def _dotted_name(mistake: Mistake) -> str | None:
    """Return the advice for a table in place of a value, which TOML creates from a dotted name."""
    given, kind = mistake.details["input"], mistake.details["type"]
    wrong_kind = kind.endswith("_type") or kind == "literal_error"
    if not (wrong_kind and mistake.place and given and isinstance(given, dict)):
        return None
    name = mistake.place[-1]
    while isinstance(given, dict) and given:
        key, given = next(iter(given.items()))
        name = f"{name}.{key}"
    return _quoting(name)


def _quoting(name: str) -> str:
    return f"if the name is {name}, write it in quotes: {as_key(name)}"


def _mistake(schema: type[BaseModel], details: ErrorDetails) -> Mistake:
    """Find the place of an error; pydantic's location also contains members of unions."""
    place: list[str] = []
    types = [schema]
    for part in details["loc"]:
        sections = [
            kind for kind in types if isinstance(kind, type) and issubclass(kind, BaseModel)
        ]
        of_kind = [section for section in sections if len(sections) > 1 and part in _kinds(section)]
        if of_kind:
            types = of_kind
        elif inner := [each for kind in types for each in _inside(kind, part)]:
            place.append(str(part + 1 if isinstance(part, int) else part))
            types = inner
        elif details["type"] == "extra_forbidden":  # the last part
            place.append(str(part))
            return Mistake(
                tuple(place), tuple(key for section in sections for key in _keys(section)), details
            )
    return Mistake(tuple(place), (), details)


def _kinds(section: type[BaseModel]) -> list[Any]:
    """Return the values of a section's literal fields, e.g. its ``kind``."""
    return [
        value
        for field in section.model_fields.values()
        if get_origin(field.annotation) is Literal
        for value in get_args(field.annotation)
    ]


def _keys(section: type[BaseModel]) -> dict[str, Any]:
    """Return the type of each key, by its name in the input."""
    return {field.alias or name: field.annotation for name, field in section.model_fields.items()}


def _inside(kind: Any, part: str | int) -> Iterator[Any]:  # noqa: ANN401 - a type of any form
    """Yield the types allowed at a key of a section or table, or at an entry of a list."""
    origin = get_origin(kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield from _members(_keys(kind)[str(part)]) if part in _keys(kind) else ()
    elif origin is dict or (origin in (list, tuple) and isinstance(part, int)):
        yield from _members(get_args(kind)[-1])


def _members(kind: Any) -> Iterator[Any]:  # noqa: ANN401
    """Yield the members of a union, or the type itself."""
    if get_origin(kind) is Annotated:
        yield from _members(get_args(kind)[0])
    elif get_origin(kind) in (Union, UnionType):
        for member in get_args(kind):
            yield from _members(member)
    else:
        yield kind
