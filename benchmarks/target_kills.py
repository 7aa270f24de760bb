"""What reaches a control never jumps and never lies, by every way and with kills on either side.

PYTHONPATH=tests/helpers python -m benchmarks.target_kills --kills 50 --seed 0

One service sends offsets to five controls: one that reads OPC UA and one that reads MQTT, both
programmed by the rules of docs/service.md; servers that play a Siemens and a Beckhoff; and, where
it is installed, a real LinuxCNC with simulated joints. Its machine warms up and cools down every
forty seconds, and now and then sends nothing, or lines without readings. At random moments the
service, the broker, a control or both sides are killed and return, a control with the offset that
it had or with none. Then `thermojoint compensate` is killed as often while it writes a file.

Of every control it is told by how much its offset moved beyond the rate times the time, the
largest one, and how old the last usable line was when an offset was good. Offsets by OPC UA and by
MQTT carry the time of their publication. What is written into a control does not: a write that was
on its way for a moment seems too fast by the rate times this moment; `LATE_S` of it is allowed.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import aiomqtt
import httpx
import numpy as np
from asyncua import ua
from linuxcnc_control import Control
from linuxcnc_control import control as linuxcnc_control
from live_parts import Broker, client_of, free_port, until
from played_control import Played
from warming_machine import started

from benchmarks.study import MEASURED_LOG, ROOT, command, options_of
from thermojoint.compensation.offsets.handshake import STANDS
from thermojoint.live.users import add_user

#: µm/s, µm and µm; of one write into a control, µm.
RATE, STEP, LARGEST, WRITE = 3.0, 0.1, 20.0, 5.0
#: An estimate may be this old; a service looks every second, and a value may be on its way, s.
OLDEST_S, LOOKS_S, LATE_S = 3.0, 1.0, 1.0
#: A service that is silent for this long is away, s. Cycle of a control, s.
SILENT_S, CYCLE_S = 3.0, 0.1
#: Of the machine, s; its temperatures go this much further than those of the log.
PERIOD_S, FURTHER = 40.0, 5.0
_OFFSETS = f"""
rate_um_s = {RATE}
resolution_um = {STEP}
largest_um = {LARGEST}
filter_s = 0.0
oldest_s = {OLDEST_S}
freeze_s = 1.0
decay_s = 3.0
recover_s = 1.0
unusable = []
[axes.Z]
follows = "disp3"
"""
_SERVICE = """
folder = "state"
behind_s = 2.0
users = "users"
[models.m]
file = "model.json"
interval_s = 1.0
offsets = "offsets.toml"
[sources.line]
kind = "csv"
path = "{{machine}}.csv"
[opcua]
port = {opcua}
[mqtt]
port = {mqtt}
security = "none"
[http]
port = {http}
security = "none"
requests_per_s = 1000.0
"""
_MACHINE = """
[machines.{name}]
model = "m"
source = "line"
{target}
[machines.{name}.handshake]
by = "{by}"
heartbeat_s = {silent}
differs_um = 5.0
"""
#: So long a control may take to be on and homed again, s.
RESTARTS_S = 300.0
#: A control that returns after a shorter time, s, was not away.
AT_ONCE_S = 1.0
#: How each machine's control answers.
BY = {
    "opcua": "opcua",
    "mqtt": "mqtt",
    "sinumerik": "target",
    "beckhoff": "target",
    "linuxcnc": "http",
}
#: What these receive carries the time of its publication.
STAMPED = ("opcua", "mqtt")
_LOST = (OSError, TimeoutError, ua.UaError, aiomqtt.MqttError, httpx.HTTPError)


class Line:
    """The machines' readings: a warm-up and a cool-down for ever, from a log's coldest hours."""

    def __init__(self, place: Path, names: list[str]) -> None:
        header = MEASURED_LOG.read_text("utf-8").splitlines()[0].split(",")[1:]
        table = np.genfromtxt(MEASURED_LOG, delimiter=",", skip_header=1)[:, 1:]
        reached = table[:, header.index("disp3_um")]
        kept = [k for k, name in enumerate(header) if not name.startswith("disp")]
        self.cold, self.hot = (table[k, kept] for k in (reached.argmax(), reached.argmin()))
        self.paths = [place / f"{name}.csv" for name in names]
        self.does, self.usable = "runs", -math.inf
        for path in self.paths:
            path.write_text(",".join(["timestamp", *(header[k] for k in kept)]) + "\n")

    async def run(self) -> None:
        """Write a line every second: none from a silent machine, an empty one from a bad one."""
        while True:
            now = time.time()
            warm = 0.5 - 0.5 * math.cos(2.0 * math.pi * now / PERIOD_S)
            row = (self.cold + FURTHER * warm * (self.hot - self.cold)).round(3).tolist()
            cells = [f"{one:g}" if self.does == "runs" else "" for one in row]
            stamp = datetime.fromtimestamp(now, UTC).isoformat(timespec="milliseconds")
            for path in self.paths if self.does != "silent" else ():
                with path.open("a") as file:
                    file.write(",".join([stamp, *cells]) + "\n")
            if self.does == "runs":
                self.usable = time.monotonic()
            await asyncio.sleep(1.0 - time.time() % 1.0)


class Good:
    """How old the last usable line was when an offset was said to be good."""

    def __init__(self, line: Line) -> None:
        self.line, self.count, self.oldest = line, 0, 0.0

    def note(self, good: bool) -> None:
        """Note what was received now."""
        if good:
            self.count += 1
            self.oldest = max(self.oldest, time.monotonic() - self.line.usable)


class Panel:
    """A control that is programmed by the rules of docs/service.md."""

    def __init__(self, good: Good) -> None:
        self.good, self.record = good, list[tuple[float, float]]()
        self.acts, self.beats, self.enabled = 0.0, 0, False
        self.heard: tuple[object, float] = (None, -math.inf)
        self.task: asyncio.Task[None] | None = None

    def cycle(self, beat: object, handshake: str, said: tuple[float, float], good: bool) -> None:
        """Take over an offset (when it was published, µm), or not; then what it answers is new."""
        clock = time.monotonic()
        if beat != self.heard[0]:
            self.heard = beat, clock
        if clock - self.heard[1] > SILENT_S:
            self.enabled = False
        elif handshake != STANDS:
            self.enabled = True
        elif self.enabled:
            self.acts = said[1]
            self.record.append(said)
            self.good.note(good)
        self.beats += 1

    async def live(self, session: Callable[[], Awaitable[None]]) -> None:
        """Run sessions with the service for ever."""
        while True:
            with suppress(*_LOST):
                await session()
            await asyncio.sleep(0.2)

    async def kill(self, session: Callable[[], Awaitable[None]], down: float, cold: bool) -> None:
        """End it at once; it returns after a time (s), with what it had or with nothing."""
        if self.task is not None:
            self.task.cancel()
            await asyncio.gather(self.task, return_exceptions=True)
        await asyncio.sleep(down)
        if cold:
            self.acts = 0.0
            self.record += [(time.time(), math.nan), (time.time(), 0.0)]
        self.enabled, self.beats, self.heard = False, 0, (None, -math.inf)
        self.task = asyncio.create_task(self.live(session))

    async def by_opcua(self, place: Path, port: int, name: str) -> None:
        """Be a client of the service until the connection is lost."""
        client = await client_of(place, port, "panel", "the-panels-password")
        await client.connect()
        ids = (f"{name}.Offset.Z", f"{name}.Handshake", "Heartbeat")
        offset, handshake, beat = (client.get_node(f"ns=2;s={one}") for one in ids)
        answers = [client.get_node(f"ns=2;s={name}.Control.{one}")
                   for one in ("Acknowledged.Z", "Heartbeat", "Enable")]  # fmt: skip
        try:
            while True:
                # In this order: an offset that was read earlier may be from before a break.
                told = await beat.read_value(), await handshake.read_value()
                value = await offset.read_data_value(raise_on_bad_status=False)
                good = value.StatusCode is not None and value.StatusCode.is_good()
                at = value.ServerTimestamp.replace(tzinfo=UTC).timestamp()
                self.cycle(*told, (at, float(value.Value.Value)), good)
                said = (self.acts, ua.Variant(self.beats, ua.VariantType.UInt32), self.enabled)
                for node, one in zip(answers, said, strict=True):
                    await node.write_value(one)
                await asyncio.sleep(CYCLE_S)
        finally:
            client.disconnect_socket()

    async def by_mqtt(self, port: int, name: str) -> None:
        """Be a client of the broker until the connection is lost."""
        newest: dict[str, Any] = {}

        async def listen(client: aiomqtt.Client) -> None:
            async for message in client.messages:
                newest[str(message.topic).rpartition("/")[2]] = json.loads(message.payload)

        async with aiomqtt.Client("127.0.0.1", port) as client:
            for topic in (f"{name}/displacement", "service/heartbeat"):
                await client.subscribe(f"thermojoint/{topic}")
            listening = asyncio.create_task(listen(client))
            try:
                while not listening.done():
                    if len(newest) == 2:
                        told, beat = newest["displacement"], newest["heartbeat"]["heartbeat"]
                        good = told["offset_mode"] == "follow"
                        offset = told["published_s"], told["offsets_um"]["Z"]
                        self.cycle(beat, told["handshake"], offset, good)
                        said = {"enable": self.enabled, "heartbeat": self.beats,
                                "offsets_um": {"Z": self.acts}}  # fmt: skip
                        await client.publish(f"thermojoint/{name}/control", json.dumps(said))
                    await asyncio.sleep(CYCLE_S)
            finally:
                listening.cancel()
                await asyncio.gather(listening, return_exceptions=True)


class Cnc:
    """A real control: its component is killed, or it is switched off and forgets its offset."""

    def __init__(self, control: Control, place: Path) -> None:
        self.control, self.place = control, place
        self.off = list[tuple[float, float]]()
        self.components = 1

    def start(self) -> None:
        """Install the component as docs/guide-linuxcnc.md says, and start the control."""
        folder = self.control.folder
        (folder / "token.txt").write_text(token(self.place, "operator", "linuxcnc"))
        ini = [str(self.place / "service.toml"), str(folder / "mill.ini")]
        given = ["--machine", "linuxcnc", "--token", str(folder / "token.txt"), "--write"]
        run("linuxcnc", *ini, *given)
        self.control.start()
        self.control.until(lambda: len(self.control.record()) > 0)

    async def kill(self, down: float, cold: bool) -> None:
        """Kill the component, or switch the control off."""
        await asyncio.to_thread(self._switch_off if cold else self._kill, down)

    def _kill(self, down: float) -> None:
        name = "thermojoint" if self.components == 1 else f"thermojoint-{self.components}"
        os.kill(self.control.pin(f"{name}.pid"), signal.SIGKILL)
        time.sleep(down)
        line = (self.control.folder / "thermojoint.hal").read_text().splitlines()[1]
        self.control.run(line.split()[3:])
        self.components += 1
        # It has its name before it can be killed.
        time.sleep(1.0)

    def _switch_off(self, _: float) -> None:
        begun = time.monotonic()
        (self.control.folder / "off").touch()
        self.control.until(lambda: not (self.control.folder / "off").exists(), RESTARTS_S)
        rows = len(self.control.record())
        self.control.until(lambda: len(self.control.record()) > rows, RESTARTS_S)
        self.off.append((begun, time.monotonic()))

    def record(self) -> list[tuple[float, float]]:
        """Times (s) and offsets (µm); NaN where it was switched off."""
        at, um = self.control.record()[:, [0, 4]].T
        for begin, end in self.off:
            um[(at >= begin) & (at <= end)] = np.nan
        return list(zip(at.tolist(), um.tolist(), strict=True))


def run(*words: str) -> str:
    """Run a command of the program; return what it says."""
    line = command(*words)
    return subprocess.run(line, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT).stdout


def token(place: Path, role: str, machines: str) -> str:
    """Return a new token of the service."""
    words = ("--add", f"{role}-{machines.strip('*')}", "--role", role, "--machines", machines)
    return run("tokens", str(place / "service.toml"), *words).strip()


def names_of(cnc: Control | None) -> list[str]:
    """Return the names of the controls, each of its own machine."""
    return [name for name in BY if cnc or name != "linuxcnc"]


class Floor:
    """The service, the machines, the broker and the controls."""

    def __init__(self, place: Path, cnc: Control | None) -> None:
        self.place, self.names = place, names_of(cnc)
        self.line = Line(place, self.names)
        self.goods = {name: Good(self.line) for name in self.names}
        self.newest: dict[str, dict[str, Any]] = {}
        self.ports = [free_port() for _ in range(2)]
        self.broker = Broker(place, "allow_anonymous true")
        played = ("sinumerik", "beckhoff")
        self.played = {kind: Played(place / f"{kind}.toml", kind, WRITE) for kind in played}
        self.panels = {name: Panel(self.goods[name]) for name in STAMPED}
        self.sessions = {
            "opcua": lambda: self.panels["opcua"].by_opcua(place, self.ports[0], "opcua"),
            "mqtt": lambda: self.panels["mqtt"].by_mqtt(self.broker.port, "mqtt"),
        }
        self.cnc = Cnc(cnc, place) if cnc else None
        text = _SERVICE.format(opcua=self.ports[0], http=self.ports[1], mqtt=self.broker.port)
        for name in self.names:
            target = f'target = "{name}.toml"' if BY[name] == "target" else ""
            text += _MACHINE.format(name=name, target=target, by=BY[name], silent=SILENT_S)
        (place / "service.toml").write_text(text)
        (place / "offsets.toml").write_text(_OFFSETS)
        add_user(place / "users", "panel", "operator", "the-panels-password")
        self.service: subprocess.Popen[bytes] | None = None

    def close(self) -> None:
        """End the service and the broker."""
        if self.service is not None:
            self.service.kill()
            self.service.wait()
        self.broker.stop()

    async def listen(self, name: str, key: str) -> None:
        """Note what the service tells of a machine, for ever."""
        url = f"http://127.0.0.1:{self.ports[1]}/api/stream?every_s=0.1&machine={name}"
        head = "Authorization"
        async with httpx.AsyncClient(timeout=5.0, trust_env=False) as client:
            while True:
                with suppress(*_LOST):
                    async with client.stream("GET", url, headers={head: f"Bearer {key}"}) as said:
                        async for line in said.aiter_lines():
                            if line.startswith("data:"):
                                for one in json.loads(line[5:])["publications"]:
                                    self.newest[name] = one
                                    self.goods[name].note(one["offset_mode"] == "follow")
                await asyncio.sleep(0.2)

    async def kill(self, what: str, down: float, cold: bool) -> None:
        """Kill the service, the broker or a control, which returns after a time (s).

        A control that would return cold at once stays, and somebody else sets its value to zero.
        """
        if what == "service":
            if self.service is not None:
                self.service.kill()
                self.service.wait()
            self.newest.clear()
            await asyncio.sleep(down)
            self.service = started(self.place)
        elif what == "broker":
            self.broker.stop()
            await asyncio.sleep(down)
            await asyncio.to_thread(self.broker.start)
        elif what in self.panels:
            await self.panels[what].kill(self.sessions[what], down, cold)
        elif what in self.played and cold and down < AT_ONCE_S:
            await self.played[what].clears()
        elif what in self.played:
            await self.played[what].server.stop()
            await asyncio.sleep(down)
            await self.played[what].returns(cold)
        elif self.cnc is not None:
            await self.cnc.kill(down, cold)

    def follows(self, name: str) -> bool:
        """Whether a control has what the service sends it, about."""
        said = self.newest.get(name, {})
        if said.get("offset_mode") != "follow" or said["handshake"] != STANDS:
            return False
        if name in self.panels:
            has = self.panels[name].acts
        elif name in self.played:
            has = self.played[name].newest
        else:
            assert self.cnc is not None
            has = self.cnc.control.offset()
        return abs(has - said["offsets_um"]["Z"]) < WRITE

    def records(self) -> dict[str, list[tuple[float, float]]]:
        """What every control had, and when: s, µm."""
        parts: dict[str, Any] = self.panels | self.played
        found = {name: part.record for name, part in parts.items()}
        return found | ({"linuxcnc": self.cnc.record()} if self.cnc else {})


def drawn(names: list[str], kills: int, draw: random.Random) -> list[tuple[str, ...]]:
    """Return what is killed together, so many times, where there are these controls."""
    controls = [draw.choice(names) for _ in range(kills)]
    return [draw.choice((("service",), (one,), ("service", one), ("broker",))) for one in controls]


async def play(
    place: Path,
    cnc: Control | None,
    rounds: list[tuple[str, ...]],
    draw: random.Random,
    longest: float = 5.0,
) -> dict[str, Any]:
    """Kill at random moments; return what was found by control.

    Parameters
    ----------
    place : Path
        With a model, ``model.json``.
    cnc : Control or None
        Of LinuxCNC, not started.
    rounds : list of tuple of str
        What is killed together, one after the other.
    draw : Random
    longest : float
        Before a kill, and after it until the return, s.

    Raises
    ------
    AssertionError
        A control does not follow any more.
    """
    floor, count = Floor(place, cnc), dict[str, int]()
    with ExitStack() as stack:
        stack.callback(floor.close)
        floor.broker.start()
        for one in floor.played.values():
            await one.open()
        key = token(place, "viewer", "*")
        tasks = [floor.line.run(), *(floor.listen(name, key) for name in floor.names)]
        running = [asyncio.create_task(one) for one in tasks]
        floor.service = started(place)
        for name in floor.panels:
            await floor.kill(name, 0.0, cold=False)
        if floor.cnc:
            await asyncio.to_thread(floor.cnc.start)

        async def all_follow() -> None:
            floor.line.does = "runs"
            for name in floor.names:
                try:
                    await until(lambda name=name: floor.follows(name))
                except AssertionError:
                    told = floor.newest.get(name)
                    raise AssertionError(f"{name} does not follow: {told}") from None

        await all_follow()
        for sides in rounds:
            floor.line.does = draw.choice(("runs", "runs", "runs", "silent", "bad"))
            await asyncio.sleep(draw.uniform(0.0, longest))
            for what in sides:
                count[what] = count.get(what, 0) + 1
            await asyncio.gather(
                *(floor.kill(one, draw.uniform(0.0, longest), draw.random() < 0.4) for one in sides)
            )
            if draw.random() < 0.6:
                await all_follow()
        await all_follow()
        for task in (*running, *(one.task for one in floor.panels.values() if one.task)):
            task.cancel()
        for one in floor.played.values():
            await one.server.stop()
        found = {name: judged(record) for name, record in floor.records().items()}
    for name, good in floor.goods.items():
        found[name] |= {"good": good.count, "oldest_behind_good_s": round(good.oldest, 2)}
    return {"killed": count, "controls": found}


def judged(record: list[tuple[float, float]]) -> dict[str, float]:
    """Return how many values were received, how far one moved too far and the largest, µm."""
    at, um = np.array(record).T
    beyond = 0.0
    for part in np.split(np.arange(um.size), np.flatnonzero(np.isnan(um))):
        rows = part[np.isfinite(um[part])]
        for lag in (1, 5, 20):
            spent, moved = (np.abs(one[rows][lag:] - one[rows][:-lag]) for one in (at, um))
            beyond = max(beyond, np.max(moved - RATE * spent - 1.5 * STEP, initial=0.0))
    return {
        "values": int(np.isfinite(um).sum()),
        "beyond_rate_um": round(beyond, 2),
        "largest_um": round(float(np.nanmax(np.abs(um))), 2),
    }


def killed_files(place: Path, kills: int, draw: random.Random) -> dict[str, int]:
    """Kill a command that replaces a file of offsets; return what stood there: old, new, broken."""
    estimate, offsets = place / "estimate.csv", place / "offsets.csv"
    run("estimate", str(place / "model.json"), str(MEASURED_LOG), "--out", str(estimate))
    words = ["compensate", str(estimate), "--out", str(offsets), "--settings"]
    settings = place / "offsets.toml"
    kinds = {}
    for name, largest in (("old", 5.0), ("new", LARGEST)):
        settings.write_text(_OFFSETS.replace(f"largest_um = {LARGEST}", f"largest_um = {largest}"))
        begun = time.monotonic()
        run(*words, str(settings))
        took = time.monotonic() - begun
        kinds[offsets.read_bytes()] = name
    found = dict.fromkeys(("old", "new", "broken"), 0)
    for _ in range(kills):
        offsets.write_bytes(next(iter(kinds)))
        line = command(*words, settings)
        process = subprocess.Popen(line, cwd=ROOT, stderr=subprocess.DEVNULL)
        time.sleep(draw.uniform(0.3, 1.1) * took)
        process.kill()
        process.wait()
        found[kinds.get(offsets.read_bytes(), "broken")] += 1
    return found


def violations(found: dict[str, Any]) -> list[str]:
    """Return what does not hold in what `play` found."""
    # A message stays with a control until it notices that the service is gone.
    oldest = OLDEST_S + max(LOOKS_S, SILENT_S) + LATE_S
    limits = {"largest_um": LARGEST + 0.05, "oldest_behind_good_s": oldest}
    return [
        f"{name}: {key} {one[key]}"
        for name, one in found["controls"].items()
        for key, most in (
            limits | {"beyond_rate_um": RATE * LATE_S * (name not in STAMPED)}
        ).items()
        if one[key] > most
    ]


def learned(place: Path) -> None:
    """Learn a model of the measured machine that answers at once."""
    words = ["--displacement", "disp3_um", "--kind", "ridge", "--out", str(place / "model.json")]
    run("learn", str(MEASURED_LOG), *words)


def main() -> None:
    """Run it and print what was found as JSON; exit code 1 if anything does not hold."""
    parser = options_of(__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    draw, begun = random.Random(given.seed), time.monotonic()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        place = Path(folder)
        learned(place)
        installed = Path("/usr/bin/linuxcnc").exists()
        cnc = stack.enter_context(linuxcnc_control()) if installed else None
        rounds = drawn(names_of(cnc), given.kills, draw)
        found = asyncio.run(play(place, cnc, rounds, draw))
        found["files"] = killed_files(place, given.kills, draw)
    found["violations"] = violations(found) + ["files"] * bool(found["files"]["broken"])
    found["wall_s"] = round(time.monotonic() - begun, 1)
    print(json.dumps(found, indent=2))
    sys.exit(bool(found["violations"]))


if __name__ == "__main__":
    main()
