"""Dotted paths into a case: which ones there are, and a case's data with other values there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import fields
from typing import Any

from fesim.case import Case, MillingMachineSection
from meshes.milling_machine import MillingMachineDimensions


def known_paths(case: Case) -> set[str]:
    """Return every path of a case, those of defaults and of whole sections included.

    Entries of lists go by their number from 0, e.g. ``candidates.0.spacing_mm``.
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


def with_values(
    data: Mapping[str, Any], values: Mapping[str, Any], whole: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a copy of a case's data with other values at some paths.

    Parameters
    ----------
    data : mapping
        The case as read from TOML; sections left to their defaults may be missing.
    values : mapping of str to value
        By path; each path is one of `known_paths`.
    whole : mapping
        The case dumped, defaults and all: where a section is missing, the rest of it comes from
        here. A section that is left out may have other defaults than its keys have one by one.
    """
    changed = deepcopy(dict(data))
    for path, value in values.items():
        *above, last = path.split(".")
        place: Any = changed
        default: Any = whole
        for key in above:
            default = _part(default, key)
            if isinstance(place, dict) and key not in place:
                place[key] = deepcopy(default)
            place = _part(place, key)
        place[int(last) if isinstance(place, list) else last] = deepcopy(value)
    return changed


def _part(value: Any, key: str) -> Any:  # noqa: ANN401 - any JSON value
    return value[int(key)] if isinstance(value, list) else value[key]
