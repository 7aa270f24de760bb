"""Optional dependencies: a feature without its extra is refused with a hint."""

from __future__ import annotations

from importlib.util import find_spec

from thermojoint.artefacts.errors import UnreadableError


def require(feature: str, extra: str, *packages: str) -> None:
    """Refuse a feature, before any work, if one of the packages of its extra is missing.

    Raises
    ------
    UnreadableError
        A package is not installed.
    """
    for name in packages:
        if find_spec(name) is None:
            raise UnreadableError(f"{feature}: needs {name}; pip install 'thermojoint[{extra}]'")
