"""From a CAD part or a mesh to a simulated displacement: faces, names, the case, the result."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from meshes.units import UNITS
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.settings import toml
from thermojoint.setup_pages.place import CAD, MESHES, ExistsError, Given, Place, chosen, one
from thermojoint.setup_pages.settings_files import CASE, fields_in, form_of, save

FACES, NAMES, MESH = "faces.toml", "names.toml", "part.msh"
#: Meshes created by the steps.
_OWN = ("faces.msh", MESH)
_NAME = re.compile(r"[A-Za-z0-9_.+-]{1,64}")
_DEFORMED = "--show=deformation"
_SECTIONS = ("bodies_mm", "joints", "surfaces_mm")


class Named(NamedTuple):
    """A body, a joint or a face of the part."""

    #: Place in the draft, ``SECTION:NAME``; also the name in the form.
    key: str
    #: Value in the draft: points, or bodies.
    value: Any
    hint: str
    #: Given name; empty for a face without one.
    name: str


def _source(place: Place) -> str:
    """Return the part or mesh chosen last; empty without one."""
    return next((name for name in place.record("part").read if place.has(name)), "")


def _size(place: Place) -> str:
    words = [word for words in place.record("part").commands for word in words]
    sizes = [word.partition("=")[2] for word in words if word.startswith("--size-mm=")]
    return sizes[0] if sizes else "10"


def show_part(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the part."""
    parts = place.files(*CAD) + [name for name in place.files(*MESHES) if name not in _OWN]
    return {
        "parts": parts,
        "part": one(given, "part", _source(place)),
        "size": one(given, "size", _size(place)),
        "units": [*UNITS],
        "unit": one(given, "unit", "m"),
    }


def do_part(place: Place, given: Given) -> None:
    """Number the faces of a part, or inspect a mesh."""
    part = place.existing(one(given, "part"))
    if Path(part).suffix.lower() not in CAD:
        unit = chosen(given, "unit", [*UNITS], "unit")
        case = [] if place.has(CASE) else [f"--case={CASE}"]
        place.run("part", given, ["inspect", part, f"--unit={unit}", "--faces=faces.png", *case])
        return
    size = one(given, "size")
    if not _is_length(size):
        raise InputError(f"element size: {size!r} is no length; give e.g. 10")
    mesh = ["mesh", part, f"--size-mm={size}", f"--draft={FACES}", "--out=faces.msh"]
    place.check_replaced([FACES], given)
    place.jobs.check_free()
    place.path(FACES).unlink(missing_ok=True)
    place.run("part", given, mesh, ["inspect", "faces.msh", "--faces=faces.png"])


def _is_length(text: str) -> bool:
    try:
        return 0.0 < float(text) < math.inf
    except ValueError:
        return False


def _named(place: Place, given: Given) -> list[Named]:
    """Return bodies, joints and faces of the draft, with their given names."""
    if not place.has(FACES):
        return []
    before = toml.parse(place.text(NAMES), NAMES)
    bodies: dict[str, str] = {}
    found = []
    for field in fields_in(place, FACES):
        section, name = field.path
        known: Mapping[str, Any] = before.get(section, {})
        if section == "bodies_mm":
            given_name = next((own for own, at in known.items() if at == field.value), name)
            bodies[name] = given_name
        elif section == "joints":
            pair = [bodies.get(body, body) for body in field.value]
            usual = "_".join(pair) if bodies else name
            given_name = next((own for own, both in known.items() if both == pair), usual)
        else:
            own_points = (own for own, points in known.items() if field.value[0] in points)
            given_name = next(own_points, "")
        key = f"{section}:{name}"
        found.append(Named(key, field.value, field.hint, one(given, key, given_name)))
    return found


def show_names(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the names."""
    rows = _named(place, given)
    return {
        "mesh": Path(_source(place)).suffix.lower() in MESHES and _source(place),
        "sections": {
            title: [row for row in rows if row.key.startswith(f"{section}:")]
            for section, title in zip(_SECTIONS, ("Bodies", "Joints", "Faces"), strict=True)
        },
    }


def do_names(place: Place, given: Given) -> None:
    """Write the names, and mesh the part with them."""
    part, rows = _source(place), _named(place, given)
    if not rows:
        raise InputError(f"{FACES}: is missing; choose a part first")
    for row in rows:
        if row.name and not _NAME.fullmatch(row.name):
            raise InputError(f"{row.name!r}: use letters, digits, _ . + - in a name")
    text, before = _names_text(part, rows), place.text(NAMES)
    if before and not before.startswith(_heading(part)) and "replace" not in given:
        raise ExistsError([NAMES])
    mesh = ["mesh", part, f"--size-mm={_size(place)}", f"--names={NAMES}", f"--out={MESH}"]
    case = [] if place.has(CASE) else [f"--case={CASE}"]
    place.check_replaced([MESH, "part.png"], given)
    write_text(place.path(NAMES), text)
    place.run("names", given, mesh, ["inspect", MESH, "--faces=part.png", *case])


def _heading(part: str) -> str:
    return f"# Names of {part}, by points on its faces (mm); written by 'thermojoint setup'.\n"


def _names_text(part: str, rows: list[Named]) -> str:
    bodies = {row.key.partition(":")[2]: row.name for row in rows if row.key.startswith("bodies")}
    sections: dict[str, dict[str, Any]] = {section: {} for section in _SECTIONS}
    for row in rows:
        section, _, old = row.key.partition(":")
        if section == "surfaces_mm" and row.name:
            sections[section].setdefault(row.name, []).extend(row.value)
        elif section == "bodies_mm":
            _once(sections[section], row.name or old, row.value)
        elif section == "joints" and row.name:
            _once(sections[section], row.name, [bodies[body] or body for body in row.value])
    lines = [_heading(part).rstrip()]
    for section, entries in sections.items():
        lines += ["", f"[{section}]"]
        lines += [f"{toml.as_key(name)} = {value!r}".replace("'", '"')
                  for name, value in entries.items()]  # fmt: skip
    return "\n".join(lines) + "\n"


def _once(entries: dict[str, Any], name: str, value: Any) -> None:  # noqa: ANN401
    if name in entries:
        raise InputError(f"{name}: two have this name; give each its own")
    entries[name] = value


def is_named(place: Place) -> bool:
    """Whether bodies and faces have names: from the page, or in the mesh."""
    mesh = Path(_source(place)).suffix.lower() in MESHES
    return place.is_done("part") if mesh else place.is_done("names")


def show_case(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the case."""
    return {"form": form_of(place, CASE, given), "named": is_named(place)}


def do_case(place: Place, given: Given) -> None:
    """Save the case and draw it, or create it anew."""
    if "begin" not in given:
        save(place, given)
        place.run("case", given, ["inspect", CASE, "--out=machine.png"])
        return
    if place.has(CASE):
        if "replace" not in given:
            raise ExistsError([CASE])
        place.set_aside(CASE)
    source = _source(place)
    mesh = source if Path(source).suffix.lower() in MESHES else place.existing(MESH)
    words = next((words for words in place.record("part").commands if words[1] == mesh), [])
    unit = [word for word in words if word.startswith("--unit=")]
    place.run("draft", given, ["inspect", mesh, *unit, f"--case={CASE}"])


def show_result(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the result."""
    deformed = [words for words in place.record("result").commands if _DEFORMED in words]
    return {"case": place.has(CASE), "deformed": bool(deformed) or "deformed" in given}


def do_result(place: Place, given: Given) -> None:
    """Simulate the case, and draw its curves and, if requested, its deformation."""
    place.existing(CASE)
    deformed = ["view", "machine.nc", _DEFORMED, "--out=deformed.png"]
    place.run(
        "result",
        given,
        ["simulate", CASE, "--out=machine.nc"],
        ["view", "machine.nc", "--out=curves.png"],
        *([deformed] if "deformed" in given else []),
    )
