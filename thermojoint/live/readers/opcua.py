"""Variables of an OPC UA server by subscription, and by its history after a disconnection.

Every sampled value comes with the source's time and status; a bad value is a missing reading.
Values from the time without a connection are read from the server's history, if it has one.
"""

from __future__ import annotations

import asyncio
import math
import time as clock
from collections import deque
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from asyncua import Client, ua
from asyncua.common.node import Node

from thermojoint.artefacts.errors import InputError
from thermojoint.live.arrivals import ABSENT, Arrival, Note
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.opcua_session import LOST, TIMEOUT_S, Endpoint, client_of, endpoint_of
from thermojoint.live.readers.session import background_session
from thermojoint.live.reconnecting import Attempts, shown
from thermojoint.live.settings import OpcuaSource, Service
from thermojoint.live.times import since_1970

#: Interval of the requests that check the connection, s.
_ALIVE_S = 5.0
#: Number of arrivals that are passed on at once.
_AT_ONCE = 64
#: Largest number of values of one variable read from a history.
_MOST_HISTORY = 100_000
#: Number of variables in one request.
_AT_A_TIME = 500
#: A server may store its history late: until the history contains the present value, it is read
#: again at this interval, s, for at most this time, s.
_AGAIN_S, _LATE_S = 0.1, 3.0
#: Largest number of values of one variable that the server queues between two publications.
_QUEUE = 1000


#: A machine, and which of its readings a variable is.
Place = tuple[str, tuple[int, ...]]


@dataclass(eq=False)
class OpcuaReader:
    """All machines of one server."""

    endpoint: Endpoint
    #: Node id to a machine and its readings; usually one.
    nodes: Mapping[str, Place]
    #: Readings of each machine.
    counts: Mapping[str, int]
    #: Largest number of queued values.
    most_waiting: int
    #: Interval of the server's publications.
    publishing_ms: float
    _queue: deque[Arrival | Note] = field(default_factory=deque)
    _received: asyncio.Event = field(default_factory=asyncio.Event)
    _newest: dict[Place, float] = field(default_factory=dict)

    @property
    def machines(self) -> Sequence[str]:
        """Machines of the source."""
        return tuple(self.counts)

    async def read(self, positions: Mapping[str, Any]) -> AsyncIterator[list[Arrival | Note]]:
        """Yield values until cancelled; reconnect whenever the connection is lost."""
        # Per variable: a connection may be lost between the values of one instant.
        self._newest = {
            place: float(at)
            for place in self.nodes.values()
            if isinstance(at := positions.get(place[0]), int | float)
        }
        async with background_session(self._stay_connected(), self._received) as next_arrival:
            while True:
                await next_arrival()
                arrivals = in_order(self._queue)
                self._queue.clear()
                for k in range(0, len(arrivals), _AT_ONCE):
                    yield arrivals[k : k + _AT_ONCE]

    async def _stay_connected(self) -> None:
        async for attempt in Attempts():
            try:
                async with await client_of(self.endpoint) as client:
                    attempt.succeeded()
                    await self._listen(client)
            except LOST as error:
                self._enqueue(Note("disconnected", f"OPC UA {self.endpoint.url}: {shown(error)}"))

    async def _listen(self, client: Client) -> None:
        """Subscribe, read the missed values, and wait until server or subscription has ended."""
        nodes = [client.get_node(name) for name in self.nodes]
        places = dict(zip((node.nodeid for node in nodes), self.nodes.values(), strict=True))
        missed: list[tuple[ua.NodeId, ua.DataValue]] = []
        handler = _Handler(missed)
        subscription = await client.create_subscription(self.publishing_ms, handler)
        for k in range(0, len(nodes), _AT_A_TIME):
            some = nodes[k : k + _AT_A_TIME]
            items = [_item(node, k + n + 1) for n, node in enumerate(some)]
            results = await subscription.create_monitored_items(items)
            for node, result in zip(some, results, strict=True):
                if isinstance(result, ua.StatusCode):
                    machine, _ = places[node.nodeid]
                    self._enqueue(
                        Note("unreadable", f"{node.nodeid.to_string()}: {result.name}", machine)
                    )
        self._enqueue(Note("connected", f"OPC UA {self.endpoint.url}"))
        stored = await self._missed_values(client, nodes, places)
        for nodeid, value in sorted(stored, key=lambda item: _time(item[1])):
            self._receive(places, nodeid, value)
        # Then the values that have arrived meanwhile.
        for nodeid, value in missed:
            self._receive(places, nodeid, value)
        handler.take = lambda nodeid, value: self._receive(places, nodeid, value)
        while True:
            await asyncio.sleep(_ALIVE_S)
            async with asyncio.timeout(TIMEOUT_S):
                # A server may end a subscription alone: after a pause of this computer, for one.
                (status,) = await subscription.set_publishing_mode(True)
                status.check()

    async def _missed_values(
        self, client: Client, nodes: Sequence[Node], places: Mapping[ua.NodeId, Place]
    ) -> list[tuple[ua.NodeId, ua.DataValue]]:
        """Return the history of every variable since its last reading, up to its present value."""
        # Newer values arrive by the subscription.
        present: dict[ua.NodeId, float] = {}
        for k in range(0, len(nodes), _AT_A_TIME):
            some = nodes[k : k + _AT_A_TIME]
            values = await client.read_attributes(some)
            present |= {node.nodeid: _time(one) for node, one in zip(some, values, strict=True)}
        since = {
            node: self._newest[place]
            for node in nodes
            if (place := places[node.nodeid]) in self._newest
        }
        wanted = [node for node in since if not present[node.nodeid] <= since[node]]
        found: dict[ua.NodeId, list[ua.DataValue]] = {}
        end = clock.monotonic() + _LATE_S
        while wanted:
            late, more = [], False
            for node in wanted:
                try:
                    values = await node.read_raw_history(
                        datetime.fromtimestamp(since[node], UTC), None, numvalues=_MOST_HISTORY
                    )
                except ua.UaStatusCodeError:
                    continue  # The server has no history of it.
                later = [one for one in values if _time(one) > since[node]]
                found.setdefault(node.nodeid, []).extend(later)
                since[node] = max(map(_time, later), default=since[node])
                if since[node] < present[node.nodeid]:
                    late.append(node)
                    more |= bool(later)
            # The rest follows or is stored soon: the server limits the values per response.
            wanted = late if more or clock.monotonic() < end else []
            await asyncio.sleep(_AGAIN_S if wanted and not more else 0.0)
        return [(nodeid, value) for nodeid, values in found.items() for value in values]

    def _receive(
        self, places: Mapping[ua.NodeId, Place], nodeid: ua.NodeId, value: ua.DataValue
    ) -> None:
        place = machine, which = places[nodeid]
        item = item_of(machine, which, self.counts[machine], value)
        if isinstance(item, Arrival):
            # Not the latest time: one far in the future would leave out what is missed later.
            self._newest[place] = item.time
        else:
            item = replace(item, text=f"{nodeid.to_string()}: {item.text}")
        if len(self._queue) < self.most_waiting:
            self._enqueue(item)

    def _enqueue(self, item: Arrival | Note) -> None:
        self._queue.append(item)
        self._received.set()


def in_order(items: Iterable[Arrival | Note]) -> list[Arrival | Note]:
    """Return values in the order of time; values of one machine and time become one arrival.

    A server sends all values of one variable, then all of the next; of two at one time the last
    counts.
    """
    ordered: list[Arrival | Note] = []
    merged: dict[tuple[str, float], Arrival] = {}
    for item in items:
        if isinstance(item, Note):
            ordered.append(item)
            continue
        key = item.machine, item.time
        before = merged.get(key)
        merged[key] = (
            item
            if before is None
            else replace(before, readings=_merged(before.readings, item.readings))
        )
    return [*ordered, *sorted(merged.values(), key=lambda arrival: arrival.time)]


def _merged(first: Sequence[float | None], second: Sequence[float | None]) -> list[float | None]:
    return [a if b is None else b for a, b in zip(first, second, strict=True)]


class _Handler:
    """Callbacks of a subscription; values are collected until `take` is replaced."""

    def __init__(self, aside: list[tuple[ua.NodeId, ua.DataValue]]) -> None:
        self.take = lambda nodeid, value: aside.append((nodeid, value))

    def datachange_notification(self, node: Node, val: Any, data: Any) -> None:  # noqa: ANN401
        """Receive one value."""
        self.take(node.nodeid, data.monitored_item.Value)


def _item(node: Node, handle: int) -> ua.MonitoredItemCreateRequest:
    """Return a request for every sampled value, even if only its time has changed."""
    return ua.MonitoredItemCreateRequest(
        ItemToMonitor=ua.ReadValueId(NodeId=node.nodeid, AttributeId=ua.AttributeIds.Value),
        MonitoringMode=ua.MonitoringMode.Reporting,
        RequestedParameters=ua.MonitoringParameters(
            ClientHandle=handle,
            SamplingInterval=0.0,
            Filter=ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp),
            QueueSize=_QUEUE,
            DiscardOldest=True,
        ),
    )


def _time(value: ua.DataValue) -> float:
    stamp = value.SourceTimestamp or value.ServerTimestamp
    return math.nan if stamp is None else since_1970(stamp)


def item_of(machine: str, which: Sequence[int], count: int, value: ua.DataValue) -> Arrival | Note:
    """Return one value as an arrival, or a note of its fault.

    `which` are the indices of the readings that the value is, of the `count` readings of the
    machine.
    """
    content = value.Value.Value if value.Value is not None else None
    code = value.StatusCode
    if content is None or (code is not None and code.is_bad()):
        reading = math.nan
    elif isinstance(content, bool) or not isinstance(content, int | float):
        return Note("malformed", f"a {type(content).__name__} is not a number", machine)
    else:
        reading = float(content) if math.isfinite(content) else math.nan
    readings = [reading if k in which else None for k in range(count)]
    try:
        at = _time(value)
    except (ValueError, OverflowError):
        at = math.nan
    if not math.isfinite(at):
        return Note("malformed", "a value without a time", machine)
    return Arrival(machine, at, readings, clock.time(), position=at)


def opcua_reader(
    service: Service,
    source: OpcuaSource,
    names: Mapping[str, tuple[str, ...]],
    models: Mapping[str, LoadedModel],
) -> OpcuaReader:
    """Return the reader of a source.

    Raises
    ------
    InputError
        A node id is malformed, a reading is occasional, or the server's certificate or a secret
        cannot be used.
    """
    nodes: dict[str, Place] = {}
    for machine, called in names.items():
        wanted = models[machine].intake.wanted
        for name in set(called[wanted:]) - {ABSENT}:
            raise InputError(
                f"source.columns: {name!r} is a displacement, which is not read: a variable of "
                f"OPC UA repeats it; leave it out, and let the control write it in {machine}.Probe"
            )
        for k, name in enumerate(called[:wanted]):
            node = source.node.replace("{machine}", machine).replace("{reading}", name)
            # Several readings may be one variable: a thermometer that is also another's reference.
            nodes[node] = (machine, (*nodes.get(node, (machine, ()))[1], k))
    for name in nodes:
        try:
            ua.NodeId.from_string(name)
        except ua.UaError as error:
            raise InputError(f"source.node: {name!r} is not a node id; give ns=2;s=NAME") from error
    endpoint = endpoint_of(source, service.folder, "source")
    counts = {machine: len(called) for machine, called in names.items()}
    return OpcuaReader(endpoint, nodes, counts, source.most_waiting, source.publishing_ms)
