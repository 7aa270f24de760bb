"""Days of three machines, 24 h in 86 s, while broker, PLC and disk fail at random moments.

python -m benchmarks.live_day --seed 0

One service reads a machine by MQTT, one by OPC UA and one by CSV lines, a thousand times faster
than they ran. Meanwhile the broker is stopped and started again, connections to the PLC are cut,
another program locks the store, and the disk is full (where this process may mount one of its own).
Then every sample is set against that of services that read the same day undisturbed. Reported, too:
the largest move of an offset that a control received beyond the rate times the time and a step, and
the memory of the service.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import aiomqtt
import numpy as np
import paho.mqtt.client as paho
import psutil
from asyncua import Server, ua

from benchmarks.live_kills import differences, measured_day
from benchmarks.study import free_port, learn, options_of, service, wait_for
from thermojoint.artefacts.arrays import Array
from thermojoint.live.archive import Archive
from thermojoint.live.service import run
from thermojoint.live.settings import read_service

START, INTERVAL = 1_772_409_600.0, 60.0
MACHINES = ("by-mqtt", "by-opcua", "by-csv")
#: µm/s, µm and µm: what an offset may do.
RATE, STEP, LARGEST = 1.0, 0.1, 100.0
#: Room on the disk, bytes.
_DISK = 48 << 20
_OFFSETS = f"""
resolution_um = {STEP}
rate_um_s = {RATE}
largest_um = {LARGEST}
oldest_s = 600.0
unusable = []
[axes.X]
follows = "disp1"
"""
_COMMON = """
behind_s = 1e9
[models.model]
file = "model.json"
interval_s = 60.0
hold_s = 86400.0
offsets = "offsets.toml"
[store]
keep_days = 10000.0
checkpoint_s = 5.0
[watchdog]
uncertain_s = 600.0
bad_s = 6000.0
"""
_SERVICE = """folder = "disk/state"
{common}
[machines.by-mqtt]
model = "model"
source = "broker"
[machines.by-opcua]
model = "model"
source = "plc"
[machines.by-csv]
model = "model"
source = "line"
[sources.broker]
kind = "mqtt"
topic = "plant/{{machine}}"
security = "none"
port = {broker}
[sources.plc]
kind = "opcua"
url = "opc.tcp://127.0.0.1:{relay}/plc"
node = "ns=2;s={{machine}}.{{reading}}"
security = "none"
publishing_ms = 50.0
[sources.line]
kind = "csv"
path = "fed.csv"
starts = "2026-03-02T00:00:00Z"
[mqtt]
security = "none"
port = {broker}
"""
_UNDISTURBED = """folder = "undisturbed"
{common}
[machines.mill]
model = "model"
source = "line"
[sources.line]
kind = "csv"
path = "day.csv"
follow = false
"""
_BROKER = """
listener {port} 127.0.0.1
allow_anonymous true
user root
max_inflight_messages 0
max_queued_messages 0
persistence true
persistence_location {folder}/
"""


class Relay:
    """Passes connections on to a port, unless they are cut."""

    def __init__(self, target: int) -> None:
        self.target, self.cut = target, False
        self.open = set[asyncio.StreamWriter]()

    async def take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass a connection on until one end closes it."""
        ends = [writer]
        with suppress(OSError):
            if not self.cut:
                there, to = await asyncio.open_connection("127.0.0.1", self.target)
                ends.append(to)
                self.open |= set(ends)
                await asyncio.gather(self._pass(reader, to), self._pass(there, writer))
        self.open -= set(ends)
        for one in ends:
            one.close()

    async def _pass(self, source: asyncio.StreamReader, to: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await source.read(1 << 16):
                to.write(data)
        to.close()

    def fail(self, failing: bool) -> None:
        """Cut all connections and refuse new ones, or take them again."""
        self.cut = failing
        for one in list(self.open) if failing else []:
            one.transport.abort()


class Broker:
    """A Mosquitto that keeps what it has while it is stopped."""

    def __init__(self, folder: Path, port: int) -> None:
        program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
        if program is None:
            sys.exit("live_day: needs mosquitto")
        (folder / "broker.conf").write_text(_BROKER.format(port=port, folder=folder))
        self.command = [program, "-c", str(folder / "broker.conf")]
        self.process: subprocess.Popen[bytes] | None = None
        self.fail(False)

    def fail(self, failing: bool) -> None:
        """Stop or start."""
        if failing and self.process is not None:
            self.process.terminate()
            self.process.wait()
        elif not failing:
            self.process = subprocess.Popen(self.command, stderr=subprocess.DEVNULL)


class Disk:
    """The store's disk: full, or the store is locked by another program."""

    def __init__(self, folder: Path, draw: random.Random) -> None:
        self.folder, self.draw, self.kinds = folder, draw, {"full": 0, "locked": 0}
        self.other: sqlite3.Connection | None = None
        mount = ["mount", "-t", "tmpfs", "-o", f"size={_DISK}", "tmpfs", str(folder)]
        folder.mkdir()
        self.own = subprocess.run(mount, check=False, capture_output=True).returncode == 0

    def fail(self, failing: bool) -> None:
        """Take room or lock away, or give them back."""
        filler = self.folder / "filler"
        if not failing:
            filler.unlink(missing_ok=True)
            if self.other is not None:
                self.other.close()
                self.other = None
        elif self.own and self.draw.random() < 0.5:
            self.kinds["full"] += 1
            with suppress(OSError), filler.open("wb", buffering=0) as out:
                while True:
                    out.write(bytes(4096))
        else:
            self.kinds["locked"] += 1
            self.other = sqlite3.connect(self.folder / "state" / "history.sqlite", timeout=5.0)
            self.other.execute("BEGIN EXCLUSIVE")

    def close(self) -> None:
        """Leave nothing."""
        self.fail(False)
        if self.own:
            subprocess.run(["umount", "-l", str(self.folder)], check=False)


async def plc(
    port: int, names: list[str], first: list[float]
) -> tuple[Server, Callable[[Array], Any]]:
    """Return a server with a variable and a history of each reading, and what writes a row."""
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/plc")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    server.set_identity_tokens([ua.AnonymousIdentityToken])
    await server.register_namespace("urn:plc")
    nodes = []
    await server.start()
    for name in names:
        at = ua.NodeId(f"by-opcua.{name}", 2)
        nodes.append(await server.nodes.objects.add_variable(at, name, 0.0))
        # Its first value is no reading.
        stamp = datetime.fromtimestamp(START, UTC)
        value = ua.DataValue(ua.Variant(first[len(nodes)]), SourceTimestamp=stamp)
        await server.write_attribute_value(nodes[-1].nodeid, value)
        await server.iserver.enable_history_data_change(nodes[-1], timedelta(days=3650), 100_000)

    async def write(row: Array) -> None:
        for node, value in zip(nodes, row[1:].tolist(), strict=True):
            stamp = datetime.fromtimestamp(START + row[0], UTC)
            given = ua.DataValue(ua.Variant(value, ua.VariantType.Double), SourceTimestamp=stamp)
            await server.write_attribute_value(node.nodeid, given)

    return server, write


async def failing(fail: Callable[[bool], None], draw: random.Random, count: list[int]) -> None:
    """Let something fail again and again, for ever."""
    while True:
        await asyncio.sleep(draw.uniform(2.0, 8.0))
        count[0] += 1
        fail(True)
        try:
            await asyncio.sleep(draw.uniform(0.2, 3.0))
        finally:
            fail(False)


async def tell(port: int, queue: deque[tuple[str, str]]) -> None:
    """Publish one message after the other, each until the broker has it, for ever."""
    while True:
        with suppress(aiomqtt.MqttError):
            async with aiomqtt.Client("127.0.0.1", port) as client:
                while True:
                    while not queue:
                        await asyncio.sleep(0.002)
                    await client.publish(*queue[0], qos=1)
                    queue.popleft()
        await asyncio.sleep(0.2)


def control(port: int) -> tuple[paho.Client, dict[str, list[tuple[float, float]]]]:
    """Return a client that notes when which offset (µm) was sent to each machine."""
    heard: dict[str, list[tuple[float, float]]] = {name: [] for name in MACHINES}

    def take(client: object, data: object, message: paho.MQTTMessage) -> None:
        told = json.loads(message.payload)
        heard[told["machine"]].append((told["published_s"], told["offsets_um"]["X"]))

    client = paho.Client(paho.CallbackAPIVersion.VERSION2)

    def ask(*_: object) -> None:
        client.subscribe("thermojoint/+/displacement", 1)

    client.on_connect = ask
    client.on_message = take
    client.max_queued_messages_set(0)
    client.reconnect_delay_set(1, 1)
    client.connect("127.0.0.1", port)
    client.loop_start()
    return client, heard


def excess(heard: list[tuple[float, float]]) -> float:
    """Return by how much an offset moved beyond what it may, at most, µm."""
    moved = [
        abs(b - a) - RATE * max(0.0, later - at) - STEP
        for (at, a), (later, b) in itertools.pairwise(heard)
    ]
    return max([*moved, *(abs(offset) - LARGEST for _, offset in heard)], default=0.0)


async def play(place: Path, given: argparse.Namespace) -> dict[str, Any]:
    """Play the day; return what was found."""
    lines = measured_day(INTERVAL, given.hours)
    names = lines[0].strip().split(",")
    rows = np.array([[float(one) for one in line.split(",")] for line in lines[1:]])
    draw, ports = random.Random(given.seed), [free_port() for _ in range(3)]
    text = _SERVICE.format(common=_COMMON, broker=ports[0], relay=ports[2])
    (place / "service.toml").write_text(text)
    (place / "offsets.toml").write_text(_OFFSETS)
    (place / "fed.csv").write_text(lines[0])
    relay, broker, disk = Relay(ports[1]), Broker(place, ports[0]), Disk(place / "disk", draw)
    with ExitStack() as stack:
        stack.callback(disk.close)
        stack.callback(broker.fail, True)
        door = await asyncio.start_server(relay.take, "127.0.0.1", ports[2])
        server, write = await plc(ports[1], names[1:], rows[0].tolist())
        await asyncio.sleep(1.0)
        client, heard = control(ports[0])
        stack.callback(client.loop_stop)
        started = service(place / "service.toml", place / "log")
        stack.callback(started.kill)
        await asyncio.to_thread(wait_for, "connected", started, place / "log", 3)
        process, memory, counts = psutil.Process(started.pid), list[float](), [[0], [0], [0]]
        fails = [broker.fail, relay.fail, disk.fail]
        tasks = [
            asyncio.create_task(failing(fail, random.Random(draw.random()), count))
            for fail, count in zip(fails, counts, strict=True)
        ]
        queue = deque[tuple[str, str]]()
        telling = asyncio.create_task(tell(ports[0], queue))
        begun, out = time.monotonic(), stack.enter_context((place / "fed.csv").open("a"))
        for k, row in enumerate(rows):
            due = begun + (k + 1) * INTERVAL / given.speed
            await asyncio.sleep(max(0.001, due - time.monotonic()))
            out.write(lines[1 + k])
            out.flush()
            content = dict(zip(names[1:], row[1:].tolist(), strict=True))
            queue.append(("plant/by-mqtt", json.dumps({"time": START + row[0], **content})))
            if k:
                await write(row)
            memory.append(process.memory_info().rss / 2**20)
        wall = time.monotonic() - begun
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        archive, end = Archive(place / "disk" / "state" / "history.sqlite"), time.monotonic() + 90.0
        while time.monotonic() < end and started.poll() is None:
            last = [archive.latest(name) for name in MACHINES]
            if all(one is not None and one.time >= START + rows[-1, 0] for one in last):
                break
            await asyncio.sleep(0.5)
        telling.cancel()
        started.terminate()
        code = await asyncio.to_thread(started.wait, 60.0)
        door.close()
        await server.stop()
        histories = {name: archive.history(name, START, 1e11, 10**9) for name in MACHINES}
    (place / "day.csv").write_text(
        "".join(
            [
                lines[0].replace("time_s", "time"),
                *(
                    f"{datetime.fromtimestamp(START + row[0], UTC):%Y-%m-%dT%H:%M:%SZ}"
                    + line[line.index(",") :]
                    for row, line in zip(rows, lines[1:], strict=False)
                ),
            ]
        )
    )
    (place / "whole.toml").write_text(_UNDISTURBED.format(common=_COMMON))
    await run(read_service(place / "whole.toml"), asyncio.Event())
    whole = Archive(place / "undisturbed" / "history.sqlite").history("mill", START, 1e11, 10**9)
    half = memory[len(memory) // 2 :]
    return {
        "played_h": len(rows) * INTERVAL / 3600.0,
        "wall_s": round(wall, 1),
        "failures": {"broker": counts[0][0], "plc": counts[1][0], **disk.kinds},
        "samples": len(rows),
        "differences": {name: differences(whole, one) for name, one in histories.items()},
        "offsets_heard": {name: len(one) for name, one in heard.items()},
        "offsets_beyond_what_they_may_um": round(max(map(excess, heard.values())), 3),
        "exit_code": code,
        "tracebacks": (place / "log").read_text().count("Traceback"),
        "mb_begin_middle_end": [round(one, 1) for one in (memory[0], half[0], half[-1])],
    }


def main() -> None:
    """Run it and print what was found as JSON; exit code 1 if anything does not hold."""
    parser = options_of(__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--speed", type=float, default=1000.0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        learn(place / "model.json", "disp1_um")
        found = asyncio.run(play(place, given))
    print(json.dumps(found, indent=2))
    fine = not any(found["differences"].values()) and not found["exit_code"]
    sys.exit(not (fine and found["offsets_beyond_what_they_may_um"] <= 0.01))


if __name__ == "__main__":
    main()
