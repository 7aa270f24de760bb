"""Controls by OPC UA: what is written into them, and what never is."""

import asyncio
import contextlib
import os
import re
import shlex
import signal
import time
from typing import get_args

import numpy as np
import pytest
from asyncua import Server, ua
from live_parts import free_port, serving, until
from repository import ROOT
from warming_machine import OFFSETS, RATE, prepare, started, warming_up

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.settings import toml
from thermojoint.compensation.offsets.settings import settings_from_data
from thermojoint.live.archive import Archive
from thermojoint.live.settings import ServiceFile, Source
from thermojoint.live.targets.beckhoff import BECKHOFF
from thermojoint.live.targets.control import in_units, next_value
from thermojoint.live.targets.settings import CONTROLS, read_target
from thermojoint.live.targets.sinumerik import SINUMERIK

STEP_UM = 10.0
SOURCES = get_args(get_args(Source)[0])
HANDSHAKE = """
target = "target.toml"
[machines.mill.handshake]
by = "target"
heartbeat_s = 3.0
differs_um = 10.0
"""


@pytest.mark.parametrize(
    ("control", "metres", "value"),
    [
        (SINUMERIK, 12.34567e-6, 0.012346),
        (SINUMERIK, -0.1e-6, -0.0001),
        (BECKHOFF, 12.34567e-6, 123),
        (BECKHOFF, -0.04e-6, 0),
        (BECKHOFF, -0.06e-6, -1),
    ],
)
def test_an_offset_is_rounded_to_the_unit_of_the_control(control, metres, value):
    assert in_units(control.offset, metres) == value


@pytest.mark.parametrize("metres", [np.nan, np.inf, 0.0101])
def test_what_a_control_cannot_take_is_refused(metres):
    with pytest.raises(InputError, match="beyond"):
        in_units(SINUMERIK.offset, metres)


def test_a_single_write_changes_a_value_by_no_more_than_its_limit():
    path = [0.0]
    while path[-1] != -0.012:
        path.append(next_value(SINUMERIK.offset, path[-1], -12e-6, 5e-6))
    assert path == [0.0, -0.005, -0.01, -0.012]


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ('kind = "fanuc"', "kind"),
        ('kind = "beckhoff"\nurl = "opc.tcp://127.0.0.1"\naxes = { Z = 1, X = 1 }', "same number"),
        ('kind = "beckhoff"\nurl = "opc.tcp://10.0.0.7"\nsecurity = "none"\naxes = { Z = 1 }',
         "others reach"),
        ('kind = "beckhoff"\nurl = "opc.tcp://10.0.0.7"\naxes = { X = 1 }', "no axis named 'Z'"),
        ('kind = "beckhoff"\nurl = "opc.tcp://10.0.0.7"\naxes = { Z = 1 }', "slower than rate"),
        ('kind = "beckhoff"\nurl = "opc.tcp://plc"\naxes = { Z = 1 }\nnodes = { SD43900 = "" }',
         "no quantity named"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_file_of_a_target_is_one_line(lines, told, tmp_path):
    (tmp_path / "target.toml").write_text(lines)
    offsets = settings_from_data(toml.parse(OFFSETS, "offsets"), "offsets")
    with pytest.raises(InputError, match=told):
        read_target(tmp_path / "target.toml", offsets.output)


class Played:
    """A server with the documented node names of a control, and what was written into it."""

    def __init__(self, place, page):
        text = re.search(r"^```toml target[^\n]*\n(.*?)^```", page, re.M | re.S)[1]
        self.port = free_port()
        text = re.sub(r'url = ".*"', f'url = "opc.tcp://127.0.0.1:{self.port}"', text)
        text = text.replace("largest_step_um = 5.0", f"largest_step_um = {STEP_UM}")
        text = re.sub(r"server_certificate.*\n|user.*\n|password.*\n", "", text)
        (place / "target.toml").write_text(f'security = "none"\n{text}')
        self.given = read_target(place / "target.toml")
        self.server, self.nodes, self.record = None, {}, []

    async def open(self, **values):
        self.server = Server()
        await self.server.init()
        self.server.set_endpoint(f"opc.tcp://127.0.0.1:{self.port}")
        for k in range(2, 5):
            await self.server.register_namespace(f"urn:played:{k}")
        for quantity in self.given.control.quantities:
            node = ua.NodeId.from_string(self.given.node(quantity, "Z"))
            begins = 1 if quantity is self.given.control.switch else 0
            value = values.get(quantity.name.split()[0], begins)
            made = await self.server.nodes.objects.add_variable(
                node, f"{node.NamespaceIndex}:{quantity.name}",
                self.variant(quantity, value),
            )  # fmt: skip
            await made.set_writable()
            self.nodes[quantity.name.split()[0]] = made
        offset = self.given.control.offset
        self.offset = self.nodes[offset.name.split()[0]]
        self.server.iserver.aspace.add_datachange_callback(
            self.offset.nodeid, ua.AttributeIds.Value, self.written
        )
        await self.server.start()

    async def written(self, handle, value):
        self.record.append((time.monotonic(), self.um(value.Value.Value)))

    @staticmethod
    def variant(quantity, value):
        if quantity.whole:
            return ua.Variant(int(value), ua.VariantType.Int32)
        return ua.Variant(float(value), ua.VariantType.Double)

    def um(self, value):
        return 1e6 * self.given.control.offset.metres * value

    @property
    def newest(self):
        return self.record[-1][1] if self.record else 0.0


PAGES = {
    name: (ROOT / "docs" / f"guide-{name}.md").read_text("utf-8")
    for name in ("sinumerik", "beckhoff")
}


def test_controls_follow_with_kills_on_either_side(hand_made_model, tmp_path):
    """The service is killed, then the control; then somebody clears the value."""
    places = {kind: tmp_path / kind for kind in CONTROLS}
    with contextlib.ExitStack() as ends:
        for place in places.values():
            place.mkdir()
            prepare(place, hand_made_model, HANDSHAKE)
            ends.enter_context(warming_up(place))

        async def live():
            return await asyncio.gather(*(follow(*one) for one in places.items()))

        for record, cleared in asyncio.run(live()):
            for part in (record[:cleared], record[cleared + 1 :]):
                at, um = np.array(part).T
                assert np.abs(np.diff(um)).max() <= STEP_UM + 0.11
                assert abs(um[-1] - um[0]) <= RATE * (at[-1] - at[0]) + STEP_UM + 0.11
            assert record[cleared][1] == 0.0
            assert abs(record[cleared + 1][1]) <= STEP_UM + 0.11


def test_controls_return_to_zero_without_readings_and_follow_again(hand_made_model, tmp_path):
    """No control keeps an offset without an estimate behind it, and none jumps when it is back."""
    places = {kind: tmp_path / kind for kind in CONTROLS}
    trust = OFFSETS.replace("oldest_s = 1e6", "oldest_s = 2.0\ndecay_s = 0.5")

    async def one(kind, place):
        prepare(place, hand_made_model, HANDSHAKE)
        (place / "offsets.toml").write_text(trust)
        played = Played(place, PAGES[kind])
        text = (place / "target.toml").read_text()
        (place / "target.toml").write_text(text.replace("enable = false", "enable = true"))
        await played.open()
        service = started(place)
        try:
            with warming_up(place):
                await until(lambda: abs(played.newest) > 10.0)
            await until(lambda: abs(played.newest) < 0.2)
            with warming_up(place, 2000):
                await until(lambda: abs(played.newest) > 10.0)
        finally:
            service.kill()
            service.wait()
            await played.server.stop()
        return np.array(played.record).T

    async def live():
        return await asyncio.gather(*(one(*each) for each in places.items()))

    for place in places.values():
        place.mkdir()
    for at, um in asyncio.run(live()):
        assert np.abs(np.diff(um)).max() <= STEP_UM + 0.11
        for lag in (1, 5, 20):
            spent = at[lag:] - at[:-lag]
            assert (np.abs(um[lag:] - um[:-lag]) <= RATE * spent + STEP_UM + 0.11).all()


async def follow(kind, place):
    """What a control received, and which of it was the zero of somebody else."""
    played = Played(place, PAGES[kind])
    text = (place / "target.toml").read_text()
    (place / "target.toml").write_text(text.replace("enable = false", "enable = true"))
    archive = Archive(place / "state" / "history.sqlite")

    def follows(count=0):
        return (
            len(played.record) > count + 3
            and abs(played.newest) > 10.0
            and abs(played.newest - 1e6 * archive.latest("mill").offsets[0]) < 3.0
        )

    await played.open()
    service = started(place)
    try:
        await until(follows)
        os.kill(service.pid, signal.SIGKILL)
        service.wait()
        await asyncio.sleep(0.5)
        held = played.newest
        await asyncio.sleep(1.0)
        assert played.newest == held
        service, count = started(place), len(played.record)
        await until(lambda: follows(count))
        # The control is gone, and comes back with what it had.
        await played.server.stop()
        await asyncio.sleep(4.0)
        offset = played.given.control.offset
        value, count = await played.offset.read_value(), len(played.record)
        await played.open(**{offset.name.split()[0]: value})
        await until(lambda: follows(count))
        cleared = len(played.record)
        await played.offset.write_value(played.variant(offset, 0))
        await until(lambda: follows(cleared))
        await played.server.stop()
    finally:
        service.kill()
        service.wait()
    return played.record, cleared


@pytest.mark.parametrize(
    ("enable", "values", "event", "told"),
    [
        ("false", {}, "dry-run", "would write ns=2;s=/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP"),
        ("true", {"MD32750": 3}, "target-refused", "set it to 1"),
        ("true", {"SD43910": 1e-5}, "target-refused", "set it to 0"),
        ("true", {"SD43900": 0.05}, "handshake", "differs"),
    ],
)
def test_a_control_is_left_alone(enable, values, event, told, hand_made_model, tmp_path):
    """Not enabled, compensating otherwise, or with a value that is not from the service."""
    prepare(tmp_path, hand_made_model, HANDSHAKE)
    played = Played(tmp_path, PAGES["sinumerik"])
    text = (tmp_path / "target.toml").read_text()
    (tmp_path / "target.toml").write_text(text.replace("enable = false", f"enable = {enable}"))

    async def live():
        await played.open(**values)
        data = toml.parse((tmp_path / "service.toml").read_text(), "service")
        async with serving(data, tmp_path) as running:
            archive = running.archive
            await until(
                lambda: any(
                    one.kind == event and told in one.text
                    for one in archive.events("mill", 0.0, 1e11, 1000)
                )
            )
            assert running.hub.newest["mill"].offset_mode != "follow"
        await played.server.stop()

    with warming_up(tmp_path):
        asyncio.run(live())
    assert played.record == []


@pytest.mark.parametrize("name", PAGES)
def test_the_commands_of_the_page_show_every_write_before_it_is_made(
    name, command, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```(\w+)([^\n]*)\n(.*?)^```", PAGES[name], re.M | re.S)
    (tmp_path / "offsets.csv").write_text(
        "time_s,offset_Z_um,state\n0,0,wait\n1,-1.5,follow\n2,-1.5,follow\n3,-12.3,follow\n"
    )
    for _, rest, content in blocks:
        if rest.strip() == "target.toml":
            (tmp_path / "target.toml").write_text(content)
    shown = {}
    for line in re.findall(r"^thermojoint (target.*)$", PAGES[name], re.M):
        words = shlex.split(line)
        code, _, said = command(*words)
        assert code == 0, said
        shown[words[-1]] = (tmp_path / words[-1]).read_text()
    expected = {rest.strip(): content for _, rest, content in blocks if rest.strip() in shown}
    assert expected == shown


def test_the_graded_page_has_a_true_row_for_every_source_output_and_target():
    page = (ROOT / "docs" / "targets.md").read_text("utf-8")
    rows = re.findall(r"^\| (source|output|target) (\S+) \| ([ABC]) \| (.*) \|$", page, re.M)
    kinds = {
        "source": {get_args(one.model_fields["kind"].annotation)[0] for one in SOURCES},
        "output": {"opcua", "mqtt", "http", "shdr"} & set(ServiceFile.model_fields),
        "target": {"linuxcnc", *CONTROLS},
    }
    files = (ROOT / "tests" / "thermojoint" / "live").glob("test_*.py")
    tests = set(re.findall(r"def (test_\w+)", "".join(path.read_text("utf-8") for path in files)))
    for what, known in kinds.items():
        named = [name.strip("`") for kind, name, _, _ in rows if kind == what and "`" in name]
        assert sorted(named) == sorted(known)
    for _, name, grade, rest in rows:
        tried, lost, faulty, security, guide = rest.split(" | ")
        assert set(re.findall(r"test_\w+", rest)) <= tests
        if grade == "C":
            assert (tried, lost, faulty, security) == ("nothing", "–", "–", "–")
            continue
        assert "test_" in lost
        assert "test_" in faulty
        assert security != "–"
        # What is played by the manuals is no control and no agent.
        assert grade == ("B" if name.strip("`") in {*CONTROLS, "mtconnect", "shdr"} else "A")
        assert (ROOT / "docs" / re.search(r"\((\S+)\)", guide)[1]).is_file()
