"""Files of settings edited by the pages, checked by their own rules before they are written."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import Any

from estimator.estimate_table import Row, read_estimate, strokes_of
from fesim.case.schema import case_from_data
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.tables.source import lines_of
from thermojoint.compensation.offsets.output import OutputSettings
from thermojoint.compensation.offsets.settings import read_settings, settings_from_data, with_slopes
from thermojoint.live.settings import service_from_data
from thermojoint.live.targets.settings import target_from_data
from thermojoint.setup_pages.place import Given, Place, one
from thermojoint.setup_pages.toml_form import Field, by_field, changed, fields_of

ESTIMATE = "estimate.csv"
#: Number of rows of the estimate from which its axes are read.
_HEAD = 200
OFFSETS, TARGET, SERVICE, CASE = "offsets.toml", "target.toml", "service.toml", "machine.toml"
#: Key that only the page of the dry run changes.
ENABLE = "enable"
Data = dict[str, Any]


class RefusedError(InputError):
    """Values of a form are refused."""

    def __init__(self, lines: Mapping[str, Sequence[str]]) -> None:
        #: Name of a field, empty for none, to its mistakes.
        self.lines = lines
        super().__init__("\n".join(line for one in lines.values() for line in one))


def estimated(place: Place) -> tuple[tuple[str, ...], list[Row]]:
    """Return the axes of the estimate, and its first rows; raises InputError without one."""
    with lines_of(place.path(place.existing(ESTIMATE)), "estimate") as lines:
        return read_estimate(islice(lines, _HEAD), ESTIMATE)


def _output(place: Place) -> OutputSettings | None:
    """Return the offsets, with the strokes of their slopes; None while either is unknown."""
    if not place.has(OFFSETS):
        return None
    settings = read_settings(place.path(OFFSETS))
    if settings.slopes:
        if not place.has(ESTIMATE):
            return None
        settings = with_slopes(settings, strokes_of(*estimated(place)), OFFSETS)
    return settings.output


#: Function that checks the content of each file.
_CHECKS: Mapping[str, Callable[[Place, Data], object]] = {
    OFFSETS: lambda place, data: settings_from_data(data, OFFSETS),
    TARGET: lambda place, data: target_from_data(data, place.path(TARGET), _output(place)),
    SERVICE: lambda place, data: service_from_data(data, SERVICE, place.folder),
    CASE: lambda place, data: case_from_data(data, CASE, place.folder),
}


def form_of(place: Place, name: str, given: Given) -> dict[str, Any] | None:
    """Return the content of the form of a file, with sent values; None without the file.

    Raises
    ------
    InputError
        The file is not TOML.
    """
    if not place.has(name):
        return None
    text = place.text(name)
    sent = given if one(given, "file") == name else {}
    rows = [(field, sent.get(field.name, field.texts)) for field in fields_in(place, name)]
    sections: dict[str, list[tuple[Field, Sequence[str]]]] = {}
    for field, values in rows:
        sections.setdefault(field.section, []).append((field, values))
    return {"file": name, "text": text, "digest": _digest(text), "sections": sections}


def save(place: Place, given: Given) -> str:
    """Write the sent values into a file of settings, and return its name.

    Raises
    ------
    RefusedError
        A value is refused; the file is not changed.
    InputError
        The file has changed since the form was shown, or is not one of these files.
    """
    name = one(given, "file")
    if name not in _CHECKS or not place.has(name):
        raise InputError(f"{name!r}: no file of settings; load the page again")
    text, fields = place.text(name), fields_in(place, name)
    if one(given, "digest") != _digest(text):
        raise InputError(f"{name}: has changed since this page was shown; look at it again")
    new = changed(text, given, fields)
    try:
        _CHECKS[name](place, toml.parse(new, name))
    except InputError as error:
        lines = str(error).replace(str(place.path(name)), name).splitlines()
        raise RefusedError(by_field(lines, name, fields)) from error
    if new != text:
        write_text(place.path(name), new)
    return name


def fields_in(place: Place, name: str) -> list[Field]:
    """Return the fields of a file; raises InputError if it is not TOML."""
    toml.parse(place.text(name), name)
    return [field for field in fields_of(place.text(name)) if field.path != (ENABLE,)]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
