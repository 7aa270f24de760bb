"""Capacity of one core: many machines at 1 Hz through a broker, from message to published value.

python -m benchmarks.live_load --model model.json --machines 1000 --minutes 30 --out load.json

A broker on the loopback, one process that plays all machines (each at its own moment of the
second), the service in a process of its own that is held to one core, and this process, which
hears what the service publishes. Reported: 50th, 99th and largest time from sending a message to
hearing its estimate, the service's share of its core, and its memory in time.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import aiomqtt
import numpy as np
import psutil

from benchmarks.study import free_port, options_of, service, wait_for, write_json

_BROKER = """
listener {port} 127.0.0.1
allow_anonymous true
max_inflight_messages 0
max_queued_messages 0
set_tcp_nodelay true
persistence false
"""
_SERVICE = """
folder = "state"
[models.model]
file = "{model}"
interval_s = 1.0
[machines.mill]
model = "model"
source = "hall"
count = {machines}
[sources.hall]
kind = "mqtt"
topic = "hall/{{machine}}"
security = "none"
port = {port}
[mqtt]
security = "none"
port = {port}
"""
_OPCUA = '[opcua]\nsecurity = "none"\nport = {port}\nreadings = false\n'
#: Left out at the beginning: connections, first messages, s.
_WARM_UP_S = 10.0
#: Machines whose estimates are heard: hearing all of them would take as long as making them.
_HEARD = 50


def names_of(model: Path) -> tuple[str, ...]:
    """Return what a machine with a model reads in every sample."""
    from thermojoint.live.loaded_models import load_model
    from thermojoint.live.settings import ModelSection

    with tempfile.TemporaryDirectory() as kept:
        found = load_model(ModelSection(file=model), Path(kept)).intake
    return found.names[: found.wanted]


def play(port: int, machines: int, names: Sequence[str], seconds: float) -> None:
    """Send each machine's readings once a second, all moments of the second alike."""

    async def playing() -> None:
        draw = np.random.default_rng(0)
        async with aiomqtt.Client("127.0.0.1", port, max_inflight_messages=65535) as client:
            begun = time.time()
            noise = draw.standard_normal((1000, len(names)))
            k = 0
            while (passed := time.time() - begun) < seconds:
                due = int(passed * machines)
                for n in range(k, due):
                    machine, second = n % machines, n // machines
                    rise = 3.0 * np.sin(second / 600.0)
                    told = dict(
                        zip(names, (25.0 + rise + 0.02 * noise[n % 1000]).tolist(), strict=True)
                    )
                    told["time"] = time.time()
                    client._client.publish(f"hall/mill-{machine + 1}", json.dumps(told), qos=1)
                k = due
                await asyncio.sleep(0.001)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asyncio.run(playing())


async def listen(
    port: int, service: psutil.Process, machines: int, seconds: float
) -> dict[str, object]:
    """Hear the service for a time; return what was found."""
    delays: list[float] = []
    heard_at: list[float] = []
    memory: list[tuple[float, float]] = []
    begun = time.time()

    def heard(client: object, data: object, message: object) -> None:
        now = time.time()
        content = json.loads(message.payload)  # type: ignore[attr-defined]
        if now - begun > _WARM_UP_S and content["number"] and "silent" not in content["status"]:
            # The instant of a sample is near the time of its message, within a wavering.
            instant = content["time_s"]
            sent_at = times.get(content["machine"], ())
            if sent_at:
                delays.append(now - min(sent_at, key=lambda one: abs(one - instant)))
                heard_at.append(now - begun)

    times: dict[str, deque[float]] = {}

    def sent(client: object, data: object, message: object) -> None:
        content = json.loads(message.payload)  # type: ignore[attr-defined]
        machine = message.topic.rpartition("/")[2]  # type: ignore[attr-defined]
        times.setdefault(machine, deque(maxlen=64)).append(content["time"])

    async with aiomqtt.Client("127.0.0.1", port) as client:
        client._client.message_callback_add("thermojoint/#", heard)
        client._client.message_callback_add("hall/#", sent)
        heard_of = sorted({1 + k * machines // _HEARD for k in range(_HEARD)})
        for k in heard_of:
            await client.subscribe(
                [(f"thermojoint/mill-{k}/displacement", 0), (f"hall/mill-{k}", 0)]
            )
        await asyncio.sleep(_WARM_UP_S)
        before, at = service.cpu_times(), time.time()
        while time.time() - begun < seconds:
            memory.append((time.time() - begun, service.memory_info().rss / 2**20))
            await asyncio.sleep(5.0)
        after, passed = service.cpu_times(), time.time() - at
    used = after.user + after.system - before.user - before.system
    found, minute = np.sort(delays), np.array(heard_at) // 60.0
    rss = np.array(memory)
    half = rss[len(rss) // 2 :]
    return {
        "estimates_per_s": round(len(found) / passed * machines / len(heard_of), 1),
        "p50_ms": round(1e3 * float(np.quantile(found, 0.5)), 2),
        "p99_ms": round(1e3 * float(np.quantile(found, 0.99)), 2),
        "largest_ms": round(1e3 * float(found[-1]), 1),
        "p99_ms_by_minute": [
            round(1e3 * float(np.quantile(np.array(delays)[minute == k], 0.99)), 1)
            for k in np.unique(minute)
        ],
        "cpu_share": round(used / passed, 3),
        "rss_mb": [round(one, 1) for _, one in memory],
        "rss_growth_mb_per_h": round(float(np.polyfit(half[:, 0], half[:, 1], 1)[0]) * 3600.0, 1),
    }


def main() -> None:
    """Run it and print what was found as JSON."""
    parser = options_of(__doc__)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--machines", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--opcua", action="store_true", help="with an OPC UA server beside it")
    parser.add_argument("--out", type=Path, help="JSON to write")
    given = parser.parse_args()
    broker_program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if broker_program is None:
        sys.exit("live_load: needs mosquitto")
    port, seconds = free_port(), 60.0 * given.minutes + _WARM_UP_S
    model = given.model.absolute()
    names = names_of(model)
    started: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "broker.conf").write_text(_BROKER.format(port=port))
        text = _SERVICE.format(model=model, machines=given.machines, port=port)
        text += _OPCUA.format(port=free_port()) if given.opcua else ""
        (place / "service.toml").write_text(text)
        player = multiprocessing.Process(
            target=play, args=(port, given.machines, names, seconds), daemon=True
        )
        try:
            started.append(
                subprocess.Popen(
                    [broker_program, "-c", str(place / "broker.conf")], stderr=subprocess.DEVNULL
                )
            )
            time.sleep(1.0)
            os.environ["OMP_NUM_THREADS"] = "1"
            process = service(place / "service.toml", place / "log")
            started.append(process)
            with suppress(AttributeError):
                os.sched_setaffinity(process.pid, {max(os.sched_getaffinity(0))})
            begun = time.monotonic()
            wait_for("connected", process, place / "log")
            start_s = time.monotonic() - begun
            player.start()
            found = asyncio.run(listen(port, psutil.Process(process.pid), given.machines, seconds))
            size = sum(one.stat().st_size for one in (place / "state").glob("history*")) / 2**20
            late = [
                line for line in (place / "log").read_text().splitlines() if "ready" not in line
            ]
        finally:
            for one in reversed(started):
                one.kill()
                one.wait()
            player.kill()
    told = {
        "model": given.model.name,
        "machines": given.machines,
        "minutes": given.minutes,
        "opcua": given.opcua,
        "start_s": round(start_s, 1),
        "store_mb": round(size, 1),
        **found,
        "log_lines": len(late),
        "load_average": os.getloadavg()[0],
    }
    print(json.dumps(told, indent=2))
    if given.out:
        write_json(given.out, told)


if __name__ == "__main__":
    main()
