"""Real parts for the tests of the service: a broker, a machine that tells OPC UA, the service."""

import asyncio
import contextlib
import json
import shutil
import socket
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from asyncua import Client
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.server.address_space import AttributeValue, NodeData
from asyncua.server.internal_server import InternalServer

from estimator.interface import follow
from estimator.registry import open_estimator
from thermojoint.live.archive import Archive
from thermojoint.live.certificates import own_identity
from thermojoint.live.service import run
from thermojoint.live.settings import service_from_data

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")

needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="needs mosquitto")
#: Long for a machine that many share; nothing waits so long when all is well, s.
PATIENCE_S = 60.0

_made_whole = InternalServer.load_standard_address_space
_standard = {}


def _copied(nodes):
    """Nodes of a server of their own; it replaces values and references, and changes none."""
    copies = {}
    for name, node in nodes.items():
        copies[name] = one = NodeData(node.nodeid)
        one.references = list(node.references)
        one.attributes = {k: AttributeValue(v.value) for k, v in node.attributes.items()}
    return copies


async def _load_standard_address_space(server, shelf_file=None):
    """Made once for all servers of a process: six thousand nodes take a second."""
    if not _standard:
        await _made_whole(server, shelf_file)
        _standard.update(_copied(server.aspace._nodes))
    else:
        server.aspace._nodes = _copied(_standard)


InternalServer.load_standard_address_space = _load_standard_address_space


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as one:
        return one.getsockname()[1]


async def until(condition, patience=PATIENCE_S):
    """Wait until something holds; what it is then."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if found := condition():
            return found
        await asyncio.sleep(0.02)
    raise AssertionError("did not come about in time")


@contextlib.asynccontextmanager
async def serving(data, base):
    """The service of a file's content, with all its interfaces open; stopped at the end."""
    stop, ready = asyncio.Event(), asyncio.get_running_loop().create_future()
    task = asyncio.create_task(
        run(service_from_data(data, "test", Path(base)), stop, ready.set_result)
    )
    try:
        await asyncio.wait({task, ready}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        yield ready.result()
    finally:
        stop.set()
        await asyncio.wait_for(task, PATIENCE_S)


def estimated(model, rows):
    """What the estimator in a file says of rows: a time and the temperatures of its machine."""
    estimator = open_estimator(model)
    samples = [(time, a - b, T1 - room, T2 - room) for time, a, b, T1, T2, room in rows]
    found = follow(estimator, samples, estimator.initial_state())
    return np.array([one.displacement for _, one in found])


def history_in(base):
    """All samples of the machine that a service in a folder calls mill."""
    return Archive(base / "state" / "history.sqlite").history("mill", 0.0, 1e11, 10**6)


def events_in(base, kind):
    """Texts of the events of a kind of a service in a folder."""
    archive = Archive(base / "state" / "history.sqlite")
    return [one.text for one in archive.events(None, 0.0, 1e11, 1000) if one.kind == kind]


class Broker:
    """A Mosquitto of its own on the loopback."""

    def __init__(self, folder, *lines):
        self.port = free_port()
        self.folder = Path(folder)
        self.config = self.folder / "mosquitto.conf"
        common = (
            f"listener {self.port} 127.0.0.1",
            "persistence false",
            "max_inflight_messages 0",
            "max_queued_messages 0",
            "set_tcp_nodelay true",
        )
        self.config.write_text("\n".join((*common, *lines)) + "\n")
        self.process = None

    def start(self):
        self.process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self.config)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
                return self
            time.sleep(0.02)
        raise AssertionError("the broker does not answer")

    def stop(self):
        self.process.kill()
        self.process.wait()

    def __enter__(self):
        return self.start()

    def __exit__(self, *_):
        self.stop()


def message(time_s, readings):
    return json.dumps({"time": time_s, **readings})


async def client_of(base, port, name, password):
    """A client of the service that lives in a folder."""
    own = own_identity(base / "client", ())
    client = Client(f"opc.tcp://127.0.0.1:{port}/thermojoint")
    client.application_uri = "urn:thermojoint:live"
    await client.set_security(
        SecurityPolicyBasic256Sha256,
        own.certificate,
        own.key,
        server_certificate=str(base / "state" / "certificate.pem"),
    )
    if name is not None:
        client.set_user(name)
        client.set_password(password)
    return client
