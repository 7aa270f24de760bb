"""MTConnect: a played agent's values become samples, whatever happens between."""

import asyncio
import math
import ssl

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_parts import estimated, events_in, free_port, history_in, serving, until
from played_agent import NONE, Agent
from warming_machine import started

from thermojoint.artefacts.errors import InputError
from thermojoint.live import reconnecting
from thermojoint.live.archive import Archive
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.certificates import own_identity
from thermojoint.live.http_session import UnusableError, address_of
from thermojoint.live.mtconnect_documents import (
    Header,
    Item,
    Observation,
    Streams,
    conversion,
    converted,
    document_of,
)
from thermojoint.live.readers import mtconnect
from thermojoint.live.readers.mtconnect import Held, ItemMapping, MtconnectReader, at_instants
from thermojoint.live.settings import service_from_data

NAMES = ("a_degC", "b_degC", "T1_degC", "T2_degC", "ambient_degC")
UNITS = dict.fromkeys(NAMES, 'units="CELSIUS"')
START = 1_772_431_200.0
MAPPING = ItemMapping("mill", ("T1_degC", "x_um"), ("T1_degC", "x_um"), 1, 1.0)


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    monkeypatch.setattr(reconnecting, "FIRST_S", 0.02)


def day(count=120):
    """A warm-up by sensors that tell a tenth of a degree: most values stay for many seconds."""
    rise = 1.0 - np.exp(-np.arange(count) / 60.0)
    columns = (20.0 + 6.0 * rise, 20.0 + 0.5 * rise, 20.0 + rise, 20.0 + 3.0 * rise, 20.0 + rise)
    return np.round(np.column_stack(columns), 1)


def file_of(model, port, **source):
    return {
        "folder": "state",
        "models": {"m": {"file": str(model), "interval_s": 1.0, "lateness_s": 0.0}},
        "machines": {"mill": {"model": "m", "source": "agent"}},
        "sources": {"agent": {"kind": "mtconnect", "url": f"http://127.0.0.1:{port}", **source}},
        "behind_s": 1e9,
    }


def told(row):
    return dict(zip(NAMES, row.tolist(), strict=True))


async def tell(agent, readings, steps):
    for k in steps:
        await agent.tell(START + k, told(readings[k]))


def tls(folder):
    own = own_identity(folder, ())
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(own.certificate, own.key)
    return context, str(own.certificate)


@pytest.mark.parametrize("version", ["1.3", "2.4"])
def test_every_sample_is_there_once_although_agent_and_service_go_away(model, version, tmp_path):
    """Lost connections, a stopped service and a replayed buffer change no estimate."""
    readings = day()
    context, certificate = tls(tmp_path)

    async def live():
        agent = Agent(free_port(), UNITS, version)
        await agent.begin(context)
        url = f"https://localhost:{agent.port}"
        data = file_of(model, agent.port, url=url, ca_file=certificate)
        await agent.tell(START, told(readings[0]))
        async with serving(data, tmp_path) as running:
            newest = running.publisher.newest
            await until(lambda: newest["mill"].number == 1)
            await tell(agent, readings, range(1, 40))
            await until(lambda: newest["mill"].number == 40)
            await agent.end()
            await tell(agent, readings, range(40, 70))
            await agent.begin(context)
            await until(lambda: newest["mill"].number == 70)
        await tell(agent, readings, range(70, 100))
        async with serving(data, tmp_path) as running:
            await until(lambda: running.publisher.newest["mill"].number == 100)
            await tell(agent, readings, range(100, 120))
            await until(lambda: running.publisher.newest["mill"].number == 120)
        await agent.end()
        return agent.asked

    asked = asyncio.run(live())
    history = history_in(tmp_path)
    assert not history.gaps
    times = START + np.arange(120.0)
    np.testing.assert_array_equal(history.columns.times, times)
    expected = estimated(model, np.column_stack([times, readings]))
    np.testing.assert_allclose(history.columns.displacement, expected, rtol=1e-12, atol=1e-18)
    # The state is asked for once: after that every observation is read on from the last.
    assert sum("/current" in one for one in asked) == 1
    assert events_in(tmp_path, "connected")
    assert events_in(tmp_path, "disconnected")


def test_a_service_that_is_killed_reads_the_agents_buffer_on(model, tmp_path):
    readings = day(300)

    async def live():
        agent = await Agent(free_port(), UNITS, size=10_000).begin()
        await agent.tell(START, told(readings[0]))
        (tmp_path / "service.toml").write_text(
            f'folder = "state"\nbehind_s = 1e9\n[models.m]\nfile = "{model}"\nlateness_s = 0.0\n'
            '[machines.mill]\nmodel = "m"\nsource = "agent"\n'
            f'[sources.agent]\nkind = "mtconnect"\nurl = "http://127.0.0.1:{agent.port}"\n'
        )

        path, lives = tmp_path / "state" / "history.sqlite", [(1, 80), (80, 160), (160, 300)]
        for first, last in lives:
            service, before = started(tmp_path), len(agent.asked)
            await until(lambda before=before: any("/sample" in one for one in agent.asked[before:]))
            for k in range(first, last):
                await agent.tell(START + k, told(readings[k]))
                await asyncio.sleep(0.005)
            if last == 300:
                await until(lambda: Archive(path).latest("mill").time == START + 299.0)
            service.kill()
            service.wait()
        await agent.end()

    asyncio.run(live())
    history = history_in(tmp_path)
    assert not history.gaps
    np.testing.assert_array_equal(history.columns.times, START + np.arange(300.0))
    np.testing.assert_array_equal(history.columns.readings, readings)


@pytest.mark.parametrize("cause", ["restart", "overrun"])
def test_what_an_agent_has_lost_is_a_hole_and_the_values_of_now_go_on(model, cause, tmp_path):
    readings = day()

    async def live():
        agent = await Agent(free_port(), UNITS, size=8).begin()
        await agent.tell(START, told(readings[0]))
        async with serving(file_of(model, agent.port), tmp_path) as running:
            newest = running.publisher.newest
            await until(lambda: newest["mill"].number == 1)
            await agent.end()
            await tell(agent, readings, range(1, 60))
            if cause == "restart":
                await agent.restart()
            else:
                await agent.begin()
            await agent.tell(START + 60, told(readings[60]))
            await agent.tell(START + 61, told(readings[61]))
            await until(lambda: newest["mill"].time == START + 61)
            found = newest["mill"].readings
        await agent.end()
        return found

    np.testing.assert_array_equal(asyncio.run(live()), readings[61])
    [hole] = history_in(tmp_path).gaps
    assert hole.since == START
    assert bool(events_in(tmp_path, "overrun")) == (cause == "overrun")


def test_an_agent_without_streams_is_asked_again_and_again(model, tmp_path):
    readings = day(10)

    async def live():
        agent = await Agent(free_port(), UNITS, streams=False).begin()
        await agent.tell(START, told(readings[0]))
        data = file_of(model, agent.port)
        data["models"]["m"]["interval_s"] = 0.01
        async with serving(data, tmp_path) as running:
            await until(lambda: running.publisher.newest["mill"].number == 1)
            for k in range(1, 10):
                await agent.tell(START + k / 100, told(readings[k]))
            await until(lambda: running.publisher.newest["mill"].number == 10)
            found = running.publisher.newest["mill"].readings
        await agent.end()
        return found

    np.testing.assert_array_equal(asyncio.run(live()), readings[9])


def reader_of(port, units, **more):
    names = tuple(more.pop("names", units))
    mapping = ItemMapping("M-1", names, tuple(f"{name}_name" for name in names), len(names), 1.0)
    address = address_of(f"http://127.0.0.1:{port}", None, "source")
    return MtconnectReader(
        "agent", address, {"mill": mapping}, more.get("unchanged", math.inf), 60.0
    )


def arrivals_of(units, steps, **more):
    """What a reader makes of some steps of an agent; `steps` are (time, values)."""

    async def live():
        agent = await Agent(free_port(), units).begin()
        await agent.tell(*steps[0])
        found, blocks = [], reader_of(agent.port, units, **more).read({})
        for k, step in enumerate(steps):
            if k:
                await agent.tell(*step)
            block = []
            while not any(isinstance(one, Arrival) for one in block):
                block = await anext(blocks)
                found += block
        await blocks.aclose()
        await agent.end()
        return found

    found = asyncio.run(asyncio.wait_for(live(), 60.0))
    return [one for one in found if isinstance(one, Arrival)], [
        one for one in found if isinstance(one, Note)
    ]


def test_motor_currents_load_and_speeds_come_in_the_units_of_the_readings():
    units = {
        "I_A": 'units="AMPERE"',
        "load_percent": 'units="PERCENT"',
        "n_rpm": 'units="REVOLUTION/MINUTE" nativeUnits="REVOLUTION/SECOND"',
        "M_Nm": 'units="NEWTON_METER"',
        "T_degF": 'units="CELSIUS"',
        "x_um": 'units="MILLIMETER"',
        "feed_mm_min": 'units="MILLIMETER/SECOND"',
        "C_rpm": 'units="DEGREE/SECOND"',
    }
    values = {"I_A": 12.5, "load_percent": 40, "n_rpm": 6e3, "M_Nm": 3, "T_degF": 20, "x_um": 0.01}
    values |= {"feed_mm_min": 50.0, "C_rpm": 90.0}
    [arrival], notes = arrivals_of(units, [(START, values)])
    assert arrival.readings == pytest.approx(
        [12.5, 40.0, 6000.0, 3.0, 68.0, 10.0, 3000.0, 15.0], rel=1e-12
    )
    assert [one.kind for one in notes] == ["connected"]


def test_a_value_holds_until_the_next_unless_it_is_unavailable_or_too_old():
    steps = [
        (START, {"T1_degC": 20.0, "T2_degC": 21.0}),
        (START + 1, {"T2_degC": NONE}),
        (START + 2, {"T2_degC": 22.0}),
        (START + 3, {"T2_degC": "22,5"}),
        (START + 4, {"T2_degC": 23.0}),
    ]
    arrivals, notes = arrivals_of(dict.fromkeys(NAMES[2:4], 'units="CELSIUS"'), steps)
    expected = [[20.0, 21.0], [20.0, math.nan], [20.0, 22.0], [20.0, math.nan], [20.0, 23.0]]
    np.testing.assert_array_equal([one.readings for one in arrivals], expected)
    assert "'22,5' is not a number" in next(one.text for one in notes if one.kind == "malformed")
    arrivals, _ = arrivals_of(
        dict.fromkeys(NAMES[2:4], 'units="CELSIUS"'), [steps[0], *steps[2:3]], unchanged=1.0
    )
    np.testing.assert_array_equal([one.readings[0] for one in arrivals], [20.0, 20.0, math.nan])


@pytest.mark.parametrize(
    ("unit", "reading", "said"),
    [
        ('units="PERCENT"', "T1_degC", "in PERCENT, which is not T1_degC"),
        ('units="CELSIUS"', "T1_K", "in CELSIUS, which is not T1_K"),
        ("", "T1_degC", "in no unit"),
        ('units="CELSIUS" representation="TIME_SERIES"', "T1_degC", "several values"),
    ],
)
def test_a_data_item_of_another_quantity_is_not_read(unit, reading, said):
    units = {reading: unit, "T2_degC": 'units="CELSIUS"'}
    [arrival], notes = arrivals_of(units, [(START, {"T2_degC": 21.0})])
    np.testing.assert_array_equal(arrival.readings, [math.nan, 21.0])
    assert said in next(one.text for one in notes if one.kind == "unreadable")


def test_a_clock_that_is_set_closes_no_sample_and_loses_no_value():
    """The rules of all sources refuse such times; what was observed meanwhile counts later."""
    units = {"T1_degC": 'units="CELSIUS"'}
    back = [(START, {"T1_degC": 20.0}), (START - 500, {"T1_degC": 21.0}), (START + 1, {})]
    arrivals, _ = arrivals_of(units, back)
    assert [one.time - START for one in arrivals] == [0.0, -500.0, 1.0]
    assert [one.readings for one in arrivals[::2]] == [[20.0], [21.0]]
    # A clock that nobody had set yet: the decades between are a gap.
    early = [(10.0, {"T1_degC": 20.0}), (START, {"T1_degC": 21.0}), (START + 1, {})]
    arrivals, _ = arrivals_of(units, early)
    found = [(one.time, *one.readings) for one in arrivals]
    assert found == [(10.0, 20.0), (START, 21.0), (START + 1, 21.0)]
    late = [(9e9, {"T1_degC": 20.0}), (START, {"T1_degC": 21.0}), (START + 1, {})]
    arrivals, _ = arrivals_of(units, late)
    assert [one.time for one in arrivals] == [9e9, START, START + 1]
    ahead = [(START, {"T1_degC": 20.0}), (9e9, {"T1_degC": 21.0}), (START + 1, {})]
    arrivals, _ = arrivals_of(units, ahead)
    assert [one.time for one in arrivals] == [START, 9e9, START + 1]
    assert arrivals[-1].readings == [21.0]


def test_an_adapter_whose_clock_differs_is_read_by_the_clock_of_the_agent():
    units = {"T1_degC": 'units="CELSIUS"'}
    for off in (-3600.0, 3600.0):
        steps = [(START + k, {"T1_degC": 20.0 + k}, {"T1_degC": START + k + off}) for k in range(4)]
        arrivals, _ = arrivals_of(units, steps)
        found = [(one.time - START, *one.readings) for one in arrivals]
        assert found == [(k, 20.0 + k) for k in range(4)]


@given(
    gaps=st.lists(st.floats(0.01, 3.0), min_size=1, max_size=30),
    cuts=st.sets(st.integers(0, 29)),
    count=st.integers(1, 5),
)
def test_instants_have_what_was_last_observed_however_documents_are_cut(gaps, cuts, count):
    times = START + np.cumsum(gaps)
    rows = [Observation(str(k % 2), k + 1, time, float(k)) for k, time in enumerate(times)]
    held = Held(1, 1, START, 0, (math.nan, math.nan), (START, START))
    mapping = MAPPING._replace(wanted=2)
    found, first, last = [], 0, len(rows)
    for k, row in enumerate(rows):
        if k not in cuts and k + 1 < last:
            continue
        # What is longer than a document may be comes as several, of which the last is of now.
        pieces = [rows[one : min(one + count, k + 1)] for one in range(first, k + 1, count)]
        for piece in pieces:
            header = Header(1, row.time, 100, piece[-1].sequence + 1, k + 1)
            *instants, (held, _) = at_instants(mapping, held, Streams(header, tuple(piece)))
            found += [(instant, one.values) for one, instant in instants]
        first = k + 1
    assert [instant for instant, _ in found] == [
        START + k for k in range(math.floor(times[-1] - START) + 1)
    ]
    for instant, values in found:
        for k in (0, 1):
            before = [one.value for one in rows[k::2] if one.time <= instant]
            np.testing.assert_array_equal(values[k], before[-1] if before else math.nan)


def test_an_occasional_reading_counts_once():
    header = Header(1, START + 2.0, 100, 3, 2)
    held = Held(1, 1, START, 0, (20.0, math.nan), (START, START))
    rows = (Observation("1", 1, START + 0.5, 7.0), Observation("0", 2, START + 1.5, 21.0))
    found = [
        mtconnect.arrival_of("mill", MAPPING, one, instant, math.inf).readings
        for one, instant in at_instants(MAPPING, held, Streams(header, rows))
        if instant is not None
    ]
    assert found == [[20.0, None], [20.0, 7.0], [21.0, None]]


def test_a_position_of_other_readings_or_of_another_device_is_not_used():
    held = Held(1, 7, START, 3, (20.0, math.nan), (START, START))
    position = mtconnect.arrival_of("mill", MAPPING, held, START + 2.0, math.inf).position
    again = mtconnect.held_of(position, MAPPING)
    assert (again.instance, again.next, again.due(MAPPING)) == (1, 7, START + 3.0)
    for other in (
        MAPPING._replace(device="x"),
        MAPPING._replace(items=("T2", "x_um")),
        # The values are in the units of the readings, which another model may have in others.
        MAPPING._replace(readings=("T1_K", "x_um")),
    ):
        assert mtconnect.held_of(position, other) is None
    for damaged in (None, 5, "x", [1, 2], [*position[:-1], [["a", "a", "b", 1.0]] * 2]):
        assert mtconnect.held_of(damaged, MAPPING) is None


BOMB = (
    b'<!DOCTYPE a [<!ENTITY b "x">]><MTConnectStreams '
    b'xmlns="urn:mtconnect.org:MTConnectStreams:1.4">&b;</MTConnectStreams>'
)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (BOMB, "document type"),
        (b"<html/>", "another kind"),
        (b"{}", "no XML"),
        (b'<MTConnectStreams xmlns="urn:mtconnect.org:MTConnectStreams:1.2"/>', "version 1.2"),
        (b'<MTConnectStreams xmlns="urn:mtconnect.org:MTConnectStreams:2.0"/>', "no header|header"),
        (b"<a>" * 500_000, "no XML"),
        (b"<a>" * 100_000 + b"</a>" * 100_000, "another kind"),
    ],
)
def test_what_is_no_document_of_an_agent_is_refused(content, said):
    with pytest.raises(UnusableError, match=said):
        document_of(content, {"a"})


@given(st.binary(max_size=200))
def test_any_bytes_are_a_document_or_refused(content):
    agent = Agent(0, UNITS)
    for whole in (agent.probe(), agent.sample(1, 5, UNITS)[0]):
        for damaged in (content, whole[: len(content) * 7], whole.replace(b"Z", content[:1])):
            try:
                document_of(damaged, UNITS)
            except UnusableError as error:
                assert len(str(error)) < 300  # noqa: PT017


@given(st.floats(-1e6, 1e6))
def test_a_conversion_is_that_of_the_tables(value):
    place = conversion(Item("n", "REVOLUTION/MINUTE", True), "n_rad_s")
    assert converted(place, value) == pytest.approx(value * math.pi / 30.0, rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ({"url": "http://agent.example:5000"}, "http:// at agent.example, which others reach"),
        ({"url": "http://127.0.0.1@agent.example"}, "is none; give https://HOST:PORT"),
        ({"url": "agent:5000"}, "is none; give https://HOST:PORT"),
    ],
)
def test_an_agent_that_others_could_play_is_refused(model, source, said, tmp_path):
    with pytest.raises(InputError, match=said):
        service_from_data(file_of(model, 1, **source), "service.toml", tmp_path)


def test_machines_of_one_agent_are_devices_of_their_own(model, tmp_path):
    data = file_of(model, 1, device="mill")
    data["machines"]["mill"]["count"] = 2
    with pytest.raises(InputError, match="device: feeds 2 machines"):
        service_from_data(data, "service.toml", tmp_path)
