"""Data items of an MTConnect agent, by its stream of observations or by polling.

An agent reports an observation only when a value changes; the value holds until the next
observation, or until it is UNAVAILABLE. The readings are therefore the values held at the instants
of the machine, by the agent's clock. After a disconnection reading continues with the observations
in the agent's buffer after the last one read.
"""

from __future__ import annotations

import asyncio
import math
import time as clock
from collections.abc import (
    AsyncGenerator,
    AsyncIterator,
    Generator,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from contextlib import aclosing
from dataclasses import dataclass
from typing import Any, NamedTuple
from urllib.parse import quote

from thermojoint.artefacts.quantities import Place
from thermojoint.live.arrivals import ABSENT, Arrival, Note
from thermojoint.live.http_session import (
    LOST,
    TIMEOUT_S,
    Address,
    UnusableError,
    address_of,
    parts_of,
    requested,
    whole,
)
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.mtconnect_documents import (
    Devices,
    Observation,
    Refused,
    Streams,
    conversion,
    converted,
    document_of,
)
from thermojoint.live.reconnecting import Attempts, shown
from thermojoint.live.settings import MtconnectSource

#: Number of arrivals that are passed on at once.
_AT_ONCE = 64
#: Largest number of observations in one document.
_MOST = 1000
#: Longest query; instead of a longer one all data items are requested.
_LONGEST = 4000
#: A longer time without any observation or document is a gap, s.
_GAP_S = 3600.0
#: Shortest and longest interval of requested documents, ms.
_SHORTEST_MS, _LONGEST_MS = 10, 10_000


class OverrunError(UnusableError):
    """The agent no longer has the next observation."""


class ItemMapping(NamedTuple):
    """Data items of a device that are the readings of a machine."""

    #: Name or uuid of the device.
    device: str
    #: Names of the readings, and of their data items.
    readings: tuple[str, ...]
    items: tuple[str, ...]
    #: Number of readings, the first ones, whose values are held; further ones are occasional.
    wanted: int
    #: Interval of the instants, s.
    interval: float


class Held(NamedTuple):
    """Held values of a machine, and its position in the source."""

    #: Instance id of the agent.
    instance: int
    #: First observation that is not processed yet.
    next: int
    #: The next arrival is ``number`` intervals after the start, s since 1970.
    start: float
    number: int
    #: Values; NaN for unavailable ones and for occasional readings not delivered.
    values: tuple[float, ...]
    #: Times of their last observations, s since 1970.
    since: tuple[float, ...]

    def due(self, mapping: ItemMapping) -> float:
        """Return the instant of the next arrival, s since 1970."""
        return self.start + mapping.interval * self.number


#: Data item to (machine, reading, conversion).
Places = Mapping[str, Sequence[tuple[str, int, Place]]]


@dataclass(frozen=True, eq=False)
class MtconnectReader:
    """All machines of one agent."""

    url: str
    address: Address
    mappings: Mapping[str, ItemMapping]
    #: Longest time for which a value may stay without a new observation, s.
    unchanged: float
    #: Documents further in the future are refused, s.
    ahead: float

    @property
    def machines(self) -> Sequence[str]:
        """Machines of the source."""
        return tuple(self.mappings)

    async def read(self, positions: Mapping[str, Any]) -> AsyncIterator[list[Arrival | Note]]:
        """Yield readings until cancelled; reconnect whenever the connection is lost."""
        held = {
            machine: found
            for machine, mapping in self.mappings.items()
            if (found := held_of(positions.get(machine), mapping))
        }
        async for attempt in Attempts():
            try:
                async with aclosing(self._connected(held)) as blocks:
                    async for block in blocks:
                        attempt.succeeded()
                        yield block
            except OverrunError as error:
                held = {machine: one._replace(instance=-1) for machine, one in held.items()}
                yield [Note("overrun", f"MTConnect {self.url}: {error}; read on from now")]
            except LOST as error:
                yield [Note("disconnected", f"MTConnect {self.url}: {shown(error)}")]

    async def _connected(self, held: dict[str, Held]) -> AsyncGenerator[list[Arrival | Note], None]:
        """Yield the readings of one connection; `held` is updated."""
        devices = await self._get("/probe", ())
        if not isinstance(devices, Devices):
            raise UnusableError("the agent tells no devices")
        places, notes = places_of(self.mappings, devices)
        if not places:
            raise UnusableError("; ".join(note.text for note in notes)[:200])
        yield [*notes, Note("connected", f"MTConnect {self.url}")]
        ids = " or ".join(f'@id="{item}"' for item in sorted(places))
        path = f"path={quote(f'//DataItem[{ids}]')}"
        query = path if len(path) <= _LONGEST else ""
        instance = devices.header.instance
        if {one.instance for one in held.values()} != {instance} or set(held) != set(self.mappings):
            streams = _checked_streams(await self._get(f"/current?{query}", places), instance)
            for machine, some in by_machine(streams, places, self.mappings).items():
                held[machine] = initial_values(self.mappings[machine], held.get(machine), some)
            for block in self._blocks(held, places, streams._replace(observations=())):
                yield block
        count = min(devices.header.size or 100, _MOST)
        first = min(one.next for one in held.values())
        async with aclosing(self._documents(f"{query}&count={count}", first, places)) as documents:
            async for document in documents:
                streams = _checked_streams(document, instance)
                if streams.faults:
                    yield [Note("malformed", fault) for fault in streams.faults[:_AT_ONCE]]
                for block in self._blocks(held, places, streams):
                    yield block

    def _blocks(
        self, held: dict[str, Held], places: Places, streams: Streams
    ) -> Iterator[list[Arrival | Note]]:
        """Yield the arrivals of a document; `held` is updated."""
        created, now = streams.header.created, clock.time()
        for machine, found in by_machine(streams, places, self.mappings).items():
            mapping, before = self.mappings[machine], held[machine]
            if before.number == 0 and created < before.start:
                # No arrival has used these instants yet: they may begin earlier.
                before = before._replace(start=created)
            due = before.due(mapping)
            if created > now + self.ahead or created < due - 2.0 * mapping.interval:
                # The agent's clock was set: the common rules refuse this time with a message.
                held[machine] = with_observations(mapping, before, found, due)
                yield [arrival_of(machine, mapping, held[machine], created, self.unchanged)]
                continue
            block: list[Arrival | Note] = []
            for after, instant in at_instants(mapping, before, found):
                if instant is None:
                    held[machine] = after
                else:
                    block.append(arrival_of(machine, mapping, after, instant, self.unchanged))
                if len(block) == _AT_ONCE:
                    yield block
                    block = []
            if block:
                yield block

    async def _get(self, target: str, places: Places | tuple[()]) -> Devices | Streams | Refused:
        async with requested(self.address, target, TIMEOUT_S) as response:
            content = await whole(response)
            if response.status != 200 and not content.lstrip().startswith(b"<"):
                raise UnusableError(f"HTTP status {response.status}")
        return document_of(content, places)

    async def _documents(
        self, query: str, first: int, places: Places
    ) -> AsyncGenerator[Devices | Streams | Refused, None]:
        """Yield documents from an observation on, by a stream or by one request each."""
        seconds = min(mapping.interval for mapping in self.mappings.values())
        interval = round(min(max(1000.0 * seconds, _SHORTEST_MS), _LONGEST_MS))
        silence = TIMEOUT_S + 2e-3 * interval
        while True:
            asked = f"/sample?{query}&from={first}&interval={interval}&heartbeat={interval}"
            async with requested(self.address, asked, silence) as response:
                if response.kind.get_content_maintype() == "multipart":
                    async for part in parts_of(response):
                        yield document_of(part, places)
                    raise UnusableError("the agent has ended the stream")
                document = document_of(await whole(response), places)
            yield document
            if isinstance(document, Streams):
                first = document.header.next
            await asyncio.sleep(1e-3 * interval)


def places_of(
    mappings: Mapping[str, ItemMapping], devices: Devices
) -> tuple[dict[str, list[tuple[str, int, Place]]], list[Note]]:
    """Return the readings that belong to each data item, and notes of missing data items."""
    places: dict[str, list[tuple[str, int, Place]]] = {}
    notes = []
    for machine, one in mappings.items():
        items = devices.devices.get(one.device)
        if items is None:
            notes.append(Note("unreadable", f"the agent has no device {one.device}", machine))
            continue
        for k, (reading, name) in enumerate(zip(one.readings, one.items, strict=True)):
            if name == ABSENT:
                continue
            if name not in items:
                text = f"device {one.device} has no data item {name}"
                notes.append(Note("unreadable", text, machine))
                continue
            try:
                place = conversion(items[name], reading)
            except UnusableError as error:
                notes.append(Note("unreadable", str(error), machine))
                continue
            places.setdefault(items[name].ident, []).append((machine, k, place))
    return places, notes


def _checked_streams(document: Devices | Streams | Refused, instance: int) -> Streams:
    if isinstance(document, Refused):
        kind = OverrunError if "OUT_OF_RANGE" in document.codes else UnusableError
        raise kind(document.text or "refused")
    if not isinstance(document, Streams):
        raise UnusableError("the agent tells no observations")
    if document.header.instance != instance:
        raise UnusableError("the agent has started anew")
    return document


def by_machine(streams: Streams, places: Places, machines: Iterable[str]) -> dict[str, Streams]:
    """Return a document for each machine: its observations by reading, in the reading's unit."""
    found: dict[str, list[Observation]] = {machine: [] for machine in machines}
    for one in streams.observations:
        for machine, k, place in places[one.item]:
            value = converted(place, one.value)
            found[machine].append(one._replace(item=str(k), value=value))
    return {machine: streams._replace(observations=tuple(some)) for machine, some in found.items()}


def initial_values(mapping: ItemMapping, before: Held | None, streams: Streams) -> Held:
    """Return the held values after a document of all current observations.

    Instants continue earlier ones, if any, because the estimator's instants keep their phase.
    """
    header, count = streams.header, len(mapping.readings)
    start, number = header.created, 0
    if before is not None:
        start = before.start
        number = max(before.number, math.ceil((header.created - start) / mapping.interval))
    nothing = (math.nan,) * count
    held = Held(header.instance, 0, start, number, nothing, (header.created,) * count)
    for one in streams.observations:
        held = _with_observation(held, one, min(one.time, header.created))
    return held._replace(next=header.next, values=_still_held(held.values, mapping.wanted))


def with_observations(mapping: ItemMapping, held: Held, streams: Streams, since: float) -> Held:
    """Return the held values after all observations of a document."""
    for one in streams.observations:
        if one.sequence >= held.next:
            held = _with_observation(held, one, since)
    return held._replace(
        next=max(held.next, streams.header.next), values=_still_held(held.values, mapping.wanted)
    )


def at_instants(
    mapping: ItemMapping, held: Held, streams: Streams
) -> Iterator[tuple[Held, float | None]]:
    """Yield the held values with each instant of a document, and finally without an instant.

    Observations count from the first instant at or after their time, which is at most the time of
    the document: with an adapter whose clock is ahead they count on arrival.
    """
    header = streams.header
    for one in streams.observations:
        if one.sequence < held.next:
            continue
        time = min(one.time, header.created)
        held = _skip_gap(mapping, held, time)
        while held.due(mapping) < time:
            held = yield from _instant(mapping, held)
        held = _with_observation(held, one, held.due(mapping))._replace(next=one.sequence + 1)
    held = held._replace(next=max(held.next, header.next))
    if header.next > header.last:
        held = _skip_gap(mapping, held, header.created)
        while held.due(mapping) <= header.created:
            held = yield from _instant(mapping, held)
    yield held, None


def _skip_gap(mapping: ItemMapping, held: Held, time: float) -> Held:
    """Skip the instants of a gap before a time."""
    late = time - held.due(mapping)
    if late <= _GAP_S:
        return held
    return held._replace(number=held.number + math.floor(late / mapping.interval))


def _instant(mapping: ItemMapping, held: Held) -> Generator[tuple[Held, float], None, Held]:
    """Yield one instant; return the held values after it."""
    after = held._replace(number=held.number + 1)
    yield after, held.due(mapping)
    return after._replace(values=_still_held(after.values, mapping.wanted))


def _with_observation(held: Held, one: Observation, since: float) -> Held:
    k = int(one.item)
    return held._replace(
        values=(*held.values[:k], one.value, *held.values[k + 1 :]),
        since=(*held.since[:k], since, *held.since[k + 1 :]),
    )


def _still_held(values: tuple[float, ...], wanted: int) -> tuple[float, ...]:
    """Return the values that are held further; an occasional one counts once."""
    return (*values[:wanted], *(math.nan for _ in values[wanted:]))


def arrival_of(
    machine: str, mapping: ItemMapping, held: Held, instant: float, unchanged: float
) -> Arrival:
    """Return the arrival of the values held at an instant."""
    readings: list[float | None] = [
        value if instant - since <= unchanged else math.nan
        for value, since in zip(held.values[: mapping.wanted], held.since, strict=False)
    ]
    readings += [None if math.isnan(value) else value for value in held.values[mapping.wanted :]]
    still_held = _still_held(held.values, mapping.wanted)
    items = [
        [*names, None if math.isnan(value) else value, since]
        for *names, value, since in zip(
            mapping.readings, mapping.items, still_held, held.since, strict=True
        )
    ]
    position = [mapping.device, held.instance, held.next, held.due(mapping), items]
    return Arrival(machine, instant, readings, clock.time(), position)


def held_of(position: Any, mapping: ItemMapping) -> Held | None:  # noqa: ANN401
    """Return the held values of a position; None if it is of another source or other readings."""
    try:
        device, instance, following, due, items = position
        readings, names, values, since = zip(*items, strict=True)
        values = tuple(math.nan if value is None else float(value) for value in values)
        since = tuple(map(float, since))
    except (TypeError, ValueError):
        return None
    if (device, readings, names) != (mapping.device, mapping.readings, mapping.items):
        return None
    return Held(int(instance), int(following), float(due), 0, values, since)


def mtconnect_reader(
    source: MtconnectSource,
    ahead: float,
    names: Mapping[str, tuple[str, ...]],
    models: Mapping[str, LoadedModel],
) -> MtconnectReader:
    """Return the reader of a source; raises as `address_of`."""
    mappings = {
        machine: ItemMapping(
            source.device.replace("{machine}", machine),
            models[machine].intake.names,
            called,
            models[machine].intake.wanted,
            models[machine].rule.interval,
        )
        for machine, called in names.items()
    }
    address = address_of(source.url, source.ca_file, "source")
    unchanged = math.inf if source.unchanged_s is None else source.unchanged_s
    return MtconnectReader(source.url, address, mappings, unchanged, ahead)
