"""The readers of a service, for the sources in its file."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.live.arrivals import ABSENT, Arrival, Note
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.readers.csv_lines import CLOCK, CsvReader
from thermojoint.live.settings import CsvSource, MqttSource, MtconnectSource, OpcuaSource, Service
from thermojoint.live.times import seconds_of


class Reader(Protocol):
    """Reads one or more machines, for as long as the service runs."""

    @property
    def machines(self) -> Sequence[str]:
        """Machines of the reader."""
        ...

    def read(self, positions: Mapping[str, Any]) -> AsyncIterator[list[Arrival | Note]]:
        """Yield arrivals and notes in blocks, from the stored position of each machine's source."""
        ...


def readers_of(service: Service, models: Mapping[str, LoadedModel]) -> list[Reader]:
    """Return the readers of a service.

    Raises
    ------
    InputError
        A column belongs to no reading, or a secret or a certificate is unusable.
    """
    readers: list[Reader] = []
    for name, source in service.given.sources.items():
        fed = {
            machine: models[machine]
            for machine, section in service.machines.items()
            if section.source == name
        }
        if not fed:
            continue
        columns, clock = dict(source.columns), dict[str, str]()
        if isinstance(source, CsvSource) and CLOCK in columns:
            clock[CLOCK] = columns.pop(CLOCK)
        names = {
            machine: source_names(model, columns, f"sources.{name}.columns")
            for machine, model in fed.items()
        }
        if isinstance(source, CsvSource):
            for machine, model in fed.items():
                own = dict(zip(model.intake.names, names[machine], strict=True)) | clock
                readers.append(_csv(source, machine, own, model.intake.wanted))
        elif isinstance(source, MqttSource):
            from thermojoint.live.readers.mqtt import mqtt_reader

            readers.append(mqtt_reader(source, names))
        elif isinstance(source, OpcuaSource):
            from thermojoint.live.readers.opcua import opcua_reader

            readers.append(opcua_reader(service, source, names, fed))
        elif isinstance(source, MtconnectSource):
            from thermojoint.live.readers.mtconnect import mtconnect_reader

            readers.append(mtconnect_reader(source, service.given.ahead_s, names, fed))
    return readers


def source_names(model: LoadedModel, columns: Mapping[str, str], where: str) -> tuple[str, ...]:
    """Return the names of a model's readings in a source.

    Displacement readings are only used if the columns name them: a log that happens to contain the
    displacement must not correct an estimator that will have no such readings in service.

    Raises
    ------
    InputError
        A name is given for something that is not a reading.
    """
    for name in columns:
        if name not in model.intake.names:
            raise unknown_name("reading", name, model.intake.names, where)
    asked = model.intake.names[model.intake.wanted :]
    return tuple(
        columns.get(name, ABSENT if name in asked else name) for name in model.intake.names
    )


def _csv(source: CsvSource, machine: str, names: Mapping[str, str], wanted: int) -> CsvReader:
    starts = 0.0
    if source.starts is not None:
        try:
            starts = seconds_of(source.starts)
        except ValueError as error:
            raise InputError(
                f"starts = {source.starts!r}: no time; write it as 2026-03-02T06:00:00Z"
            ) from error
    path = Path(str(source.path).replace("{machine}", machine))
    return CsvReader(machine, path, names, wanted, starts, source.follow)
