"""From a log to an estimate: content, names of columns, learning, measured against estimated."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from calibrate.learning.learn import KINDS
from estimator.registry import kind_of_file
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.log_file import mapping_from_data, read_mapping
from thermojoint.artefacts.quantities import UNITS, column_assumed, column_named
from thermojoint.artefacts.settings.toml import as_key, as_text
from thermojoint.artefacts.tables.clock import clock_word
from thermojoint.artefacts.tables.dialect import dialect_of
from thermojoint.artefacts.tables.layout import HEAD
from thermojoint.artefacts.tables.source import lines_of
from thermojoint.setup_pages.place import MAPPING, RESPONSES, ExistsError, Given, Place, chosen, one

_MOST_SENSORS = 4
_NAMES = "name:"


class NamedColumn(NamedTuple):
    """A column of a log."""

    #: Name in the file, and new name; empty if it keeps its own.
    theirs: str
    ours: str
    #: Meaning of the column; empty if it is ignored.
    quantity: str

    @property
    def name(self) -> str:
        """Name in commands."""
        return self.ours or self.theirs


def columns_of(path: Path, renamed: Mapping[str, str]) -> list[NamedColumn]:
    """Return the columns of a log from its first lines, even if it is not a valid log yet.

    Raises
    ------
    InputError
        The file is not a table.
    """
    with lines_of(path, "log") as lines:
        dialect = dialect_of(list(islice(lines, HEAD)), str(path), True)
    found = []
    for given, name in zip(dialect.given, dialect.names, strict=True) if dialect else ():
        ours = renamed.get(given, renamed.get(name, ""))
        column = column_named(ours or name) or column_assumed(ours or name)
        clock = clock_word(ours or name) or (column is not None and column.quantity == "time")
        found.append(
            NamedColumn(
                name if name != given and not ours else given,
                ours,
                "clock" if clock else column.quantity if column else "",
            )
        )
    return found


def _logs(place: Place) -> list[str]:
    """Return the logs of the last `look`."""
    return [name for name in place.record("log").read if name != MAPPING and place.has(name)]


def _renamed(place: Place) -> dict[str, str]:
    return read_mapping(place.path(MAPPING)) if place.has(MAPPING) else {}


def _columns(place: Place) -> list[NamedColumn]:
    logs = _logs(place)
    return columns_of(place.path(logs[0]), _renamed(place)) if logs else []


def show_log(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the log."""
    names = {key.removeprefix(_NAMES): one(given, key) for key in given if key.startswith(_NAMES)}
    return {
        "tables": place.tables(),
        "chosen": [*given.get("log", ())] or _logs(place),
        "columns": [column._replace(ours=names.get(column.theirs, column.ours))
                    for column in _columns(place)],
        "units": [f"_{unit}" for unit in UNITS],
        "prefix": _NAMES,
    }  # fmt: skip


def do_log(place: Place, given: Given) -> None:
    """Rename columns, and examine the chosen logs."""
    if "log" in given:
        logs = [place.existing(name) for name in given["log"]]
    else:
        logs = _logs(place)
        columns = {
            key.removeprefix(_NAMES): one(given, key)
            for key in given
            if key.startswith(_NAMES) and one(given, key)
        }
        _write_mapping(place, columns, given)
    if not logs:
        raise InputError("log: choose one or more files")
    mapping = [f"--mapping={MAPPING}"] if place.has(MAPPING) else []
    place.run("log", given, ["look", *logs, *mapping, "--out=log.png"])


def _write_mapping(place: Place, columns: dict[str, str], given: Given) -> None:
    """Write the names of columns; a file changed by the user is only replaced if allowed."""
    path = place.path(MAPPING)
    before = place.text(MAPPING)
    if before and before != _mapping_text(_renamed(place)) and "replace" not in given:
        raise ExistsError([MAPPING])
    mapping_from_data({"columns": columns}, MAPPING)
    if columns:
        write_text(path, _mapping_text(columns))
    elif before:
        path.unlink()


def _mapping_text(columns: dict[str, str]) -> str:
    lines = [f"{as_key(theirs)} = {as_text(ours)}" for theirs, ours in columns.items()]
    return "\n".join(["[columns]", *lines]) + "\n"


def show_learn(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of learning."""
    words = shlex.join(next(iter(place.record("learn").commands), []))
    columns = _columns(place)
    lengths = [c.name for c in columns if _is_displacement(c.name)]
    before = [name for name in lengths if f"--displacement={name}" in words]
    return {
        "logs": _logs(place),
        "lengths": lengths,
        "wanted": [*given.get("displacement", before or lengths)],
        "temperatures": [c.name for c in columns if c.quantity == "temperature"],
        "ignored": [*given.get("ignore", ())],
        "kinds": KINDS,
        "kind": one(given, "kind", "learned"),
        "most": one(given, "most", str(_MOST_SENSORS)),
    }


def _is_displacement(name: str) -> bool:
    column = column_named(name) or column_assumed(name)
    return column is not None and column.is_displacement


def do_learn(place: Place, given: Given) -> None:
    """Learn a model from the logs."""
    logs, known = _logs(place), [column.name for column in _columns(place)]
    if not logs:
        raise InputError("log: look at one first")
    options = [
        f"--{name}={value}"
        for name in ("displacement", "ignore")
        for value in given.get(name, ())
        if value in known
    ]
    if not any(option.startswith("--displacement") for option in options):
        raise InputError("displacement: choose at least one column to learn")
    kind = chosen(given, "kind", KINDS, "kind")
    most = one(given, "most", str(_MOST_SENSORS))
    if not (most.isascii() and most.isdigit() and len(most) < 4):
        raise InputError(f"most sensors: {most!r} is no whole number; give e.g. {_MOST_SENSORS}")
    mapping = [f"--mapping={MAPPING}"] if place.has(MAPPING) else []
    settings = [f"--max-sensors={most}", f"--kind={kind}", *mapping]
    outputs = ["--out=model.json", "--figure=held-out.png"]
    place.run("learn", given, ["learn", *logs, *options, *settings, *outputs])


def show_compare(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of measured against estimated displacement."""
    models, days = place.models(), [*place.tables(), *place.files(*RESPONSES)]
    learned = place.record("learn").read
    before = place.record("compare").read
    unseen = [name for name in days if name not in learned]
    return {
        "models": models,
        "model": one(given, "model", next((m for m in before if m in models), "model.json")),
        "days": days,
        "day": one(given, "day", next((d for d in (*before, *unseen) if d in days), "")),
        "learned": learned,
    }


def do_compare(place: Place, given: Given) -> None:
    """Estimate a day, and compare the estimates with its measured displacements, if any."""
    model = chosen(given, "model", place.models(), "model")
    day = place.existing(one(given, "day"))
    kind = kind_of_file(place.path(model))
    response, mapping = Path(day).suffix in RESPONSES, []
    if response:
        judged = kind.judge is not None
    else:
        # A learned model contains the names of its own log.
        own = kind.renamed(kind.read(place.path(model)))
        if not own and place.has(MAPPING):
            mapping = [f"--mapping={MAPPING}"]
        columns = columns_of(place.path(day), own or _renamed(place))
        judged = kind.judge_logs is not None and any(_is_displacement(c.name) for c in columns)
    estimate = ["estimate", model, day, *mapping, "--out=estimate.csv"]
    picture = [] if response else ["--out=truth.png"]
    validate = [["validate", model, day, *mapping, *picture]] if judged else []
    place.run("compare", given, estimate, *validate)
