"""Thousands of idle connections at the interfaces of a service with few descriptors end nothing.

python -m benchmarks.live_idle --model model.json --connections 3100 --descriptors 256

The service runs with HTTPS and OPC UA on the loopback and is fed a line every 50 ms. Connections
are opened at both interfaces in turn, say nothing, and are opened again when they are closed.
Meanwhile every line must become a sample; afterwards both interfaces must answer. Reported:
samples, the most descriptors that the service held, and its memory before and after.
"""

from __future__ import annotations

import asyncio
import json
import resource
import secrets
import socket
import ssl
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import suppress
from pathlib import Path

import psutil
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from benchmarks.live_load import names_of
from benchmarks.study import free_port, options_of, service, wait_for
from thermojoint.live.archive import Archive
from thermojoint.live.certificates import APPLICATION, own_identity
from thermojoint.live.users import add_user

_SERVICE = """
folder = "state"
behind_s = 1e12
users = "users"
[models.model]
file = "{model}"
[machines.mill]
model = "model"
source = "log"
[sources.log]
kind = "csv"
path = "log.csv"
[opcua]
port = {opcua}
[http]
port = {http}
token = {{ file = "token" }}
"""
_START = 1_772_431_200
#: Between two lines, s.
_PACE_S = 0.05


def is_open(one: socket.socket) -> bool:
    """Say whether the other end has not closed a connection."""
    try:
        return one.recv(1, socket.MSG_DONTWAIT | socket.MSG_PEEK) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def crowd(ports: tuple[int, int], held: list[socket.socket], count: int) -> int:
    """Open connections until there are so many, closed ones anew; return how many were opened."""
    opened = 0
    for one in [one for one in held if not is_open(one)]:
        one.close()
        held.remove(one)
    while len(held) < count and opened < 400:
        with suppress(OSError):
            held.append(socket.create_connection(("127.0.0.1", ports[opened % 2]), 0.2))
        opened += 1
    return opened


async def opcua_answers(folder: Path, port: int) -> bool:
    """Say whether a new client of OPC UA logs in and reads the number of the last sample."""
    own = own_identity(folder / "panel", ())
    client = Client(f"opc.tcp://127.0.0.1:{port}/thermojoint", timeout=10.0)
    client.application_uri = APPLICATION
    certificate = str(folder / "state" / "certificate.pem")
    await client.set_security(
        SecurityPolicyBasic256Sha256, own.certificate, own.key, server_certificate=certificate
    )
    client.set_user("panel")
    client.set_password((folder / "password").read_text())
    with suppress(OSError, ua.UaError, TimeoutError):
        async with client:
            return bool(await client.get_node("ns=2;s=mill.SampleNumber").read_value() > 0)
    return False


def https_answers(port: int) -> bool:
    """Say whether the dashboard answers a new client."""
    context = ssl._create_unverified_context()
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        with suppress(OSError):
            url = f"https://127.0.0.1:{port}/healthz"
            return bool(urllib.request.urlopen(url, timeout=5, context=context).status == 200)
        time.sleep(0.5)
    return False


def main() -> None:
    """Run it and print what was found as JSON; exit code 1 if the service did not hold."""
    parser = options_of(__doc__)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--connections", type=int, default=3100)
    parser.add_argument("--descriptors", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=60.0)
    given = parser.parse_args()
    wanted = given.connections + 100
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, max(wanted, 4096)))
    names = names_of(given.model.absolute())
    ports = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        text = _SERVICE.format(model=given.model.absolute(), http=ports[0], opcua=ports[1])
        (place / "service.toml").write_text(text)
        (place / "token").write_text(secrets.token_urlsafe(32))
        (place / "token").chmod(0o600)
        (place / "password").write_text(secrets.token_urlsafe(12))
        add_user(place / "users", "panel", "viewer", (place / "password").read_text())
        line = ",".join(["{time}", *("20.0" for _ in names)]) + "\n"
        with (place / "log.csv").open("w") as out:
            out.write(",".join(["time_s", *names]) + "\n")
            out.flush()
            few = f'ulimit -n {given.descriptors}; exec "$@"'
            started = service(place / "service.toml", place / "log", ("/bin/sh", "-c", few, "sh"))
            try:
                wait_for("ready", started, place / "log")
                process, held = psutil.Process(started.pid), list[socket.socket]()
                before, most, opened, lines = process.memory_info().rss, 0, 0, 0
                begun = time.monotonic()
                while time.monotonic() - begun < given.seconds and started.poll() is None:
                    opened += crowd(ports, held, given.connections)
                    due = int((time.monotonic() - begun) / _PACE_S)
                    for k in range(lines, due):
                        out.write(line.format(time=_START + k))
                    out.flush()
                    lines = due
                    most = max(most, process.num_fds())
                    time.sleep(_PACE_S)
                for one in held:
                    one.close()
                archive, end = Archive(place / "state" / "history.sqlite"), time.monotonic() + 30.0
                while time.monotonic() < end and started.poll() is None:
                    said = archive.latest("mill")
                    if said is not None and said.number >= lines:
                        break
                    time.sleep(0.2)
                alive = started.poll() is None
                found = {
                    "connections": given.connections,
                    "opened": opened,
                    "descriptors": given.descriptors,
                    "most_held_by_the_service": most,
                    "lines": lines,
                    "samples": said.number if said is not None else 0,
                    "alive": alive,
                    "https_answers": alive and https_answers(ports[0]),
                    "opcua_answers": alive and asyncio.run(opcua_answers(place, ports[1])),
                    "mb_before": round(before / 2**20, 1),
                    "mb_after": round(process.memory_info().rss / 2**20, 1) if alive else None,
                    "log": sorted(
                        {
                            word.partition("=")[2]
                            for word in (place / "log").read_text().split()
                            if word.startswith("event=")
                        }
                    ),
                }
            finally:
                started.terminate()
                with suppress(subprocess.TimeoutExpired):
                    started.wait(30.0)
                started.kill()
    print(json.dumps(found, indent=2))
    held = found["https_answers"] and found["opcua_answers"]
    sys.exit(not (held and found["samples"] == found["lines"]))


if __name__ == "__main__":
    main()
