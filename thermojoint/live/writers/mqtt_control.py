"""Messages of a control by MQTT (`thermojoint.live.control_message`), on a topic for each machine.

A retained message is no answer: nobody knows how old it is.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Collection

import aiomqtt
from pydantic import ValidationError

from thermojoint.live.control_message import answer_of
from thermojoint.live.floor import Floor, answer
from thermojoint.live.hub import Hub

#: Between two looks at the service's heartbeat, s.
_BEAT_S = 0.5
#: No answer is larger, bytes.
_LARGEST = 16_384

#: Records what was written, and on which machine.
Written = Callable[[str, str], None]


async def attend(
    client: aiomqtt.Client, pattern: str, floor: Floor, names: Collection[str], written: Written
) -> None:
    """Take what the controls of some machines publish, until the connection is lost.

    Parameters
    ----------
    client : aiomqtt.Client
    pattern : str
        Of the topics, with ``{machine}`` where the name stands.
    floor : Floor
    names : collection of str
        Of the machines.
    written : callable
        Records what was published, on which machine; an OSError refuses it.
    """
    machines = {pattern.replace("{machine}", name): name for name in names}
    for topic in machines:
        await client.subscribe(topic, qos=0)
    async for message in client.messages:
        machine = machines.get(str(message.topic))
        if machine is None or message.retain:
            continue
        layout = floor.places[machine].served.layout
        try:
            given = answer_of(message.payload[:_LARGEST], layout)
            written(f"write {message.topic} ({'enable' if given.enabled else 'disable'})", machine)
        except ValidationError as error:
            text = f"what the control says is no answer: {error.errors()[0]['msg']}"
            floor.log.say(time.time(), "malformed", text, machine)
        else:
            answer(floor, machine, given, time.monotonic())


async def beat(client: aiomqtt.Client, topic: str, hub: Hub) -> None:
    """Publish the service's heartbeat whenever it has changed, until the connection is lost."""
    sent = -1
    while True:
        if hub.heartbeat != sent:
            sent = hub.heartbeat
            await client.publish(topic, json.dumps({"heartbeat": sent}), qos=0)
        await asyncio.sleep(_BEAT_S)
