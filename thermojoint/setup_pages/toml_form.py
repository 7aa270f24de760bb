"""A file of settings (TOML) as a form: values are fields, the comments beside them their hints.

Unchanged lines are kept as written, with comments and order. A commented line ``# key = value`` is
an omitted field; ``one of: a, b`` in a hint makes the field a choice.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.settings.toml import as_text

_OFF = re.compile(r"#\s?(?=[\w\"-][^#=]*=\s*\S)")
_OFF_SECTION = re.compile(r"#\s?\[.*\]\s*(#.*)?$")
_CHOICES = re.compile(r"one of: ([^;]*)")


@dataclass(frozen=True)
class Field:
    """One value of a file."""

    #: Keys from the outside in.
    path: tuple[str, ...]
    #: Value in the file, or in the comment if the field is omitted.
    value: Any
    hint: str
    #: Allowed values; empty if any value is allowed.
    choices: tuple[str, ...]
    #: Whether the field is not omitted.
    given: bool
    #: Index of its line in the file.
    line: int

    @property
    def name(self) -> str:
        """Name of the field in messages."""
        return ".".join(self.path)

    @property
    def section(self) -> str:
        """Name of its section."""
        return ".".join(self.path[:-1])

    @property
    def many(self) -> bool:
        """Whether several choices may be selected."""
        return bool(self.choices) and isinstance(self.value, list)

    @property
    def texts(self) -> list[str]:
        """Texts in the form: entries of `many`, else one text, which is empty if omitted."""
        if not self.given:
            return [] if self.many else [""]
        return [str(one) for one in self.value] if self.many else [_shown(self.value)]

    @property
    def usual(self) -> str:
        """Placeholder of an omitted field."""
        return "" if self.given else _shown(self.value)


def _shown(value: Any) -> str:  # noqa: ANN401
    return value if isinstance(value, str) else _as_toml(value)


def _as_toml(value: Any) -> str:  # noqa: ANN401
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return f"[{', '.join(map(_as_toml, value))}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_as_toml(one)}' for key, one in value.items())} }}"
    return as_text(value) if isinstance(value, str) else str(value)


def fields_of(text: str) -> list[Field]:
    """Return the fields of a TOML text, except values over several lines."""
    return list(_fields(text, tomllib.loads(text)))


def _fields(text: str, data: Mapping[str, Any]) -> Iterator[Field]:
    section: tuple[str, ...] | None = ()
    seen: set[tuple[str, ...]] = set()
    active = {*_leaves(data)}
    for number, line in enumerate(text.splitlines()):
        if line.startswith("["):
            # Lists of sections contain no fields.
            section = None if line.startswith("[[") else next(_leaves(_loaded(line)), None)
        elif _OFF_SECTION.match(line):
            section = None
        off = _OFF.match(line)
        value, hint = _value_in(line[off.end() :] if off else line)
        if section is None or value is None:
            continue
        path = (*section, *value[0])
        if path in seen or (off is not None) == (path in active):
            continue
        if off is None and _at(data, path) != value[1]:
            continue
        seen.add(path)
        found = _CHOICES.search(hint)
        choices = tuple(one.strip() for one in found[1].split(",")) if found else ()
        yield Field(path, value[1], hint, choices, off is None, number)


def _loaded(line: str) -> dict[str, Any]:
    try:
        return tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return {}


def _leaves(data: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield the path of every value, and of every table."""
    for key, value in data.items():
        yield from ((key, *rest) for rest in _leaves(value)) if isinstance(value, dict) else ()
        yield (key,)


def _at(data: Mapping[str, Any], path: Sequence[str]) -> Any:  # noqa: ANN401
    for key in path:
        data = data.get(key, {}) if isinstance(data, Mapping) else {}
    return data


def _value_in(line: str) -> tuple[tuple[tuple[str, ...], Any] | None, str]:
    """Return keys and value of a line ``key = value  # hint``, or None, and the hint."""
    if line.lstrip().startswith("[") or "=" not in line:
        return None, ""
    keys, _, rest = line.partition("=")
    ends = [place for place, sign in enumerate(rest) if sign == "#"]
    for end in (*ends, len(rest)):
        data = _loaded(f"v ={rest[:end]}")
        path = next(_leaves(_loaded(f"{keys}= 0")), None) if data else None
        if path:
            return (path, data["v"]), rest[end + 1 :].strip()
    return None, ""


def changed(text: str, given: Mapping[str, Sequence[str]], fields: Sequence[Field]) -> str:
    """Return a TOML text with new values; fields with empty values are omitted.

    Parameters
    ----------
    text : str
    given : mapping
        Name of a field to its sent texts; none for a field with many choices clears it.
    fields : sequence of Field
        Fields of the text that were in the form.

    Raises
    ------
    InputError
        A value contains a line break.
    """
    lines = text.splitlines()
    for field in fields:
        sent = [one.strip() for one in given.get(field.name, ())]
        if not sent and not field.many:
            continue
        if any(len(one.splitlines()) > 1 for one in sent):
            raise InputError(f"{field.name}: holds a line break; write one line")
        if sent == field.texts:
            continue
        old = lines[field.line]
        off = _OFF.match(old)
        bare = old[off.end() :] if off else old
        hint = f"  # {field.hint}" if field.hint else ""
        keys = bare.partition("=")[0].rstrip()
        if field.many:
            lines[field.line] = f"{keys} = {_as_toml(sent)}{hint}"
        elif sent[0]:
            lines[field.line] = f"{keys} = {_typed(sent[0], field.value)}{hint}"
        else:
            lines[field.line] = f"# {bare}"
    return "\n".join(lines) + "\n"


def _typed(sent: str, before: Any) -> str:  # noqa: ANN401
    """Return a sent value as TOML; as a string, to be refused later, if it has the wrong type."""
    typed = not isinstance(before, str) and _loaded(f"v = {sent}")
    return sent if typed else as_text(sent)


def by_field(lines: Sequence[str], where: str, fields: Sequence[Field]) -> dict[str, list[str]]:
    """Return the lines of a refusal by the name of the field concerned; "" for none."""
    names = sorted((field.name for field in fields), key=len, reverse=True)
    found: dict[str, list[str]] = {}
    for line in lines:
        rest = line.removeprefix(f"{where}: ")
        own = [one for one in names if rest.startswith((f"{one}:", f"{one} ")) and rest != line]
        name = own[0] if own else ""
        said = rest.removeprefix(name).removeprefix(":").strip() if name else line
        found.setdefault(name, []).append(said)
    return found
