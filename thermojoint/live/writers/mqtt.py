"""Publications as retained topics of an MQTT broker, with a last will."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Collection, Coroutine
from contextlib import suppress
from functools import partial
from typing import Any

import aiomqtt

from thermojoint.live.audit import Audit
from thermojoint.live.cancelling import cancelled
from thermojoint.live.mqtt_session import Address, connected, is_behind, lost, publish
from thermojoint.live.processing import Fleet
from thermojoint.live.publication import as_json
from thermojoint.live.publisher import Publisher
from thermojoint.live.reconnecting import Attempts
from thermojoint.live.settings import MqttTopics
from thermojoint.live.writers.mqtt_control import publish_heartbeat, receive_answers

#: Pause before the next machine if the network is slow, s.
_PAUSE_S = 0.01
#: Number of machines published in a row.
_AT_ONCE = 64


async def write_topics(
    publisher: Publisher,
    address: Address,
    topics: MqttTopics,
    fleet: Fleet,
    controls: Collection[str],
    audit: Audit,
) -> None:
    """Publish new samples of every machine until cancelled; the newest of each is retained.

    The machines `controls` have controls that answer by MQTT. `audit` records these answers,
    without users: a broker does not identify the publisher.
    """
    log, status_topic = fleet.log, topics.status_topic
    where = f"{address.host}:{address.port}"
    record = partial(audit.written, "mqtt", f"mqtt {where}")
    will = aiomqtt.Will(status_topic, _status("gone"), qos=1, retain=True)
    async for attempt in Attempts():
        try:
            async with connected(address, "writes", will=will) as client:
                log.say(time.time(), "connected", f"MQTT broker {where}, to publish")
                await client.publish(status_topic, _status("running"), qos=1, retain=True)
                attempt.succeeded()
                watch = asyncio.create_task(
                    _first_to_end(
                        lost(client),
                        receive_answers(client, topics.control_topic, fleet, controls, record),
                        publish_heartbeat(client, topics.heartbeat_topic, publisher),
                    )
                )
                try:
                    await _publish(publisher, client, topics.topic, watch)
                finally:
                    await cancelled(watch)
                    await _publish_stopped(client, status_topic)
        except aiomqtt.MqttError as error:
            log.say(time.time(), "disconnected", f"MQTT broker {where}, to publish: {error}")


async def _publish(
    publisher: Publisher, client: aiomqtt.Client, topic: str, watch: asyncio.Task[None]
) -> None:
    """Publish until the connection is lost."""
    with publisher.subscribe() as subscription:
        while True:
            news = asyncio.ensure_future(subscription.wait())
            try:
                await asyncio.wait({news, watch}, return_when=asyncio.FIRST_COMPLETED)
            finally:
                news.cancel()  # without effect once there is news
            if watch.done():
                await watch
            for k, machine in enumerate(sorted(await news)):
                content = json.dumps(as_json(publisher.newest[machine]), allow_nan=False)
                publish(client, topic.replace("{machine}", machine), content.encode())
                if (k + 1) % _AT_ONCE == 0:
                    while is_behind(client) and not watch.done():
                        await asyncio.sleep(_PAUSE_S)


async def _first_to_end(*endless: Coroutine[Any, Any, None]) -> None:
    """Run endless coroutines; raise the error of the first that ends."""
    tasks = [asyncio.ensure_future(one) for one in endless]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        results = await cancelled(*tasks)
    for error in results:
        if isinstance(error, Exception):
            raise error


async def _publish_stopped(client: aiomqtt.Client, status_topic: str) -> None:
    with suppress(aiomqtt.MqttError):
        await client.publish(status_topic, _status("stopped"), qos=1, retain=True, timeout=1.0)


def _status(state: str) -> str:
    return json.dumps({"state": state})
