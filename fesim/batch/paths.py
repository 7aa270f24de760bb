"""Dotted paths into a case: list of paths, and replacement of values at paths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from fesim.case.schema import Case, MillingMachineSection
from meshes.milling_machine import MillingMachineDimensions


def known_paths(case: Case) -> set[str]:
    """Return every path of a case, including those of defaults and of whole sections.

    Entries of lists are numbered from 0, e.g. ``candidates.0.spacing_mm``.
    """
    paths = set(_paths(case.model_dump(mode="json"), ""))
    if isinstance(case.structure, MillingMachineSection):
        names = (field.name for field in fields(MillingMachineDimensions))
        paths |= {f"structure.dimensions_mm.{name}" for name in names}
    return paths


def _paths(value: Any, above: str) -> Iterator[str]:  # noqa: ANN401 - any JSON value
    if above:
        yield above
    parts = dict(enumerate(value)) if isinstance(value, list) else value
    for key, part in parts.items() if isinstance(parts, dict) else ():
        yield from _paths(part, f"{above}.{key}" if above else str(key))


def with_values(data: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a case's data with other values at some paths; the rest is shared, not copied.

    Parameters
    ----------
    data : mapping
        The case as read from TOML; sections with default values may be missing.
    values : mapping of str to value
        By path, which is one of `known_paths`.
    """
    changed: Any = data
    for path, value in values.items():
        changed = _with_value(changed, path.split("."), value)
    return dict(changed)


def _with_value(data: Any, path: list[str], value: Any) -> Any:  # noqa: ANN401 - any TOML value
    """A copy of a list or section, including everything along the path."""
    # Names of joints and surfaces may contain dots.
    length = next((n for n in range(len(path), 1, -1) if ".".join(path[:n]) in data), 1)
    key, below = ".".join(path[:length]), path[length:]
    if isinstance(data, list):
        at = int(key)
        changed = _with_value(data[at], below, value) if below else value
        return [*data[:at], changed, *data[at + 1 :]]
    return {**data, key: _with_value(data.get(key, {}), below, value) if below else value}
