"""The handshake with a control: no offset follows, or is good, without its word."""

import asyncio
import itertools
import json
import math
from dataclasses import replace

import aiomqtt
import numpy as np
import pytest
from asyncua import ua
from live_parts import Broker, client_of, free_port, needs_broker, serving, until
from pydantic import ValidationError

from benchmarks import offset_invariant
from thermojoint.compensation.offsets.handshake import (
    DIFFERS,
    DISABLED,
    SILENT,
    STANDS,
    Answer,
    HandshakeSettings,
    answered,
    begun,
    continued_from,
    judged,
    sent,
)
from thermojoint.live import processing
from thermojoint.live.arrivals import Arrival
from thermojoint.live.cancelling import cancelled
from thermojoint.live.control_message import answer_of
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import initial_state
from thermojoint.live.metrics import fresh_metrics
from thermojoint.live.processing import Fleet, Machine
from thermojoint.live.publication import AxisLine, Layout
from thermojoint.live.settings import WatchdogSection
from thermojoint.live.users import add_user
from thermojoint.live.writers import opcua_control

LIMITS = HandshakeSettings(oldest=5.0, differs=1e-6, differs_time=4.0)
START = offset_invariant.START


def shaken(answers, settings=LIMITS, offset=20e-6):
    """States after (time, enabled, heartbeat, acknowledged in um), each looked at then."""
    found, states = begun(np.array([offset]), 0.0), []
    for time, *said in answers:
        if said:
            enabled, heartbeat, acknowledged = said
            found = answered(found, Answer(enabled, heartbeat, (1e-6 * acknowledged,)), time)
        found = judged(settings, found, time)
        states.append(found.state)
    return states


def test_it_stands_while_the_control_enables_counts_on_and_takes_over():
    assert shaken([(k, True, k, 20.0) for k in range(4)]) == [SILENT, STANDS, STANDS, STANDS]


@pytest.mark.parametrize(
    ("answers", "state"),
    [
        ([(k, True, 7, 20.0) for k in range(4)], SILENT),
        ([(k, False, k, 20.0) for k in range(4)], DISABLED),
        ([(0, True, 0, 20.0), (1, True, 1, 20.0), (6,)], STANDS),
        ([(0, True, 0, 20.0), (1, True, 1, 20.0), (6.1,)], SILENT),
        # It never was sent that; and it says nothing at all.
        ([(k, True, k, 35.0) for k in range(4)], DIFFERS),
        ([(k, True, k, math.nan) for k in range(4)], DIFFERS),
        # Wrong for a moment; wrong for too long.
        ([(k, True, k, 20.0 if k < 3 else 10.0) for k in range(7)], STANDS),
        ([(k, True, k, 20.0 if k < 3 else 10.0) for k in range(8)], DIFFERS),
    ],
)
def test_every_break_has_its_word(answers, state):
    assert shaken(answers)[-1] == state


def test_a_control_that_lags_behind_a_moving_offset_has_taken_it_over():
    """And without a limit nothing need be acknowledged."""
    found = begun(np.zeros(1), 0.0)
    for k in range(60):
        said = Answer(True, k, (5e-6 * max(0, k - 3),))
        found = judged(LIMITS, answered(found, said, k), k)
        found = sent(LIMITS, found, np.array([5e-6 * k]), k)
    assert found.state == STANDS
    # Only what is recent is remembered.
    assert len(found.sent) < 8
    silent = [(k, True, k, math.nan) for k in range(4)]
    assert shaken(silent, replace(LIMITS, differs=math.inf))[-1] == STANDS


@pytest.mark.parametrize(("has", "begins"), [(20.0, 20.0), (0.0, 0.0), (7.3, 7.3), (20.8, 20.0)])
def test_a_control_that_returns_goes_on_from_what_it_has(has, begins):
    """Between what it was sent and zero, that is; further away it has to come by itself."""
    away = begun(np.array([20e-6]), 0.0)
    for k in range(2):
        away = judged(LIMITS, answered(away, Answer(True, k), k), k)
    assert away.state == DIFFERS
    back = judged(LIMITS, answered(away, Answer(acknowledged=(1e-6 * has,)), 2.0), 2.0)
    assert continued_from(away, back, LIMITS) == pytest.approx([1e-6 * begins])
    # Once: after that it moves as it is sent.
    assert continued_from(back, judged(LIMITS, back, 3.0), LIMITS) is None


def begun_with(**given):
    """A sequence with a handshake, whose offsets follow and decay at once.

    Each publication is held against what the control received last.
    """
    at_once = dict.fromkeys(("dead_band_um", "filter_s", "freeze_s", "recover_s"), 0.0)
    usual = {"resolution_um": 0.1, "rate_um_s": 0.05, "oldest_s": 3.0, "decay_s": 5.0}
    found = offset_invariant.Offsets()
    found.begin(offset_invariant.settings_of(at_once | usual | given, two=False), shakes=True)
    return found


def test_a_control_that_holds_an_old_offset_within_the_tolerance_goes_on_from_it():
    """It was disconnected for a moment, unnoticed, while the offset moved on."""
    found = begun_with()
    found.control_returns(linked=False, clears=False, count=8, value=1.0)
    found.control_returns(linked=False, clears=False, count=3, value=0.0)
    found.control_returns(linked=True, clears=False, count=3, value=0.0)
    found.teardown()


def test_a_killed_service_knows_what_a_control_may_still_have():
    """The control holds -0.2 um, unnoticed; the offset has moved to zero when the service ends."""
    found = begun_with(largest_um=10.0)
    found.control_leaves(clears=True, enabled=False, linked=False)
    found.control_returns(clears=True, count=3, linked=True, value=0.95)
    found.control_returns(clears=False, count=3, linked=False, value=215.9)
    found.control_lies(lie=0.0)
    found.samples(count=15, kind=0, slope=0.0, value=0.0)
    found.kill(down=0.1, gain=None, output=None, shakes=False, until="", value=0.0)
    found.samples(count=9, kind=0, slope=0.0, value=0.0)
    found.teardown()


def test_an_offset_that_decays_does_not_meet_a_wrong_acknowledgement():
    """A control acknowledges 50 um too much: as much as it was sent some seconds before."""
    found = begun_with(rate_um_s=20.0, filter_s=10.0, largest_um=100.0)
    found.control_returns(linked=False, clears=False, count=8, value=-161.0)
    found.control_lies(lie=50e-6)
    found.samples(count=10, value=0.0, slope=0.0, kind=offset_invariant.SOUND)
    found.teardown()


@pytest.mark.parametrize(
    "payload",
    [b"", b"[]", b"[" * 5000, b'{"enable": 1, "heartbeat": 2}', b'{"enable": true}', b"\xff",
     b'{"enable": true, "heartbeat": true}', b'{"enable": true, "heartbeat": 1, "offsets_um": 3}',
     b'{"enable": true, "heartbeat": 1, "offsets_um": {"X": "3"}}'],
)  # fmt: skip
def test_what_is_no_answer_is_refused_as_a_whole(payload):
    with pytest.raises(ValidationError):
        answer_of(payload, Layout(("x",), ("X",), (), ()))


def test_an_answer_says_some_of_the_axes():
    layout = Layout(("x",), ("X", "Z"), (), ())
    said = answer_of(b'{"enable": true, "heartbeat": 3, "offsets_um": {"X": 2}, "a": 1}', layout)
    assert said[:2] == (True, 3)
    np.testing.assert_array_equal(said.acknowledged, [2e-6, math.nan])


def test_an_answer_says_a_slope_by_what_it_makes_at_the_far_end():
    layout = Layout(("x",), ("X", "Z"), (), (), (AxisLine("Z", 0.3, 0.5),))
    said = answer_of(
        b'{"enable": true, "heartbeat": 3, "offsets_um": {"Z": 2}, "slopes_um_per_m": {"Z": 40}}',
        layout,
    )
    assert said.acknowledged == pytest.approx([math.nan, 2e-6, 20e-6], nan_ok=True)
    by_opcua = opcua_control.answer_of("AcknowledgedSlope.Z", layout, 40.0)
    assert by_opcua.acknowledged == pytest.approx([math.nan, math.nan, 20e-6], nan_ok=True)


@pytest.mark.parametrize(
    ("written", "enabled"), [(True, True), (False, False), (None, False), ([False], False)]
)
def test_only_true_enables_the_offsets_by_opc_ua(written, enabled):
    """An array of Booleans, which the server takes as well, is not true however many it has."""
    layout = Layout(("x",), ("X",), (), ())
    assert opcua_control.answer_of("Enable", layout, written).enabled is enabled


def test_offsets_freeze_and_fade_without_the_control_and_go_on_from_what_it_cleared():
    given = {"rate_um_s": 1.0, "freeze_s": 5.0, "decay_s": 10.0, "recover_s": 3.0, "oldest_s": 9.0}
    output = offset_invariant.settings_of(given, two=False)
    model = offset_invariant.model_with(output, 1.0, LIMITS)
    mill = Machine(model, 1, initial_state("mill", model, START), None, START, START)
    fleet = Fleet({"mill": mill}, EventLog(), fresh_metrics(), 60.0, 60.0, WatchdogSection())
    found, has = [], 0.0
    for k in range(120):
        now = START + k
        away = 40 <= k < 80
        has = 0.0 if away else has
        if not away:
            said = Answer(True, k, (has,))
            processing.receive_answer(fleet, "mill", said, now)
        processing.process(fleet, [Arrival("mill", now, (20.0, 0.0), now)], now, now)
        changed = processing.check_silence(fleet, now + 0.5, now + 0.5)
        said = changed[-1] if changed else mill.state.latest
        has = said.offsets[0] if said.handshake == STANDS else has
        found.append((said.offset_mode, said.handshake, 1e6 * said.offsets[0]))
    modes, states, offsets = zip(*found, strict=True)
    assert (modes[30], states[30]) == ("follow", STANDS)
    assert offsets[38] == pytest.approx(-20.0)
    # The readings go on; nothing follows them.
    assert (modes[46], states[46], offsets[46]) == ("freeze", SILENT, offsets[38])
    assert modes[60] == "decay"
    assert -10.0 < offsets[70] < -1.0
    # The next offset is the one that it cleared; then they follow at the rate.
    back = states.index(STANDS, 80)
    assert (modes[back], offsets[back]) == ("wait", 0.0)
    assert np.abs(np.diff(offsets[back:])).max() <= 1.1
    assert (modes[119], offsets[119]) == ("follow", pytest.approx(-20.0))
    kinds = [event.text for event in fleet.log.take_pending() if event.kind == "handshake"]
    assert len(kinds) == 4


OFFSETS = """
rate_um_s = 1000.0
oldest_s = 1e6
recover_s = 0.0
freeze_s = 600.0
unusable = []
[axes.X]
follows = "x"
"""


class Controls:
    """Two controls that take over what they receive: one by OPC UA, one by MQTT."""

    def __init__(self, panel, broker):
        self.panel, self.broker, self.answers = panel, broker, True

    def node(self, name):
        return self.panel.get_node(f"ns=2;s={name}")

    async def by_opcua(self):
        control = [self.node(f"mill.Control.{name}") for name in
                   ("Enable", "Heartbeat", "Acknowledged.X")]  # fmt: skip
        for count in itertools.count():
            if self.answers:
                offset = await self.node("mill.Offset.X").read_data_value(raise_on_bad_status=False)
                await control[0].write_value(True)
                await control[1].write_value(count, ua.VariantType.UInt32)
                await control[2].write_value(offset.Value.Value)
            await asyncio.sleep(0.2)

    async def by_mqtt(self):
        await self.broker.subscribe("thermojoint/lathe/displacement")
        count = 0
        async for message in self.broker.messages:
            offset = json.loads(message.payload)["offsets_um"]
            count += 1
            if self.answers:
                said = {"enable": True, "heartbeat": count, "offsets_um": offset}
                await self.broker.publish("thermojoint/lathe/control", json.dumps(said))


@needs_broker
def test_controls_shake_hands_by_opcua_and_by_mqtt(model, tmp_path):
    (tmp_path / "offsets.toml").write_text(OFFSETS)
    add_user(tmp_path / "users", "control", "operator", "control-secret")
    add_user(tmp_path / "users", "other", "operator", "other-secret")
    port = free_port()

    def machine(name, **handshake):
        limits = {"heartbeat_s": 1.5, "differs_um": 5.0, "differs_s": 1.0}
        return {"model": "m", "source": name, "handshake": limits | handshake}

    names = ("mill", "lathe")
    source = {"kind": "csv", "path": "{machine}.csv"}
    data = {
        "folder": "state",
        "models": {"m": {"file": str(model), "offsets": "offsets.toml"}},
        "machines": {
            "mill": machine("mill", by="opcua", user="control"),
            "lathe": machine("lathe", by="mqtt"),
        },
        "sources": dict.fromkeys(names, source),
        "behind_s": 1e12,
        "opcua": {"port": port, "users": "users"},
    }
    lines = ["time_s,a_degC,b_degC,T1_degC,T2_degC,ambient_degC\n"]
    lines += [f"{START + k},{20 + 0.02 * k},20,20.5,21,20\n" for k in range(600)]

    async def feed():
        for line in lines:
            for name in names:
                with (tmp_path / f"{name}.csv").open("a") as file:
                    file.write(line)
            await asyncio.sleep(0.1)

    async def live(broker):
        data["mqtt"] = {"security": "none", "port": broker.port}
        async with (
            serving(data, tmp_path) as running,
            await client_of(tmp_path, port, "control", "control-secret") as panel,
            aiomqtt.Client("127.0.0.1", broker.port) as plant,
        ):
            controls, newest = Controls(panel, plant), running.publisher.newest
            tasks = [
                asyncio.create_task(one)
                for one in (feed(), controls.by_opcua(), controls.by_mqtt())
            ]

            def all_do(mode, handshake):
                return all(
                    (newest[name].offset_mode, newest[name].handshake) == (mode, handshake)
                    for name in names
                )

            await until(lambda: all_do("follow", STANDS))
            value = await controls.node("mill.Offset.X").read_data_value()
            assert value.StatusCode.is_good()
            controls.answers = False
            await until(lambda: all_do("freeze", SILENT))
            value = await controls.node("mill.Offset.X").read_data_value(raise_on_bad_status=False)
            assert value.StatusCode.name == "UncertainLastUsableValue"
            assert await controls.node("mill.Handshake").read_value() == SILENT
            audited = (tmp_path / "state" / "audit.jsonl").read_text()
            assert '"what": "write thermojoint/lathe/control (enable)"' in audited
            assert '"what": "write mill.Control.Enable"' in audited
            assert await controls.node("Heartbeat").read_value() > 0
            async with await client_of(tmp_path, port, "other", "other-secret") as stranger:
                with pytest.raises(ua.UaError):
                    await stranger.get_node("ns=2;s=mill.Control.Enable").write_value(True)
            controls.answers = True
            await until(lambda: all_do("follow", STANDS))
            await cancelled(*tasks)

    for name in names:
        (tmp_path / f"{name}.csv").write_text("")
    with Broker(tmp_path, "allow_anonymous true") as broker:
        asyncio.run(live(broker))
