"""Check of everything that a start of the service would refuse, without starting it."""

from __future__ import annotations

import shutil
import socket
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from thermojoint.artefacts.errors import InputError, ThermojointError
from thermojoint.artefacts.folders import check_place
from thermojoint.live.accounts import accounts_of
from thermojoint.live.certificates import expiry_warnings, http_identity, opcua_identity
from thermojoint.live.consistency import contradictions
from thermojoint.live.former_models import pinned
from thermojoint.live.ip_address import family_of
from thermojoint.live.loaded_models import LoadedModel, load_models, machine_models
from thermojoint.live.readers.reader import readers_of
from thermojoint.live.scene import scene_of
from thermojoint.live.settings import Service
from thermojoint.live.store import check_store, is_locked, occupied
from thermojoint.live.trust_list import contents_of

#: Content of the service's folder that a check examines; the folder is not changed.
_LOOKED_AT = ("models", "certificate.pem", "key.pem", "access.sqlite", "access.sqlite-wal")


class Findings(NamedTuple):
    """Results of a check, one line each."""

    #: Errors that would prevent a start.
    refused: list[str]
    #: Warnings of a start, and certificates that expire soon.
    warnings: list[str]


def checked(service: Service) -> Findings:
    """Check the files, models, secrets and certificates of a service; nothing is written."""
    with TemporaryDirectory() as place:
        folder = Path(place) / "state"
        _copy(service.folder, folder)
        given = service.given.model_copy(update={"folder": folder})
        return _findings(replace(service, given=given), service.folder)


def _findings(service: Service, folder: Path) -> Findings:
    refused = []
    try:
        service = pinned(service)
    except InputError as error:
        refused.append(str(error))
    models, refused_models = load_models(service)
    refused += [f"models.{name}: {reason}" for name, reason in refused_models.items()]
    usable = {name: one for name, one in service.machines.items() if one.model in models}
    service = replace(service, machines=usable)
    checks: list[Callable[[], object]] = [
        partial(check_place, folder, folder.absolute()),
        partial(check_store, folder / "history.sqlite"),
        partial(readers_of, service, machine_models(models, service)),
        *(partial(_check_scene, service, models, name) for name in models),
        *(partial(_check_target, service, models, name) for name in usable),
        partial(_check_users, service),
        partial(_check_interfaces, service),
    ]
    for check in checks:
        try:
            check()
        except ThermojointError as error:
            refused += str(error).splitlines()
    soon = expiry_warnings(service.given, service.folder, datetime.now(UTC))
    return Findings(refused, [*contradictions(service.given, models), *soon])


def used_by_others(service: Service, present: Service | None = None) -> list[str]:
    """Return the folder if another service runs on it, and addresses in use by other programs.

    Nothing is returned if the service runs already. It may replace a service that is `present`,
    whose folder and ports are its own.
    """
    if present is None and is_locked(service.folder):
        return []
    own = {port for _, _, port in _listening(present)} if present else set()
    busy = []
    elsewhere = present and service.folder.resolve() != present.folder.resolve()
    if elsewhere and is_locked(service.folder):
        busy.append(occupied(service.folder))
    for name, address, port in _listening(service):
        try:
            if port not in own:
                socket.create_server((address, port), family=family_of(address)).close()
        except OSError as error:
            busy.append(f"{name}: {address}:{port}: {error.strerror}; take another port")
    return busy


def _listening(service: Service) -> list[tuple[str, str, int]]:
    """Return the interfaces that listen: section, address, port."""
    file = service.given
    sections = (("opcua", file.opcua), ("http", file.http), ("shdr", file.shdr))
    return [(name, one.address, one.port) for name, one in sections if one is not None]


def _copy(source: Path, target: Path) -> None:
    target.mkdir()
    for name in _LOOKED_AT:
        path = source / name
        if path.is_dir():
            shutil.copytree(path, target / name)
        elif path.exists():
            shutil.copy2(path, target / name)


def _check_scene(service: Service, models: dict[str, LoadedModel], name: str) -> None:
    file, estimator = service.given.models[name].scene, models[name].estimator
    if file is not None:
        scene_of(file, estimator, estimator.initial_state)


def _check_target(service: Service, models: dict[str, LoadedModel], name: str) -> None:
    section = service.machines[name]
    if section.target is not None:
        from thermojoint.live.targets.writing import target_of

        target_of(service, name, models[section.model])


def _check_users(service: Service) -> None:
    accounts = accounts_of(service)
    with closing(accounts.store):
        if service.given.http:
            accounts.check_log_in()


def _check_interfaces(service: Service) -> None:
    http, opcua, mqtt = service.given.http, service.given.opcua, service.given.mqtt
    if http is not None and http.security == "tls":
        http_identity(http, service.folder)
    if mqtt is not None:
        from thermojoint.live.mqtt_session import address_of

        address_of(mqtt, "mqtt")
    if opcua is not None and opcua.security == "sign-and-encrypt":
        if service.users_file is None:
            raise InputError("opcua: no one could log in; name a file of users")
        opcua_identity(opcua, service.folder)
    if opcua is not None and opcua.trusted is not None:
        contents_of(opcua.trusted)
