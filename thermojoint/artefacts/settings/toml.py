"""Reading of TOML with or without a byte order mark; quoting of keys and strings."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from thermojoint.artefacts.errors import InputError


def read_text(path: Path, what: str) -> str:
    """Return the text of a file in UTF-8; `what` is its kind for messages, e.g. ``"case"``.

    Raises
    ------
    InputError
        The file is missing, or not text in UTF-8.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read; give a TOML {what} file in UTF-8") from error


def parse(text: str, where: str) -> dict[str, Any]:
    """Return the content of a TOML text, which may start with a byte order mark (Windows).

    Raises
    ------
    InputError
        The text is not valid TOML.
    """
    try:
        return tomllib.loads(text.removeprefix("\ufeff"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: no valid TOML: {error}") from error


def as_key(name: str) -> str:
    """Return a name as a TOML key, in quotes if necessary."""
    bare = name.replace("_", "").replace("-", "")
    return name if bare.isascii() and bare.isalnum() else as_text(name)


def as_text(value: str) -> str:
    """Return a TOML string, escaped as in JSON but without surrogate pairs."""
    # JSON does not escape the last control character (DEL).
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
