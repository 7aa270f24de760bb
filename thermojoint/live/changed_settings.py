"""Settings of a service compared with those of its last start, for the audit log."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.settings import toml
from thermojoint.live.settings import Service


def record_settings(service: Service) -> Iterator[str]:
    """Yield every setting that has changed since the last start, and store the present ones.

    Settings of the offsets count as well. Secrets are not included, only their locations.
    """
    path = service.folder / "settings.json"
    now = dict(_flat(_content(service)))
    before: dict[str, Any] = {}
    with suppress(OSError, ValueError):
        before = json.loads(path.read_text("utf-8"))
    for key in sorted(now.keys() | before.keys()) if before else ():
        if now.get(key) != before.get(key):
            yield f"setting {key}: {before.get(key)} -> {now.get(key)}"
    if now != before:
        write_text(path, json.dumps(now, indent=0))


def _content(service: Service) -> dict[str, Any]:
    content = service.given.model_dump(mode="json")
    for name, model in service.given.models.items():
        if model.offsets is not None:
            with suppress(InputError):
                text = toml.read_text(Path(model.offsets), "offsets")
                content["models"][name]["offsets"] = toml.parse(text, str(model.offsets))
    return content


def _flat(content: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", json.loads(json.dumps(value, default=str))
