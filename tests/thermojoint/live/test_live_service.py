"""The service with real parts: lines of CSV, a Mosquitto broker, OPC UA servers; all encrypted."""

import asyncio
import contextlib
import json
import random
import signal
import socket
import sqlite3
import subprocess
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import aiomqtt
import httpx
import numpy as np
import pytest
from asyncua import Client, Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.history import HistoryDict
from live_parts import (
    Broker,
    client_of,
    estimated,
    events_in,
    free_port,
    history_in,
    message,
    needs_broker,
    serving,
    until,
)
from own_process import OwnProcess
from prometheus_client import generate_latest
from small_disk import fill, mounted

from benchmarks import live_kills
from estimator.quality import Quality
from thermojoint.artefacts.errors import InputError
from thermojoint.live import processing
from thermojoint.live.archive import Archive
from thermojoint.live.arrivals import Arrival
from thermojoint.live.certificates import own_identity
from thermojoint.live.disk_reserve import SLICE
from thermojoint.live.opcua_session import Endpoint
from thermojoint.live.readers import opcua
from thermojoint.live.readers.opcua import OpcuaReader
from thermojoint.live.service import run
from thermojoint.live.settings import read_service
from thermojoint.live.users import add_user
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly

NAMES = ("a_degC", "b_degC", "T1_degC", "T2_degC", "ambient_degC")
START = 1_772_431_200.0
INTERVAL = 1.0


@pytest.fixture(autouse=True)
def own_process(monkeypatch):
    """What is killed has loaded its libraries beforehand."""

    def started(place, name):
        with (place / f"{name}.log").open("a") as log:
            return OwnProcess("serve", place / f"{name}.toml", stderr=log)

    monkeypatch.setattr(live_kills, "started", started)


def day(count=120):
    """Temperatures that rise as a machine's do."""
    times = np.arange(count) * INTERVAL
    rise = 1.0 - np.exp(-times / 60.0)
    columns = (20.0 + 6.0 * rise, 20.0 + 0.5 * rise, 20.0 + rise, 20.0 + 3.0 * rise)
    # The room changes, too: a server's history has what has changed.
    return np.column_stack([START + times, *columns, 20.0 + 0.1 * rise])


@pytest.fixture(scope="module")
def expected(model):
    return estimated(model, day())


def file_of(model, source, **more):
    return {
        "folder": "state",
        "models": {"m": {"file": str(model), "interval_s": INTERVAL}},
        "machines": {"mill": {"model": "m", "source": "line"}},
        "sources": {"line": source},
        "behind_s": 1e9,
        **more,
    }


def csv_of(rows):
    lines = [
        ",".join(("time_s", *NAMES)),
        *(",".join(f"{one!r}" for one in row) for row in rows.tolist()),
    ]
    return "\n".join(lines) + "\n"


def assert_says(history, expected):
    np.testing.assert_array_equal(history.numbers, np.arange(1, len(history.numbers) + 1))
    np.testing.assert_allclose(history.columns.displacement, expected, rtol=1e-12, atol=1e-18)


def lived_to_its_end(model, base, lines):
    """A service reads a log that does not grow."""
    (base / "log.csv").write_text("".join(lines))
    data = file_of(model, {"kind": "csv", "path": "log.csv", "follow": False})

    async def live():
        async with serving(data, base) as running:
            await until(running.stop.is_set)

    asyncio.run(live())


def test_lines_are_estimated_as_the_estimator_says_and_once_over_three_lives(
    model, expected, tmp_path
):
    rows = csv_of(day()).splitlines(keepends=True)
    for end in (30, 31, 200):
        lived_to_its_end(model, tmp_path, rows[:end])
    history = history_in(tmp_path)
    assert_says(history, expected)
    assert not history.gaps


def test_another_model_starts_anew_where_the_one_before_it_stopped(
    model, hand_made_model, tmp_path
):
    """And no sample is read twice."""
    rows = csv_of(day()).splitlines(keepends=True)
    other = replace(hand_made_model, distances=((0.11, 0.30), (0.32, 0.11)))
    write_assembly(assemble(other, INTERVAL, 7200.0), tmp_path / "other.json")
    for end, file in ((41, model), (81, tmp_path / "other.json"), (121, model)):
        lived_to_its_end(file, tmp_path, rows[:end])
    found = history_in(tmp_path)
    np.testing.assert_array_equal(found.columns.times, day()[:, 0])


def test_a_fifo_is_read_as_lines_are_written(model, expected, tmp_path):
    import os

    os.mkfifo(tmp_path / "pipe")

    async def live():
        source = {"kind": "csv", "path": "pipe"}
        async with serving(file_of(model, source), tmp_path) as running:
            text = csv_of(day(20)).replace("\n", "\nno,row\n", 3)
            await asyncio.to_thread((tmp_path / "pipe").write_text, text)
            await until(lambda: running.publisher.newest["mill"].number == 20)

    asyncio.run(live())
    assert_says(history_in(tmp_path), expected[:20])


def test_one_machines_bad_file_header_or_model_ends_no_other(model, expected, tmp_path):
    """A model that is none; a log replaced by an empty one, then by one with another header."""
    data = file_of(model, {"kind": "csv", "path": "{machine}.csv"})
    (tmp_path / "none.json").write_text("{}")
    data["models"]["none"] = {"file": "none.json"}
    data["machines"] |= {
        "lathe": {"model": "m", "source": "line"},
        "drill": {"model": "none", "source": "line"},
    }
    lines = csv_of(day(40)).splitlines(keepends=True)
    (tmp_path / "mill.csv").write_text("".join(lines[:11]))
    (tmp_path / "lathe.csv").write_text("".join(lines[:11]))

    def replaced(text):
        (tmp_path / "new").write_text(text)
        (tmp_path / "new").rename(tmp_path / "lathe.csv")

    async def live():
        async with serving(data, tmp_path) as running:
            newest = running.publisher.newest
            assert set(running.fleet.machines) == {"mill", "lathe"}
            await until(lambda: min(one.number for one in newest.values()) == 10)
            replaced("")
            await until(lambda: events_in(tmp_path, "source-replaced"))
            replaced("time_s,other_degC\n" + "".join(f"{k},20\n" for k in range(200)))
            await until(lambda: events_in(tmp_path, "source-refused"))
            with (tmp_path / "mill.csv").open("a") as file:
                file.write("".join(lines[11:]))
            await until(lambda: newest["mill"].number == 40)
            replaced(lines[0] + "".join(lines[11:]))
            await until(lambda: newest["lathe"].number == 40)

    asyncio.run(live())
    assert len(events_in(tmp_path, "model-refused")) == 1
    assert_says(history_in(tmp_path), expected[:40])


def test_a_folder_is_one_services_and_a_store_that_others_hold_is_waited_for(model, tmp_path):
    data = file_of(model, {"kind": "csv", "path": "log.csv"})
    lines = csv_of(day(40)).splitlines(keepends=True)
    (tmp_path / "log.csv").write_text("".join(lines[:21]))

    async def live():
        async with serving(data, tmp_path) as running:
            with pytest.raises(InputError, match="another service"):
                async with serving(data, tmp_path):
                    pass
            newest = running.publisher.newest
            await until(lambda: newest["mill"].number == 20)
            await running.run_on_store(lambda store: store.execute("PRAGMA busy_timeout = 20"))
            path = tmp_path / "state" / "history.sqlite"
            with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
                other.execute("BEGIN IMMEDIATE")
                with (tmp_path / "log.csv").open("a") as file:
                    file.write("".join(lines[21:]))
                log = running.fleet.log
                await until(lambda: any(one.kind == "store-waits" for one in log.pending))
                assert newest["mill"].number == 20
                other.execute("COMMIT")
            await until(lambda: newest["mill"].number == 40)

    asyncio.run(live())
    assert len(history_in(tmp_path).numbers) == 40
    assert events_in(tmp_path, "store-waits")


def _delete(path):
    path.unlink()
    path.with_name(path.name + "-wal").unlink()


def _replace(path):
    path.with_name("other").write_bytes(b"no store " * 1000)
    path.with_name("other").replace(path)


def _damage(path):
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("DROP TABLE journal")


@pytest.mark.parametrize(("harm", "kept"), [(_delete, 40), (_replace, 40), (_damage, 20)])
def test_a_store_that_is_lost_while_the_service_runs_is_made_anew(
    model, expected, tmp_path, harm, kept
):
    """No sample counts twice or not at all; a damaged history is set aside."""
    data = file_of(model, {"kind": "csv", "path": "log.csv"})
    lines = csv_of(day(40)).splitlines(keepends=True)
    (tmp_path / "log.csv").write_text("".join(lines[:21]))
    path = tmp_path / "state" / "history.sqlite"

    async def live(before, more):
        async with serving(data, tmp_path) as running:
            newest = running.publisher.newest
            await until(lambda: newest["mill"].number == before)
            if more:
                # What came until now is in a checkpoint.
                [machine] = running.fleet.machines.values()
                await until(lambda: not machine.rows)
                first = running.store
                harm(path)
                if harm is not _damage:
                    await until(lambda: running.store is not first)
                with (tmp_path / "log.csv").open("a") as file:
                    file.write("".join(lines[21:]))
                await until(lambda: newest["mill"].number == 40)

    data["store"] = {"checkpoint_s": 0.5}
    asyncio.run(live(20, more=True))
    assert len(events_in(tmp_path, "store-recovered")) == 1
    history = history_in(tmp_path)
    # Its own new history begins with the state that it went on from.
    assert len(history.numbers) in (kept, kept + (harm is _damage))
    np.testing.assert_array_equal(
        history.columns.displacement, expected[40 - len(history.numbers) : 40]
    )
    asyncio.run(live(40, more=False))
    assert not history_in(tmp_path).gaps


def test_a_full_disk_stops_nobody(model, expected, tmp_path):
    """What is stored and published is what it would be, over a stop, too; health says how long."""
    lines = csv_of(day(40)).splitlines(keepends=True)
    log = tmp_path / "log.csv"
    log.write_text("".join(lines[:21]))
    port, found = free_port(), []

    async def live(before, after, *, full):
        async with serving(data, tmp_path) as running, httpx.AsyncClient() as client:
            newest = running.publisher.newest
            await until(lambda: newest["mill"].number == before)
            await until(lambda: running.reserve_h >= 8.0)
            if full:
                fill(disk)
            else:
                (disk / "filler").unlink()
            await until(lambda: running.disk_space.full is full)
            with log.open("a") as file:
                file.write("".join(lines[before + 1 : after + 1]))
            await until(lambda: newest["mill"].number == after)
            found.append((await client.get(f"http://127.0.0.1:{port}/healthz")).json())
            found[-1]["metrics"] = generate_latest(running.metrics.registry).decode()
            await until(lambda: not next(iter(running.fleet.machines.values())).rows)

    with mounted(tmp_path / "disk", 96) as disk:
        http = {"port": port, "security": "none", "token": secret(tmp_path, "token", 32 * "x")}
        data = file_of(model, {"kind": "csv", "path": "log.csv"}, http=http)
        data |= {"folder": "disk/state", "store": {"checkpoint_s": 0.5}}
        asyncio.run(live(20, 30, full=True))
        # What its stop gave back is gone, too.
        fill(disk)
        asyncio.run(live(30, 40, full=False))
        path = disk / "state" / "history.sqlite"
        assert_says(Archive(path).history("mill", 0.0, 1e11, 10**6), expected[:40])
        kinds = [one.kind for one in Archive(path).events("mill", 0.0, 1e11, 1000)]
    assert "store-waits" not in kinds
    assert [one["disk"] for one in found] == ["full", "ok"]
    assert found[0]["status"] == "degraded"
    assert found[0]["reserve_h"] > 7.9
    assert "thermojoint_disk_full 1.0" in found[0]["metrics"]


def test_a_service_that_is_killed_on_a_full_disk_starts_on_it(model, expected, tmp_path):
    """What it needs is in its files."""
    lines = csv_of(day(40) - np.array([START, 0, 0, 0, 0, 0])).splitlines(keepends=True)
    with mounted(tmp_path / "disk", 96) as disk:
        live_kills.prepare(disk, model, "x", INTERVAL, 1.0)
        file, log = tmp_path / "fed.csv", disk / "killed.log"
        (disk / "fed.csv").symlink_to(file)
        file.write_text("".join(lines[:11]))
        path = disk / "killed" / "history.sqlite"

        def there(count):
            with contextlib.suppress(InputError, sqlite3.OperationalError):
                last = Archive(path).latest("mill")
                return last is not None and last.number == count
            return False

        def laid_in():
            return path.exists() and path.stat().st_size > 3 * SLICE

        service = live_kills.started(disk, "killed")
        try:
            asyncio.run(until(lambda: laid_in() and there(10)))
            for count in (20, 30, 40):
                fill(disk)
                service.kill()
                service.wait()
                service = live_kills.started(disk, "killed")
                with file.open("a") as out:
                    out.write("".join(lines[count - 9 : count + 1]))
                asyncio.run(until(lambda count=count: there(count)))
            service.send_signal(signal.SIGTERM)
            assert service.wait(30.0) == 0
        finally:
            service.kill()
        history = Archive(path).history("mill", 0.0, 1e11, 10**6)
        assert_says(history, expected[:40])
        assert "store-waits" not in log.read_text()


def test_a_damaged_state_begins_its_machine_anew(model, tmp_path):
    data = file_of(model, {"kind": "csv", "path": "log.csv"})
    (tmp_path / "log.csv").write_text(csv_of(day(20)))

    async def live(count):
        async with serving(data, tmp_path) as running:
            await until(lambda: running.publisher.newest["mill"].number == count)

    asyncio.run(live(20))
    with contextlib.closing(sqlite3.connect(tmp_path / "state" / "history.sqlite")) as store:
        store.execute("UPDATE states SET state = zeroblob(length(state))")
        store.commit()
    asyncio.run(live(20))
    assert len(events_in(tmp_path, "state-refused")) == 1


def test_readings_are_taken_again_after_both_clocks_were_ahead(model, tmp_path, monkeypatch):
    monkeypatch.setattr(processing, "_UNSEEN_SET_BACK_S", 0.0)
    log, ahead, now = tmp_path / "log.csv", day(10), day(20)
    ahead[:, 0] += time.time() - START + 86400.0
    now[:, 0] += time.time() - START - 100.0
    data = file_of(model, {"kind": "csv", "path": "log.csv"})

    async def live(count, **more):
        async with serving(data | more, tmp_path) as running:
            await until(lambda: running.publisher.newest["mill"].number == count)

    log.write_text(csv_of(ahead))
    asyncio.run(live(10, ahead_s=1e6))
    log.write_text(csv_of(np.concatenate([ahead, now[:1]])))

    async def taken_again():
        async with serving(data, tmp_path) as running:
            mill = running.fleet.machines["mill"]
            await until(lambda: np.isnan(mill.state.assembly.last))
            log.write_text(csv_of(np.concatenate([ahead, now])))
            await until(lambda: running.publisher.newest["mill"].number == 29)
            assert running.publisher.newest["mill"].time == pytest.approx(now[-1, 0], abs=1.0)

    asyncio.run(taken_again())
    assert len(events_in(tmp_path, "set-back")) == 1
    asyncio.run(live(29))


def test_a_hangup_makes_the_service_read_its_file_again(model, tmp_path):
    """And a file that is wrong changes nothing."""
    live_kills.prepare(tmp_path, model, "x", INTERVAL, 60.0)
    (tmp_path / "fed.csv").write_text(csv_of(day(20) - np.array([START, 0, 0, 0, 0, 0])))
    service, file = live_kills.started(tmp_path, "killed"), tmp_path / "killed.toml"
    log, text = tmp_path / "killed.log", file.read_text()

    async def told(kind, count):
        await until(lambda: log.read_text().count(f"event={kind}") >= count)

    async def live():
        await told("ready", 1)
        file.write_text("nonsense")
        service.send_signal(signal.SIGHUP)
        await told("reload-refused", 1)
        file.write_text(text)
        service.send_signal(signal.SIGHUP)
        await told("ready", 2)

    try:
        asyncio.run(live())
        service.send_signal(signal.SIGTERM)
        assert service.wait(30.0) == 0
    finally:
        service.kill()
    assert "20 samples, 0 again" in log.read_text()


@needs_broker
def test_thirty_machines_get_through_a_broker_that_has_twenty_messages_in_flight(model, tmp_path):
    """After a pause the first sample of each machine waits for its next message."""
    rows = day(30)

    async def live(port, before, some, last):
        source = {"kind": "mqtt", "port": port, "security": "none", "topic": "plant/{machine}"}
        data = file_of(model, source)
        data["machines"]["mill"]["count"] = 30
        data["models"]["m"]["lateness_s"] = 0.75
        async with serving(data, tmp_path) as running, aiomqtt.Client("127.0.0.1", port) as plant:
            await until(lambda: len(events_in(tmp_path, "connected")) > before)
            for row in some:
                told = message(row[0], dict(zip(NAMES, row[1:].tolist(), strict=True)))
                for k in range(30):
                    await plant.publish(f"plant/mill-{k + 1}", told, qos=1)
            newest = running.publisher.newest.values()
            await until(lambda: min(one.time for one in newest) >= last)

    # A broker of its own each: once it has got acknowledgements, Mosquitto lets more be in flight.
    lives = ((rows[:1], rows[0, 0]), (rows[12:22], rows[13, 0]))
    for before, (some, last) in enumerate(lives):
        with Broker(tmp_path, "allow_anonymous true", "max_inflight_messages 20") as broker:
            asyncio.run(live(broker.port, before, some, last))
    assert events_in(tmp_path, "in-flight")


def secret(folder, name, content):
    path = folder / name
    path.write_text(content)
    path.chmod(0o600)
    return {"file": name}


@needs_broker
def test_messages_over_tls_come_once_although_broker_and_service_go_away(model, expected, tmp_path):
    """The broker keeps what nobody acknowledged, and tells the last words of the service."""
    rows, authority = day(40), own_identity(tmp_path / "authority", ())
    passwords = tmp_path / "broker"
    passwords.mkdir()
    subprocess.run(
        ["mosquitto_passwd", "-b", "-c", passwords / "users", "service", "long-and-secret"],
        check=True,
        capture_output=True,
    )
    lines = (
        f"cafile {authority.certificate}",
        f"certfile {authority.certificate}",
        f"keyfile {authority.key}",
        f"password_file {passwords / 'users'}",
        "allow_anonymous false",
        "user root",
    )
    with Broker(passwords, *lines) as broker:
        address = {
            "port": broker.port,
            "host": "localhost",
            "ca_file": str(authority.certificate),
            "user": "service",
            "password": secret(tmp_path, "password", "long-and-secret\n"),
        }
        data = file_of(model, {"kind": "mqtt", "topic": "plant/{machine}", **address}, mqtt=address)

        def client():
            return aiomqtt.Client(
                "localhost",
                broker.port,
                username="service",
                password="long-and-secret",
                tls_params=aiomqtt.TLSParameters(ca_certs=str(authority.certificate)),
            )

        async def tell(some):
            async with client() as plant:
                for row in some:
                    told = dict(zip(NAMES, row[1:].tolist(), strict=True))
                    await plant.publish("plant/mill", message(row[0], told), qos=1)

        async def first():
            async with serving(data, tmp_path) as running:
                await until(lambda: len(events_in(tmp_path, "connected")) >= 2)
                await tell(rows[:10])
                await until(lambda: running.publisher.newest["mill"].number == 10)

        async def second():
            async with serving(data, tmp_path) as running, client() as panel:
                await until(lambda: running.publisher.newest["mill"].number == 30)
                await tell(rows[25:])
                await until(lambda: running.publisher.newest["mill"].number == 40)
                await panel.subscribe("thermojoint/#")
                found = {}
                async for one in panel.messages:
                    found[str(one.topic)] = json.loads(one.payload)
                    if found.get("thermojoint/mill/displacement", {}).get("number") == 40:
                        break
                return found

        asyncio.run(first())
        # While it is away; the last five are told twice.
        asyncio.run(tell(rows[10:30]))
        found = asyncio.run(second())
    history = history_in(tmp_path)
    assert_says(history, expected[:40])
    assert not history.gaps
    last = found["thermojoint/mill/displacement"]
    assert last["displacement_um"]["x"] == pytest.approx(1e6 * expected[39, 0], abs=1e-3)
    assert found["thermojoint/service"] == {"state": "running"}


class Plc:
    """A user manager of a machine's control: one user."""

    def get_user(self, iserver, username=None, password=None, certificate=None):
        known = (username, password) == ("service", "plc-secret")
        return User(UserRole.User) if known else None


@contextlib.asynccontextmanager
async def machine_of(identity, port):
    """A server that plays a machine: encrypted, with a user, and with a history."""
    server = Server(user_manager=Plc())
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/plc")
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken])
    await server.load_certificate(identity.certificate)
    await server.load_private_key(identity.key)
    index = await server.register_namespace("urn:plc")
    nodes = [
        await server.nodes.objects.add_variable(ua.NodeId(f"mill.{name}", index), name, 0.0)
        for name in NAMES
    ]
    for node in nodes:
        await server.write_attribute_value(node.nodeid, _value(0.0, 1.0))
    async with server:
        for node in nodes:
            await server.iserver.enable_history_data_change(node, timedelta(days=3650), 10_000)

        async def play(rows, pause):
            for row in rows:
                for node, value in zip(nodes, row[1:].tolist(), strict=True):
                    await server.write_attribute_value(node.nodeid, _value(value, row[0]))
                await asyncio.sleep(pause)

        yield play


def _value(value, at):
    return ua.DataValue(
        ua.Variant(value, ua.VariantType.Double), SourceTimestamp=datetime.fromtimestamp(at, UTC)
    )


@pytest.fixture(scope="module")
def opcua_day(model, tmp_path_factory):
    """A machine at a hundred times real time, read and served by OPC UA; what clients found."""
    base = tmp_path_factory.mktemp("opcua")
    plc, port, own = own_identity(base / "plc", ()), free_port(), free_port()
    add_user(base / "users", "panel", "viewer", "panel-secret")
    add_user(base / "users", "setter", "operator", "setter-secret")
    source = {
        "kind": "opcua",
        "url": f"opc.tcp://127.0.0.1:{port}/plc",
        "node": "ns=2;s={machine}.{reading}",
        "server_certificate": "plc/certificate.pem",
        "user": "service",
        "password": secret(base, "plc-password", "plc-secret"),
        "publishing_ms": 50.0,
    }
    data = file_of(
        model,
        source,
        opcua={"port": own, "users": "users"},
        watchdog={"uncertain_s": 1.0, "bad_s": 2.5},
    )
    found = {}

    async def live():
        async with machine_of(plc, port) as play:
            async with serving(data, base) as running:
                newest = running.publisher.newest
                found["before"] = newest["mill"]
                await until(lambda: events_in(base, "connected"))
                begun = time.monotonic()
                idle = [socket.create_connection(("127.0.0.1", own)) for _ in range(60)]
                async with await client_of(base, own, "panel", "panel-secret") as panel:
                    node = panel.get_node("ns=2;s=mill.Displacement.x")
                    await play(day(60), 0.008)
                    found["wall_s"] = time.monotonic() - begun
                    await until(lambda: newest["mill"].time == START + 59.0)
                    found["fresh"] = await node.read_data_value(raise_on_bad_status=False)
                    found["unit"] = await (await node.get_child("0:EngineeringUnits")).read_value()
                    with pytest.raises(ua.UaError):
                        await panel.get_node("ns=2;s=mill.Displacement.x").write_value(1.0)
                    await until(lambda: "silent" in newest["mill"].status)
                    found["stale"] = await node.read_data_value(raise_on_bad_status=False)
                    await until(lambda: newest["mill"].quality is Quality.BAD)
                    found["silent"] = await node.read_data_value(raise_on_bad_status=False)
                for one in idle:
                    one.close()
                strangers = [("admin", ""), ("panel", "wrong"), ("nobody", "panel-secret")]
                found["refused"] = [
                    await _let_in(await client_of(base, own, *who))
                    for who in (*strangers, (None, None))
                ]
                found["plain"] = await _let_in(Client(f"opc.tcp://127.0.0.1:{own}/thermojoint"))
            # Nobody listens meanwhile; the machine's own history has it.
            await play(day()[60:100], 0.02)
            data.pop("opcua")
            async with serving(data, base) as running:
                newest = running.publisher.newest
                await until(lambda: newest["mill"].time == START + 99.0)
                await play(day()[100:], 0.002)
                await until(lambda: newest["mill"].time == START + 119.0)

    asyncio.run(live())
    return base, found


async def _let_in(client):
    try:
        async with client:
            return True
    except ua.UaError:
        return False


def test_a_machine_that_tells_opcua_is_estimated_sample_by_sample(opcua_day, expected):
    base, _ = opcua_day
    history = history_in(base)
    # The first value is what the machine said before it ran.
    times = history.columns.times[-120:]
    np.testing.assert_array_equal(times, START + np.arange(120.0))
    assert history.columns.displacement.shape[0] in (120, 121)


def test_what_came_while_the_service_was_away_is_read_from_the_machines_history(opcua_day):
    base, _ = opcua_day
    assert not [one for one in history_in(base).gaps if one.since >= START]


class Late(HistoryDict):
    """It stores a value after half a second."""

    async def save_node_value(self, node_id, datavalue):
        await asyncio.sleep(0.5)
        await super().save_node_value(node_id, datavalue)


async def server_of_one_variable(port):
    """A server, not started yet, and the node of its variable T."""
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
    return server, await server.nodes.objects.add_variable(ua.NodeId("T", 2), "T", 0.0)


@pytest.mark.parametrize("storage", [Late(), HistoryDict(max_history_data_response_size=2)])
def test_a_history_is_read_to_its_end_also_if_it_is_stored_late_or_comes_in_parts(storage):
    async def live():
        port, found = free_port(), []
        server, node = await server_of_one_variable(port)
        server.iserver.history_manager.set_storage(storage)
        await server.write_attribute_value(node.nodeid, _value(0.0, START))
        async with server:
            await server.iserver.enable_history_data_change(node, timedelta(days=3650), 10_000)
            for k in range(1, 6):
                await server.write_attribute_value(node.nodeid, _value(float(k), START + k))
            endpoint = Endpoint(f"opc.tcp://127.0.0.1:{port}", None, None, None, None)
            reader = OpcuaReader(endpoint, {"ns=2;s=T": ("mill", (0,))}, {"mill": 1}, 100, 50.0)
            async with contextlib.aclosing(reader.read({"mill": START})) as arrivals:
                async for some in arrivals:
                    found += [one.time for one in some if isinstance(one, Arrival)]
                    if START + 5.0 in found:
                        break
        assert sorted(set(found)) == [START + k for k in range(1, 6)]

    asyncio.run(live())


def test_one_time_in_the_future_leaves_no_value_out_after_a_lost_connection(monkeypatch):
    monkeypatch.setattr(opcua, "_ALIVE_S", 0.2)

    async def live():
        port, found = free_port(), []
        server, node = await server_of_one_variable(port)

        async def write(time):
            await server.write_attribute_value(node.nodeid, _value(time - START, time))

        async def told(arrivals, time):
            while time not in found:
                found.extend(one.time for one in await anext(arrivals) if isinstance(one, Arrival))

        await write(START + 1e7)
        async with server:
            await server.iserver.enable_history_data_change(node, timedelta(days=3650), 10_000)
            endpoint = Endpoint(f"opc.tcp://127.0.0.1:{port}", None, None, None, None)
            reader = OpcuaReader(endpoint, {"ns=2;s=T": ("mill", (0,))}, {"mill": 1}, 100, 50.0)
            async with contextlib.aclosing(reader.read({})) as arrivals:
                await told(arrivals, START + 1e7)
                await write(START)
                await told(arrivals, START)
                subscriptions = server.iserver.subscription_service
                # The other one is that of the history.
                await subscriptions.delete_subscriptions([max(subscriptions.subscriptions)])
                for k in (1, 2, 3):
                    await write(START + k)
                await told(arrivals, START + 3.0)
        assert {START + 1.0, START + 2.0} <= {*found}

    asyncio.run(asyncio.wait_for(live(), 15.0))


def test_a_subscription_that_its_server_has_ended_is_made_anew(monkeypatch):
    """As after a pause of the computer, longer than the subscription lives without requests."""
    monkeypatch.setattr(opcua, "_ALIVE_S", 0.2)

    async def live():
        port, found = free_port(), []
        server, node = await server_of_one_variable(port)
        await server.write_attribute_value(node.nodeid, _value(0.0, START))
        async with server:
            endpoint = Endpoint(f"opc.tcp://127.0.0.1:{port}", None, None, None, None)
            reader = OpcuaReader(endpoint, {"ns=2;s=T": ("mill", (0,))}, {"mill": 1}, 100, 50.0)
            async with contextlib.aclosing(reader.read({})) as arrivals:
                async for some in arrivals:
                    found += [one.time for one in some if isinstance(one, Arrival)]
                    if START + 1.0 in found:
                        break
                    if START in found:
                        subscriptions = server.iserver.subscription_service
                        await subscriptions.delete_subscriptions([*subscriptions.subscriptions])
                        await server.write_attribute_value(node.nodeid, _value(1.0, START + 1.0))

    asyncio.run(asyncio.wait_for(live(), 15.0))


def test_values_carry_the_time_of_their_sample_and_opcuas_own_status(opcua_day):
    _, found = opcua_day
    assert found["before"].quality is Quality.BAD
    assert found["fresh"].SourceTimestamp.timestamp() == START + 59.0
    assert not found["fresh"].StatusCode.is_bad()
    assert found["stale"].StatusCode.name == "UncertainLastUsableValue"
    assert found["stale"].Value.Value == found["fresh"].Value.Value
    assert found["silent"].StatusCode.name == "BadNoCommunication"
    assert found["silent"].Value.Value is None
    assert (found["unit"].DisplayName.Text, found["unit"].UnitId) == ("µm", 0x3448)


def test_nobody_gets_in_without_a_password_that_is_known(opcua_day):
    _, found = opcua_day
    assert found["refused"] == [False] * 4
    assert found["plain"] is False


def test_no_secret_stands_in_the_store(opcua_day):
    base, _ = opcua_day
    for path in (base / "state").rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            assert b"panel-secret" not in content
            assert b"plc-secret" not in content


def test_an_opcua_server_without_users_is_refused(model, tmp_path):
    source = {"kind": "csv", "path": "log.csv"}
    data = file_of(model, source, opcua={"port": free_port()})

    async def live():
        async with serving(data, tmp_path):
            pass

    with pytest.raises(InputError, match="no one could log in"):
        asyncio.run(live())


def test_a_service_killed_at_random_moments_says_what_one_says_that_never_was(model, tmp_path):
    rows = day(1200) - np.array([START, 0.0, 0.0, 0.0, 0.0, 0.0])
    lines = csv_of(rows).splitlines(keepends=True)
    (tmp_path / "day.csv").write_text("".join(lines))
    live_kills.prepare(tmp_path, model, "x", INTERVAL, 0.2)
    assert live_kills.kill_through(tmp_path, lines, 3, random.Random(3), 0.0, 0.6) == 3
    killed = live_kills.finish(tmp_path, "killed", 1200, 60.0)

    async def undisturbed():
        service = read_service(tmp_path / "whole.toml")
        await run(service, asyncio.Event())

    asyncio.run(undisturbed())
    whole = Archive(tmp_path / "whole" / "history.sqlite").history("mill", 0.0, 1e11, 10**6)
    assert len(whole.numbers) == 1200
    assert live_kills.differences(whole, killed) == []
