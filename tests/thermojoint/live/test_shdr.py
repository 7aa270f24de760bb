"""SHDR: an agent's socket gets what the service publishes, and is limited as every reader is."""

import asyncio
import contextlib
import math
import re
import socket
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from dashboard_server import LAYOUT, publication
from hypothesis import given
from hypothesis import strategies as st
from live_parts import until
from repository import ROOT

from estimator.quality import Quality
from thermojoint.artefacts.errors import InputError
from thermojoint.live.limited_socket import listening
from thermojoint.live.publisher import Publisher
from thermojoint.live.settings import service_from_data
from thermojoint.live.writers import shdr

AT = 1_772_431_200.0
STAMP = "2026-03-02T06:00:00.000000Z"


@contextlib.asynccontextmanager
async def adapter(publisher, heartbeat=10.0, most=8):
    """The adapter at a port of its own."""
    taken = listening("shdr", "127.0.0.1", 0, most, most)
    task = asyncio.create_task(shdr.serve_agents(publisher, taken, heartbeat))
    try:
        yield taken.getsockname()[1]
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def read_until(reader, said):
    lines = []
    async with asyncio.timeout(60.0):
        while not any(said in line for line in lines):
            lines.append((await reader.readline()).decode())
            assert lines[-1], "disconnected"
    return lines


def hub_of(*publications):
    publisher = Publisher()
    publisher.publish(publications)
    return publisher


def test_an_agent_gets_every_value_and_an_answer_to_its_heartbeat():
    none = {"published": AT, "quality": Quality.BAD, "status": "no-sample"}
    publisher = hub_of(publication(3, AT), publication(0, math.nan, "mill-2", **none))

    async def live():
        async with adapter(publisher) as port:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            found = [await reader.readline() for _ in range(6)]
            writer.write(b"* PING\r\n")
            pong = await read_until(reader, "PONG")
            publisher.publish([publication(4, AT + 1.0)])
            later = await read_until(reader, "mill-1:thermal")
            writer.close()
        return {line.decode() for line in found}, pong, later

    found, pong, later = asyncio.run(live())
    assert (
        f"{STAMP}|mill-1:x_displacement|0.0030000|mill-1:y_displacement|-0.0020000"
        "|mill-1:x_band|0.0001000|mill-1:y_band|UNAVAILABLE\n"
    ) in found
    assert f"{STAMP}|mill-1:thermal_displacement|NORMAL||||\n" in found
    assert any("mill-2:x_displacement|UNAVAILABLE" in line for line in found)
    assert f"{STAMP}|mill-2:thermal_displacement|UNAVAILABLE||||\n" in found
    assert pong == ["* PONG 10000\n"]
    assert later[0].startswith("2026-03-02T06:00:01.000000Z|mill-1:x_displacement|0.0040000")


def test_what_is_bad_is_unavailable_from_now_and_the_offset_is_the_one_that_acts():
    bad = publication(
        3, AT, published=AT + 60.0, quality=Quality.BAD, status="silent", offset_mode="decay"
    )
    values, offsets, condition = shdr.lines_of(bad)
    now = "2026-03-02T06:01:00.000000Z"
    assert values.startswith(f"{now}|mill-1:x_displacement|UNAVAILABLE|mill-1:y_displacement|UNA")
    assert offsets == f"{now}|mill-1:X_offset|-0.0030000|mill-1:offset_mode|DECAY\n"
    assert condition == f"{now}|mill-1:thermal_displacement|FAULT||||silent\n"


@given(st.text(max_size=80), st.sampled_from(Quality))
def test_whatever_a_status_says_a_line_keeps_its_fields(status, quality):
    said = publication(1, AT, status=status, quality=quality)
    for line in shdr.lines_of(said):
        assert line.count("\n") == 1
        assert line.endswith("\n")
    assert line.count("|") == 6


def test_a_reader_that_takes_nothing_is_disconnected_and_the_others_go_on(monkeypatch):
    monkeypatch.setattr(shdr, "READER_S", 0.2)
    layout = replace(LAYOUT, axes=tuple(f"axis{k}" for k in range(2000)))
    many = {"layout": layout, "displacement": [1.0] * 2000, "band": [1.0] * 2000}
    publisher = hub_of(publication(1, AT, **many))

    async def live():
        async with adapter(publisher) as port:
            slow = socket.socket()
            slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            slow.connect(("127.0.0.1", port))
            reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 20)
            await read_until(reader, "thermal")
            number = 1

            async def publish():
                nonlocal number
                while True:
                    number += 1
                    publisher.publish([publication(number, AT + number, **many)])
                    await asyncio.sleep(0.005)

            publishing = asyncio.create_task(publish())
            drained = asyncio.create_task(reader.read())
            await until(lambda: len(publisher._subscriptions) == 1)
            publishing.cancel()
            assert not drained.done()
            drained.cancel()
            writer.close()
            slow.close()

    asyncio.run(live())


def test_connections_are_limited_and_an_agent_that_asks_no_longer_is_gone(monkeypatch):
    monkeypatch.setattr(shdr, "_MISSED", 0.2)
    publisher = hub_of(publication(1, AT))

    async def live():
        async with adapter(publisher, heartbeat=1.0, most=2) as port:
            opened = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
            for reader, _ in opened:
                await read_until(reader, "thermal")
            third, _ = await asyncio.open_connection("127.0.0.1", port)
            with contextlib.suppress(ConnectionError):
                assert await third.read() == b""
            # One has asked, the other never did.
            opened[0][1].write(b"* PING\n")
            await read_until(opened[0][0], "PONG")
            with contextlib.suppress(ConnectionError):
                assert await opened[0][0].read() == b""
            opened[1][1].write(b"x" * 5000 + b"\n")
            with contextlib.suppress(ConnectionError):
                assert await opened[1][0].read() == b""
            await until(lambda: not publisher._subscriptions)

    asyncio.run(live())


def test_an_adapter_that_others_reach_is_refused(tmp_path):
    data = {
        "folder": "state",
        "models": {"m": {"file": "m.json"}},
        "machines": {"mill": {"model": "m", "source": "log"}},
        "sources": {"log": {"kind": "csv", "path": "log.csv"}},
        "shdr": {"address": "0.0.0.0"},
    }
    with pytest.raises(InputError, match=r"shdr.address: 0\.0\.0\.0, which others"):
        service_from_data(data, "service.toml", tmp_path)


def test_the_device_of_the_page_has_the_items_of_the_adapter():
    page = (ROOT / "docs" / "mtconnect.md").read_text("utf-8")
    device = ElementTree.fromstring(re.search(r"```xml\n(.*?)```", page, re.S)[1])
    named = {one.get("name") for one in device.iter("DataItem")}
    layout = replace(LAYOUT, axes=("x",), controls=("X",))
    told = "".join(shdr.lines_of(publication(1, AT, layout=layout)))
    assert named == set(re.findall(r"mill-1:(\w+)", told))
