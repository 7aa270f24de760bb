"""Former models of machines, and rollback to them.

The service copies each model file at its start, by its fingerprint (SHA-256). A rollback pins a
machine to a copy until the model file of the settings changes again.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.files import whole_file, write_text
from thermojoint.live.settings import Service

#: Number of remembered models per machine, including the present one.
_MOST_REMEMBERED = 5
#: Number of displayed characters of a fingerprint, which also name the folder of a copy.
SHOWN = 12
#: Suffix of the name of a section added by `pinned`.
_PINNED = re.compile(rf"@[0-9a-f]{{{SHOWN}}}$")


class Deployment(NamedTuple):
    """A model that a machine has run with."""

    #: SHA-256 of its file.
    fingerprint: str
    file: str
    #: Time of deployment, s since 1970.
    since: float


class Pin(NamedTuple):
    """A rollback."""

    #: Fingerprint of the model that the machine is rolled back to.
    fingerprint: str
    #: Fingerprint of the model file of the settings; the pin ends when that file changes.
    instead_of: str


class Record(NamedTuple):
    """Deployments of every machine, oldest first, and the pins."""

    deployments: dict[str, list[Deployment]]
    pins: dict[str, Pin]


_RECORD = TypeAdapter(Record)


def fingerprint_of(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a model file") from error


def read_record(folder: Path) -> Record:
    """Return the deployments in the folder of a service; none before its first start.

    Raises
    ------
    InputError
        The file is damaged.
    """
    path = _path(folder)
    if not path.exists():
        return Record({}, {})
    try:
        return _RECORD.validate_json(path.read_bytes())
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: damaged; remove it to forget former models") from error


def pinned(service: Service) -> Service:
    """Return a service in which rolled-back machines have a section for their former model.

    Raises
    ------
    InputError
        The record is damaged.
    """
    record, given = read_record(service.folder), service.given
    if not record.pins:
        return service
    models, machines = dict(given.models), dict(service.machines)
    current = fingerprints(service)
    for name, pin in record.pins.items():
        section = machines.get(name)
        copy = section and _copy(record, service.folder, name, pin.fingerprint)
        if section is None or copy is None or pin.instead_of != current.get(section.model):
            continue
        key = f"{section.model}@{pin.fingerprint[:SHOWN]}"
        # A scene belongs to one model.
        models[key] = given.models[section.model].model_copy(update={"file": copy, "scene": None})
        machines[name] = section.model_copy(update={"model": key})
    return replace(service, given=given.model_copy(update={"models": models}), machines=machines)


def fingerprints(service: Service) -> dict[str, str]:
    """Return the fingerprint of every model file that can be read, by the name of its section."""
    models = service.given.models.items()
    return {name: fingerprint_of(one.file) for name, one in models if one.file.is_file()}


def record_deployments(service: Service, now: float) -> Iterator[tuple[str, str]]:
    """Record the models that the machines run with; yield each machine whose model has changed.

    With it the former and the new model are yielded as text. The service is one after `pinned`;
    `now` is the present time, s since 1970.
    """
    record, current = read_record(service.folder), fingerprints(service)
    before = json.dumps(record)
    for name, section in service.machines.items():
        file, fingerprint = service.given.models[section.model].file, current[section.model]
        known = record.deployments.setdefault(name, [])
        if not known or known[-1].fingerprint != fingerprint:
            was = f"{known[-1].file} {known[-1].fingerprint[:SHOWN]}" if known else "none"
            yield name, f"model {file.name} {fingerprint[:SHOWN]}, was {was}"
            known.append(Deployment(fingerprint, file.name, now))
            del known[:-_MOST_REMEMBERED]
        if not _PINNED.search(section.model):
            # The settings' file has changed, or the machine was never rolled back.
            record.pins.pop(name, None)
        copy = _copy_path(service.folder, fingerprint, file.name)
        if not copy.exists():
            copy.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(copy) as part:
                shutil.copyfile(file, part)
    if json.dumps(record) != before:
        _write(service.folder, record)
        _delete_unused_copies(service.folder, record)


def former_of(record: Record, folder: Path, machine: str) -> Deployment | None:
    """Return the last model of a machine before its present one; None without any."""
    known = record.deployments.get(machine, [])
    others = [
        one
        for one in known
        if one.fingerprint != known[-1].fingerprint and _copy_path(folder, *one[:2]).exists()
    ]
    return others[-1] if others else None


def roll_back(service: Service, machine: str, to: str | None = None) -> Deployment:
    """Pin a machine to a former model; effective at the next start or reload of the service.

    `to` is the beginning of its fingerprint; by default it is the last model before the present
    one.

    Raises
    ------
    InputError
        There is no such machine or model.
    """
    if machine not in service.machines:
        raise unknown_name("machine", machine, service.machines, "rollback")
    record = read_record(service.folder)
    target = former_of(record, service.folder, machine)
    if to is not None:
        known = record.deployments.get(machine, [])
        target = next((one for one in reversed(known) if one.fingerprint.startswith(to)), None)
    if target is None:
        raise InputError(
            f"{machine}: no former model{f' {to}' if to else ''} is kept; none to go to"
        )
    instead_of = fingerprint_of(service.given.models[service.machines[machine].model].file)
    record.pins[machine] = Pin(target.fingerprint, instead_of)
    _write(service.folder, record)
    return target


def _path(folder: Path) -> Path:
    return folder / "models" / "deployments.json"


def _copy_path(folder: Path, fingerprint: str, file: str) -> Path:
    return folder / "models" / "former" / fingerprint[: 2 * SHOWN] / file


def _copy(record: Record, folder: Path, machine: str, fingerprint: str) -> Path | None:
    """Return the copy of a former model of a machine; None if it is missing."""
    for one in record.deployments.get(machine, []):
        path = _copy_path(folder, *one[:2])
        if one.fingerprint == fingerprint and path.exists():
            return path
    return None


def _write(folder: Path, record: Record) -> None:
    write_text(_path(folder), json.dumps(record._asdict()))


def _delete_unused_copies(folder: Path, record: Record) -> None:
    """Delete the copies that belong to no deployment."""
    known = {one.fingerprint[: 2 * SHOWN] for each in record.deployments.values() for one in each}
    for path in (folder / "models" / "former").iterdir():
        if path.name not in known:
            shutil.rmtree(path, ignore_errors=True)
