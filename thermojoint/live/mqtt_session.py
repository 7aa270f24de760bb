"""Connection to an MQTT broker with TLS, user and password; extensions of aiomqtt.

aiomqtt acknowledges a message on arrival and creates a task for each. The service acknowledges a
message when it is stored, and processes a thousand per second. Both need calls to the underlying
paho client, which are confined to this module.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import aiomqtt

from thermojoint.artefacts.errors import InputError
from thermojoint.live.secret import read_secret
from thermojoint.live.settings import MqttAddress

#: Timeout of a response of the broker, and keep-alive interval, s.
TIMEOUT_S, KEEPALIVE_S = 10.0, 15
#: Number of messages that may wait if they are not handled by a callback.
_MOST_WAITING = 1000


@dataclass(frozen=True)
class Address:
    """Connection data of a broker, including secrets; never displayed."""

    host: str
    port: int
    #: None: no TLS.
    context: ssl.SSLContext | None
    user: str | None
    password: str | None
    #: Client name for which the broker keeps messages while it is not connected.
    client_id: str

    def __repr__(self) -> str:
        return f"Address({self.host}:{self.port})"


def address_of(given: MqttAddress, where: str) -> Address:
    """Return the address given by a section.

    Raises
    ------
    InputError
        A secret or the authority's certificate cannot be used.
    """
    context = None
    if given.security == "tls":
        try:
            context = ssl.create_default_context(cafile=given.ca_file)
        except (OSError, ssl.SSLError) as error:
            raise InputError(
                f"{where}.ca_file: {given.ca_file}: no certificate (PEM); give the authority's"
            ) from error
        context.minimum_version = ssl.TLSVersion.TLSv1_2
    elif given.ca_file is not None:
        raise InputError(f'{where}.ca_file: not used without TLS; remove it, or security = "none"')
    password = None
    if given.password is not None:
        password = read_secret(given.password, f"{where}.password")
    return Address(given.host, given.port, context, given.user, password, given.client_id)


@asynccontextmanager
async def connected(
    address: Address,
    suffix: str,
    will: aiomqtt.Will | None = None,
    on_message: Callable[[Any], None] | None = None,
) -> AsyncIterator[aiomqtt.Client]:
    """Give a connected client, whose name ends in a suffix: a reader and a writer are two clients.

    The broker sends `will` if the connection breaks. `on_message` is called with each message,
    which it acknowledges by `acknowledge`; the broker then keeps the session.
    """
    client = aiomqtt.Client(
        address.host,
        address.port,
        username=address.user,
        password=address.password,
        identifier=f"{address.client_id}-{suffix}",
        clean_session=on_message is None,
        tls_context=address.context,
        will=will,
        timeout=TIMEOUT_S,
        keepalive=KEEPALIVE_S,
        max_queued_incoming_messages=_MOST_WAITING,
    )
    paho = client._client
    if on_message is not None:
        paho.manual_ack_set(True)
        paho.on_message = lambda _, __, message: on_message(message)
    async with client:
        yield client


def acknowledge(client: aiomqtt.Client, message: Any) -> None:  # noqa: ANN401
    """Acknowledge a message, so that the broker deletes it."""
    client._client.ack(message.mid, message.qos)


def publish(client: aiomqtt.Client, topic: str, payload: bytes) -> None:
    """Send a retained message (QoS 0) without waiting.

    Raises
    ------
    MqttError
        The connection is gone.
    """
    sent = client._client.publish(topic, payload, qos=0, retain=True)
    if sent.rc != 0:
        raise aiomqtt.MqttError(f"not published ({sent.rc})")


def is_behind(client: aiomqtt.Client) -> bool:
    """Return whether published messages are still waiting for the network."""
    return bool(client._client.want_write())


async def lost(client: aiomqtt.Client) -> None:
    """Wait until the connection is lost, or the broker no longer responds.

    Raises
    ------
    MqttError
        Always, when the connection is lost.
    """
    disconnection = asyncio.shield(client._disconnected)
    while True:
        try:
            async with asyncio.timeout(2.0 * KEEPALIVE_S):
                await asyncio.shield(disconnection)
        except TimeoutError:
            # A response shows that the broker is alive; a timeout is an error.
            await client.unsubscribe("thermojoint/is-anybody-there", timeout=TIMEOUT_S)
            continue
        raise aiomqtt.MqttError("disconnected")
