"""From an estimate to offsets in a control: settings, dry run, enabling, the running service."""

from __future__ import annotations

import csv
import json
import os
import re
import secrets
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from itertools import islice
from typing import Any

import numpy as np
from pydantic import BaseModel

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.templates import templates_of
from thermojoint.compensation.offsets.settings import read_settings
from thermojoint.compensation.offsets.usable import UNUSABLE
from thermojoint.live.access_store import open_access
from thermojoint.live.secret import create_private
from thermojoint.live.settings import Secret, Service, read_service
from thermojoint.live.store import lock_owner, send_sighup
from thermojoint.live.targets.settings import CONTROLS, read_target
from thermojoint.live.tokens import add_token, revoke_token, tokens_in
from thermojoint.setup_pages.place import ExistsError, Given, Place, chosen, one
from thermojoint.setup_pages.settings_files import (
    ENABLE,
    ESTIMATE,
    OFFSETS,
    SERVICE,
    TARGET,
    estimated,
    form_of,
    save,
)
from thermojoint.setup_pages.toml_form import changed, fields_of

SOURCES = ("csv", "mqtt", "opcua", "mtconnect")
PLAIN, LINUXCNC = "plain", "linuxcnc"
#: Kind of control to its name on the pages.
KINDS: Mapping[str, str] = {
    PLAIN: "plain offsets, which a control or PLC reads by HTTP, OPC UA or MQTT",
    LINUXCNC: "LinuxCNC",
    **{kind: control.title for kind, control in CONTROLS.items()},
}
#: Number of writes of a dry run shown on a page.
SHOWN = 500
_TOKEN, _CNC_TOKEN, _CNC_DAYS = "dashboard.token", "linuxcnc.token", 365.0
_AXIS = "axis:"
_USUAL_NUMBERS = {"X": 1, "Y": 2, "Z": 3}


def _filled(name: str, **values: Any) -> str:  # noqa: ANN401
    template = templates_of("thermojoint.setup_pages").get_template(f"{name}.j2")
    return template.render(key=toml.as_key, text=toml.as_text, **values)


def _estimated(place: Place) -> tuple[tuple[str, ...], float]:
    """Return the axes of the estimate, and its interval, s."""
    axes, rows = estimated(place)
    steps = np.diff([row.time for row in rows])
    return axes, float(np.median(steps)) if len(steps) else 1.0


def show_offsets(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the offsets."""
    axes = _estimated(place)[0]
    return {"form": form_of(place, OFFSETS, given), "prefix": _AXIS,
            "axes": {axis: one(given, _AXIS + axis, axis.upper() if len(axis) == 1 else "")
                     for axis in axes}}  # fmt: skip


def do_offsets(place: Place, given: Given) -> None:
    """Create the settings of the offsets, or save them and preview the offsets of the estimate."""
    known, interval = _estimated(place)
    if "begin" in given:
        entered = {axis: name for axis in known if (name := one(given, _AXIS + axis))}
        named = {name: axis for axis, name in entered.items()}
        if not named:
            raise InputError("axes: name at least one axis of the control")
        for axis, name in entered.items():
            if named[name] != axis:
                raise InputError(
                    f"axes: {name} would compensate both {axis} and {named[name]}; name it once"
                )
        values = {"axes": named, "known": known, "oldest": max(30.0, 3.0 * interval)}
        place.begin(OFFSETS, _filled(OFFSETS, unusable=json.dumps(UNUSABLE), **values), given)
        return
    save(place, given)
    _switch(place, False)
    place.run("offsets", given, _compensate())


def _compensate() -> list[str]:
    return ["compensate", ESTIMATE, f"--settings={OFFSETS}", "--out=offsets.csv"]


def show_control(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the machine and its control."""
    service = _service(place)
    return {
        "kinds": KINDS,
        "kind": one(given, "kind", _kind(place)),
        "sources": SOURCES,
        "source": one(given, "source", "csv"),
        "machine": one(given, "machine", "mill"),
        "service": form_of(place, SERVICE, given),
        "target": form_of(place, TARGET, given) if _kind(place) in CONTROLS else None,
        "missing": _missing_secrets(place) if service else [],
    }


def is_complete(place: Place) -> bool:
    """Whether the files of the service and everything named in them exist."""
    return _service(place) is not None and not _missing_secrets(place)


def do_control(place: Place, given: Given) -> None:
    """Create or save the files of the service and of its target, or store a password."""
    if "secret" in given:
        name = chosen(given, "secret", _missing_secrets(place), "password")
        _keep_secret(place, name, one(given, "value"))
    elif "begin" in given:
        _begin(place, given)
    else:
        save(place, given)
        _switch(place, False)
    if _TOKEN in _missing_secrets(place):
        _keep_secret(place, _TOKEN, secrets.token_hex(24))


def _begin(place: Place, given: Given) -> None:
    machine, source = one(given, "machine"), chosen(given, "source", SOURCES, "readings")
    kind = chosen(given, "kind", [*KINDS], "control")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", machine):
        raise InputError(f"machine: {machine!r}: use up to 64 letters, digits, - and _")
    if not place.has(OFFSETS):
        raise InputError(f"{OFFSETS}: is missing; set the offsets first")
    names = read_settings(place.path(OFFSETS)).output.names
    compared, models = place.record("compare").read, place.models()
    model = next((name for name in compared if name in models), (models or ["model.json"])[0])
    wanted = [TARGET, SERVICE] if kind in CONTROLS else [SERVICE]
    if (there := [name for name in wanted if place.has(name)]) and "replace" not in given:
        raise ExistsError(there)
    if kind in CONTROLS:
        numbers = {axis: _USUAL_NUMBERS.get(axis, k) for k, axis in enumerate(names, 4)}
        title = CONTROLS[kind].title
        text = _filled(TARGET, kind=kind, kinds=[*CONTROLS], title=title, axes=numbers)
        place.begin(TARGET, text, given)
    by = "target" if kind in CONTROLS else "http" if kind == LINUXCNC else ""
    interval = _estimated(place)[1] if place.has(ESTIMATE) else 1.0
    place.begin(SERVICE, _filled(SERVICE, machine=machine, source=source, by=by, model=model,
                                 models=models or [model], interval=interval), given)  # fmt: skip


def _service(place: Place) -> Service | None:
    """Return the service of the file; None if the file is missing or has mistakes."""
    if not place.has(SERVICE):
        return None
    try:
        return read_service(place.path(SERVICE))
    except InputError:
        return None


def _machine(service: Service) -> str:
    return next(iter(service.machines))


def _kind(place: Place) -> str:
    """Return the kind of control according to the files."""
    service = _service(place)
    handshake = service.machines[_machine(service)].handshake if service else None
    if handshake is not None and handshake.by == "target" and place.has(TARGET):
        data = toml.parse(place.text(TARGET), TARGET)
        return str(data.get("kind", PLAIN))
    return LINUXCNC if handshake is not None and handshake.by == "http" else PLAIN


def _secrets(settings: Any) -> Iterator[Secret]:  # noqa: ANN401 - sections, tables, values
    if isinstance(settings, Secret):
        yield settings
    elif isinstance(settings, dict | BaseModel):
        for _, value in settings.items() if isinstance(settings, dict) else settings:
            yield from _secrets(value)


def _missing_secrets(place: Place) -> list[str]:
    """Return the missing files of secrets that the settings locate in the folder."""
    service, named = _service(place), []
    if service is not None:
        named += list(_secrets(service.given))
    if place.has(TARGET) and _kind(place) in CONTROLS:
        try:
            named += list(_secrets(read_target(place.path(TARGET))))
        except InputError:
            return []
    paths = [secret.file for secret in named if secret.file is not None]
    return [path.name for path in paths if path.parent == place.folder and not path.exists()]


def _keep_secret(place: Place, name: str, value: str) -> None:
    """Write a secret into a new file that only its owner can read."""
    if not value:
        raise InputError(f"{name}: write the password")
    path = place.path(name)
    create_private(path)
    path.write_text(f"{value}\n", "utf-8")


def _is_enabled(place: Place) -> bool:
    return place.has(TARGET) and bool(toml.parse(place.text(TARGET), TARGET).get(ENABLE))


def _switch(place: Place, on: bool) -> None:
    """Enable or disable the target; a running service follows."""
    if _is_enabled(place) == on or not place.has(TARGET):
        return
    text = place.text(TARGET)
    fields = [field for field in fields_of(text) if field.path == (ENABLE,)]
    new = changed(text, {ENABLE: [str(on).lower()]}, fields)
    if not fields:
        new = f"{ENABLE} = {str(on).lower()}\n{text}"
    write_text(place.path(TARGET), new)
    if (service := _service(place)) is not None:
        send_sighup(service.folder)


def show_try(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the dry run."""
    kind = _kind(place)
    table = "writes.csv" if kind in CONTROLS else "offsets.csv"
    header, rows, count = _table(place, table)
    return {
        "kind": kind,
        "control": KINDS.get(kind, kind),
        "of_target": kind in CONTROLS,
        "table": table,
        "header": header,
        "rows": rows,
        "count": count,
        "shown": SHOWN,
        "enabled": _is_enabled(place) if kind in CONTROLS else place.record("enable").code == 0,
        "done": place.is_done("try"),
        "inis": place.files(".ini"),
        "ini": one(given, "ini", next(iter(_ini(place)), "")),
        "enabling": place.record("enable"),
    }


def _ini(place: Place) -> list[str]:
    return [name for name in place.record("try").read if name.endswith(".ini")]


def _table(place: Place, name: str) -> tuple[list[str], list[list[str]], int]:
    """Return header, first rows and number of rows of a table of the dry run."""
    if not place.has(name) or place.record("try").code is None:
        return [], [], 0
    with place.path(name).open(encoding="utf-8", newline="") as file:
        rows = csv.reader(file)
        header, first = next(rows, []), list(islice(rows, SHOWN))
        return header, first, len(first) + sum(1 for _ in rows)


def is_tried(place: Place) -> bool:
    """Whether the dry run has succeeded; an enabled target counts as tried."""
    enabled = _kind(place) in CONTROLS and _is_enabled(place)
    return place.is_done("try") or (enabled and place.record("try").code == 0)


def do_try(place: Place, given: Given) -> None:
    """Make a dry run; then enable or disable the tried target."""
    service, kind = read_service(place.path(place.existing(SERVICE))), _kind(place)
    if "disable" in given:
        _switch(place, False)
        return
    if "enable" not in given:
        _try(place, given, service, kind)
        return
    if not place.is_done("try"):
        ended_well = place.record("try").code == 0
        others = ", ".join(place.changed_since("try") if ended_well else [])
        why = f"changed since: {others}" if others else "has not ended well"
        raise InputError(f"dry run: {why}; try again")
    if "read" not in given:
        raise InputError("enable: tick that you have read what will be written")
    if kind == LINUXCNC:
        place.jobs.start("enable", [*_linuxcnc(place, service, _ini(place)[0]), "--write"])
        return
    _switch(place, True)


def _try(place: Place, given: Given, service: Service, kind: str) -> None:
    commands = [_compensate()]
    if kind in CONTROLS:
        commands.append(["target", TARGET, "--offsets=offsets.csv", "--out=writes.csv"])
    if kind == LINUXCNC:
        ini = chosen(given, "ini", place.files(".ini"), "the control's ini file")
        _make_cnc_token(place, service)
        commands.append(_linuxcnc(place, service, ini))
    commands.append(["serve", SERVICE, "--check"])
    place.run("try", given, *commands)


def _linuxcnc(place: Place, service: Service, ini: str) -> list[str]:
    return ["linuxcnc", SERVICE, ini, f"--machine={_machine(service)}", f"--token={_CNC_TOKEN}"]


def _make_cnc_token(place: Place, service: Service) -> None:
    """Create the token by which the control logs in, unless it exists."""
    if place.has(_CNC_TOKEN):
        return
    service.folder.mkdir(parents=True, exist_ok=True)
    now = time.time()
    with closing(open_access(service.folder)) as store:
        if LINUXCNC in [token.principal.name for token in tokens_in(store)]:
            revoke_token(store, LINUXCNC)
        span = now, now + 86_400.0 * _CNC_DAYS
        made = add_token(store, LINUXCNC, "operator", span, [_machine(service)])
    _keep_secret(place, _CNC_TOKEN, made)


def show_run(place: Place, given: Given) -> dict[str, Any]:
    """Return the content of the page of the running service."""
    service = _service(place)
    http = service.given.http if service else None
    scheme = "https" if http and http.security == "tls" else "http"
    return {
        "process": _process(place, service),
        "log": place.jobs.detached_output("service"),
        "dashboard": f"{scheme}://127.0.0.1:{http.port}" if http else "",
        "token": place.text(_TOKEN).strip(),
        "enabled": _kind(place) in CONTROLS and _is_enabled(place),
        "kind": _kind(place),
        "service": SERVICE,
    }


def _process(place: Place, service: Service | None) -> int | None:
    """Return the process of the service; None if it is not running."""
    own = place.jobs.detached
    # Testing the lock could make a starting service detect another one.
    if own is not None and own.poll() is None:
        return own.pid
    return lock_owner(service.folder) if service is not None else None


def is_running(place: Place) -> bool:
    """Whether the service runs."""
    return _process(place, _service(place)) is not None


def do_run(place: Place, given: Given) -> None:
    """Start the service, stop it, or make it read its files again."""
    service = read_service(place.path(place.existing(SERVICE)))
    process = _process(place, service)
    if "start" in given:
        if process is not None:
            raise InputError(f"service: runs already, as process {process}")
        place.jobs.detach("service", ["serve", SERVICE])
    elif process is None:
        raise InputError("service: does not run")
    else:
        os.kill(process, signal.SIGHUP if "reload" in given else signal.SIGTERM)
        if "stop" in given:
            _await_end(place, service)


def _await_end(place: Place, service: Service) -> None:
    end = time.monotonic() + 10.0
    while _process(place, service) is not None and time.monotonic() < end:
        time.sleep(0.1)
