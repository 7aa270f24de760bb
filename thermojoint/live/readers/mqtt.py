"""Messages of an MQTT broker: a JSON object with the readings of a machine at one time.

``{"time": "2026-03-02T06:00:01Z", "T1_degC": 24.31, "T2_degC": null}``; or, on a topic for each
reading, ``{"time": 1772431201.0, "value": 24.31}``. The broker keeps the session (QoS 1), and a
message is acknowledged when its sample is stored: messages sent while the service was down arrive
later.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
import time as clock
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import aiomqtt

from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.mqtt_session import Address, acknowledge, address_of, connected, lost
from thermojoint.live.readers.session import background_session
from thermojoint.live.reconnecting import Attempts
from thermojoint.live.settings import MqttSource
from thermojoint.live.times import seconds_of

#: Number of messages that are passed on at once.
_AT_ONCE = 64


@dataclass(frozen=True)
class Topics:
    """Names that a source uses."""

    #: Pattern of a topic, with optional groups ``machine`` and ``reading``.
    pattern: re.Pattern[str]
    #: Topic filter of the subscription.
    filter: str
    #: Names of each machine's readings in the messages.
    names: Mapping[str, tuple[str, ...]]
    #: Longest message, bytes.
    largest: int


@dataclass(eq=False)
class MqttReader:
    """All machines of one broker."""

    address: Address
    topics: Topics
    #: Largest number of queued messages.
    most_waiting: int
    _queue: deque[Arrival | Note] = field(default_factory=deque)
    _received: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def machines(self) -> Sequence[str]:
        """Machines of the source."""
        return tuple(self.topics.names)

    async def read(self, positions: Mapping[str, Any]) -> AsyncIterator[list[Arrival | Note]]:
        """Yield messages until cancelled; reconnect whenever the connection is lost."""
        async with background_session(self._stay_connected(), self._received) as next_arrival:
            while True:
                await next_arrival()
                while self._queue:
                    count = min(len(self._queue), _AT_ONCE)
                    yield [self._queue.popleft() for _ in range(count)]

    async def _stay_connected(self) -> None:
        where = f"{self.address.host}:{self.address.port}"
        async for attempt in Attempts():
            client: list[aiomqtt.Client] = []
            try:
                async with connected(
                    self.address, "reads", on_message=partial(self._receive, client)
                ) as session:
                    client.append(session)
                    await session.subscribe(self.topics.filter, qos=1)
                    self._enqueue(Note("connected", f"MQTT broker {where}"))
                    attempt.succeeded()
                    await lost(session)
            except aiomqtt.MqttError as error:
                self._enqueue(Note("disconnected", f"MQTT broker {where}: {error}"))

    def _receive(self, client: Sequence[aiomqtt.Client], message: Any) -> None:  # noqa: ANN401
        """Queue one message; called by the client."""
        confirm = partial(_acknowledged, client, message) if message.qos else None
        if len(self._queue) >= self.most_waiting:
            # Not acknowledged: the broker sends it again after the next connection.
            return
        item = item_of(self.topics, message.topic, message.payload, confirm)
        if isinstance(item, Note) and confirm:
            confirm()
        self._enqueue(item)

    def _enqueue(self, item: Arrival | Note) -> None:
        self._queue.append(item)
        self._received.set()


def _acknowledged(client: Sequence[aiomqtt.Client], message: Any) -> None:  # noqa: ANN401
    for session in client:
        acknowledge(session, message)


def item_of(
    topics: Topics, topic: str, payload: bytes, confirm: Callable[[], None] | None = None
) -> Arrival | Note:
    """Return the readings of one message, or a note of its fault."""
    received_at = clock.time()
    match = topics.pattern.fullmatch(topic)
    # A topic without a machine's name belongs to the only machine.
    words = match.groupdict() if match else {}
    machine = words.get("machine", next(iter(topics.names)))
    names = topics.names.get(machine)
    if match is None or names is None:
        return Note("malformed", f"topic {topic[:100]!r} names no machine of this source")
    if len(payload) > topics.largest:
        return Note("malformed", f"a message of {len(payload)} bytes", machine)
    try:
        content = json.loads(payload)
        time = _time(content["time"])
        readings = _readings(content, names, words.get("reading"))
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        return Note("malformed", f"a message has no readings: {_short(error)}", machine)
    return Arrival(machine, time, readings, received_at, acknowledge=confirm)


def _short(error: Exception) -> str:
    kind = "no key " if isinstance(error, KeyError) else ""
    return f"{kind}{str(error)[:100]}"


def _time(value: Any) -> float:  # noqa: ANN401
    if isinstance(value, str):
        return seconds_of(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("the time is neither a number of seconds nor text")
    return float(value)


def _readings(
    content: Mapping[str, Any], names: Sequence[str], reading: str | None
) -> list[float | None]:
    if reading is not None:
        if reading not in names:
            raise ValueError(f"no reading is called {reading[:50]!r}")
        value = _value(content["value"])
        return [value if name == reading else None for name in names]
    if not any(name in content for name in names):
        raise ValueError(f"none of {', '.join(names)[:80]}")
    return [_value(content[name]) if name in content else None for name in names]


def _value(value: Any) -> float:  # noqa: ANN401
    """Return a reading; null stands for a missing one."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("a reading is not a number")
    number = float(value)
    return number if math.isfinite(number) else math.nan


def mqtt_reader(source: MqttSource, names: Mapping[str, tuple[str, ...]]) -> MqttReader:
    """Return the reader of a source; raises as `address_of`."""
    return MqttReader(address_of(source, "source"), topics_of(source, names), source.most_waiting)


def topics_of(source: MqttSource, names: Mapping[str, tuple[str, ...]]) -> Topics:
    """Return the topics of a source."""
    pattern = re.escape(source.topic)
    for name in ("machine", "reading"):
        # Where a name stands again it is the same.
        first, *again = pattern.split(re.escape(f"{{{name}}}"))
        rest = f"(?P={name})".join(again)
        pattern = f"{first}(?P<{name}>[^/+#]+){rest}" if again else first
    # A level with a placeholder matches any level.
    levels = ("+" if "{" in level else level for level in source.topic.split("/"))
    return Topics(re.compile(pattern), "/".join(levels), dict(names), source.largest_message)
