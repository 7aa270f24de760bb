"""Dotted paths into a case: their list, and replacement of the values at paths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
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
    """Return a copy of a case's data with other values at some paths.

    Parameters
    ----------
    data : mapping
        The case as read from TOML; sections left to their defaults may be missing.
    values : mapping of str to value
        By path; each path is one of `known_paths`.
    """
    changed = deepcopy(dict(data))
    for path, value in values.items():
        *above, last = path.split(".")
        place: Any = changed
        for key in above:
            place = place[int(key)] if isinstance(place, list) else place.setdefault(key, {})
        place[int(last) if isinstance(place, list) else last] = deepcopy(value)
    return changed
