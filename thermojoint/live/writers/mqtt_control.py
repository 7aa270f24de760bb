"""Messages of a control by MQTT (`thermojoint.live.control_message`), on a topic for each machine.

Retained messages are ignored, since their age is unknown.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Collection

import aiomqtt
from pydantic import ValidationError

from thermojoint.live.control_message import answer_of
from thermojoint.live.processing import Fleet, receive_answer
from thermojoint.live.publisher import Publisher

#: Interval at which the service's heartbeat is checked, s.
_HEARTBEAT_S = 0.5
#: Largest answer, bytes.
_LARGEST = 16_384

#: Records a written value and its machine.
Record = Callable[[str, str], None]


async def receive_answers(
    client: aiomqtt.Client, pattern: str, fleet: Fleet, names: Collection[str], record: Record
) -> None:
    """Receive the messages of some machines' controls until the connection is lost.

    The pattern of the topics has ``{machine}`` in place of the name. `record` is called with each
    message and its machine; an OSError refuses the message.
    """
    machines = {pattern.replace("{machine}", name): name for name in names}
    for topic in machines:
        await client.subscribe(topic, qos=0)
    async for message in client.messages:
        machine = machines.get(str(message.topic))
        if machine is None or message.retain:
            continue
        layout = fleet.machines[machine].model.layout
        try:
            given = answer_of(message.payload[:_LARGEST], layout)
            record(f"write {message.topic} ({'enable' if given.enabled else 'disable'})", machine)
        except ValidationError as error:
            text = f"what the control says is no answer: {error.errors()[0]['msg']}"
            fleet.log.say(time.time(), "malformed", text, machine)
        else:
            receive_answer(fleet, machine, given, time.monotonic())


async def publish_heartbeat(client: aiomqtt.Client, topic: str, publisher: Publisher) -> None:
    """Publish the service's heartbeat at every change, until the connection is lost."""
    sent = -1
    while True:
        if publisher.heartbeat != sent:
            sent = publisher.heartbeat
            await client.publish(topic, json.dumps({"heartbeat": sent}), qos=0)
        await asyncio.sleep(_HEARTBEAT_S)
