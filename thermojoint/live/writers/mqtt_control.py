"""Messages of a control by MQTT: enable, heartbeat, acknowledged offsets (the handshake).

``{"enable": true, "heartbeat": 17, "offsets_um": {"X": -12.3}}`` on a topic for each machine. A
retained message is no answer: nobody knows how old it is.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable, Collection

import aiomqtt
from pydantic import BaseModel, ValidationError

from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.handshake import Answer
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
        axes = floor.places[machine].served.layout.controls
        try:
            given = answer_of(message.payload[:_LARGEST], axes)
            written(f"write {message.topic} ({'enable' if given.enabled else 'disable'})", machine)
        except OSError as error:
            text = f"the control's word is refused: the audit log cannot be written ({error})"
            floor.log.say(time.time(), "audit", text, machine)
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


class ControlMessage(BaseModel):
    """Message that a control publishes; further keys are its own."""

    enable: bool
    heartbeat: int
    offsets_um: dict[str, float | None] = {}


def answer_of(payload: bytes, axes: tuple[str, ...]) -> Answer:
    """Return what a control says.

    Raises
    ------
    ValidationError
        It is no answer.
    """
    message = ControlMessage.model_validate_json(payload, strict=True)
    offsets = (message.offsets_um.get(axis) for axis in axes)
    metres = tuple(math.nan if one is None else MICRO * one for one in offsets)
    return Answer(message.enable, message.heartbeat, metres)
