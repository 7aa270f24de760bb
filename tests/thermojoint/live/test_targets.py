"""Controls by OPC UA: what is written into them, and what never is."""

import asyncio
import contextlib
import csv
import random
import re
import shlex
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from live_parts import needs_broker, serving, until
from played_control import PAGES, Played
from repository import ROOT
from warming_machine import OFFSETS, RATE, prepare, started, warming_up

from benchmarks import target_kills
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.settings import toml
from thermojoint.compensation.offsets.settings import settings_from_data
from thermojoint.live.settings import ServiceFile, Source
from thermojoint.live.targets import writing
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


def test_a_writer_that_is_cancelled_as_a_value_arrives_ends(tmp_path, monkeypatch):
    given = Played(tmp_path / "target.toml", "sinumerik", STEP_UM).given
    tasks = []

    class Answering:
        """A control whose first answer and the end of the service come together."""

        def get_node(self, name):
            return name

        async def read_values(self, nodes):
            await asyncio.sleep(0.0)
            if len(tasks) == 1:
                tasks.append(tasks[0].cancel())
            return [given.control.with_slope]

    @contextlib.asynccontextmanager
    async def reached(_):
        yield Answering()

    async def client_of(reach):
        return reached(reach)

    async def live():
        said = SimpleNamespace(log=SimpleNamespace(say=lambda *_: None))
        writer = writing.TargetWriter("mill", ("Z",), given, None, None, said, None)
        tasks.append(asyncio.create_task(writer.run()))
        done, _ = await asyncio.wait(tasks[:1], timeout=5.0)
        tasks[0].cancel()
        return done

    monkeypatch.setattr(writing, "client_of", client_of)
    assert asyncio.run(live())


@pytest.mark.parametrize(("kind", "asked"), [("sinumerik", "250.1234"), ("beckhoff", "2501234")])
def test_the_value_that_a_control_is_to_be_set_to_is_said_in_full(kind, asked, tmp_path):
    """Whoever sets it to what is said has set it right."""
    more = "[slopes.Z]\nreference_mm = 250.1234\nstroke_mm = [0.0, 500.0]\n"
    given = Played(tmp_path / "target.toml", kind, STEP_UM, more=more).given
    held = {
        given.node(given.control.switch, "Z"): given.control.with_slope,
        given.node(given.control.slope, "Z"): 0.0,
        given.node(given.control.reference, "Z"): 0.0,
    }

    class Answering:
        def get_node(self, name):
            return name

        async def read_values(self, nodes):
            return [held[node] for node in nodes]

    writer = writing.TargetWriter("mill", ("Z",), given, None, None, None, None)
    with pytest.raises(InputError, match=f"is 0; set it to {asked} while"):
        asyncio.run(writer._check(Answering()))
    held[given.node(given.control.reference, "Z")] = float(asked)
    asyncio.run(writer._check(Answering()))


def test_a_single_write_changes_a_value_by_no_more_than_its_limit():
    path = [0.0]
    while path[-1] != -0.012:
        path.append(next_value(SINUMERIK.offset, path[-1], -12e-6, 5e-6))
    assert path == [0.0, -0.005, -0.01, -0.012]


@pytest.mark.parametrize(
    ("quantity", "most", "path"),
    [
        # Of 1.6 µm/m one step of 1 µm/m, of 0.16 µm one of 0.1 µm.
        (BECKHOFF.slope, 1.6e-6, [0, 1, 2, 3]),
        (BECKHOFF.offset, 0.16e-6, [0, 1, 2, 3]),
    ],
)
def test_a_limit_between_two_steps_of_the_control_is_kept(quantity, most, path):
    found = [0.0]
    while len(found) < len(path):
        found.append(next_value(quantity, found[-1], 20 * quantity.metres, most))
    assert found == path


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ('kind = "fanuc"', "kind"),
        ('kind = "beckhoff"\nurl = "opc.tcp://plc"\naxes = { Z = 1 }\nlargest_step_um = 1e308',
         "largest_step_um"),
        ('kind = "beckhoff"\nurl = "opc.tcp://plc"\naxes = { Z = 1 }\nevery_s = 1e-308', "every_s"),
        ('kind = "beckhoff"\nurl = "opc.tcp://plc"\naxes = { Z = 1 }\nlargest_step_um = 0.04',
         "less than one step of P-AXIS-00273 of axis Z"),
        ('kind = "beckhoff"\nurl = "opc.tcp://plc"\naxes = { Z = 1 }\n[slopes.Z]\n'
         "reference_mm = 0.0\nstroke_mm = [0.0, 6000.0]",
         "less than one step of P-AXIS-00274 of axis Z"),
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


@needs_broker
def test_no_control_jumps_or_hears_a_lie_with_kills_on_either_side(tmp_path, monkeypatch, command):
    """By OPC UA, by MQTT, and in a Siemens and a Beckhoff; a LinuxCNC has its own test."""
    monkeypatch.setattr(target_kills, "run", lambda *words: command(*words)[1])
    target_kills.learned(tmp_path)
    names = target_kills.names_of(None)
    rounds = [(*names, "broker"), ("service",)]
    found = asyncio.run(target_kills.play(tmp_path, None, rounds, random.Random(0), 1.5))
    assert target_kills.violations(found) == []
    assert all(one["good"] for one in found["controls"].values())


def test_controls_return_to_zero_without_readings_and_follow_again(hand_made_model, tmp_path):
    """No control keeps an offset without an estimate behind it, and none jumps when it is back."""
    places = {kind: tmp_path / kind for kind in CONTROLS}
    trust = OFFSETS.replace("oldest_s = 1e6", "oldest_s = 2.0\ndecay_s = 0.5")

    async def one(kind, place):
        prepare(place, hand_made_model, HANDSHAKE)
        (place / "offsets.toml").write_text(trust)
        played = Played(place / "target.toml", kind, STEP_UM)
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


@pytest.mark.parametrize(
    ("enable", "values", "event", "told"),
    [
        (False, {}, "dry-run", "would write ns=2;s=/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP"),
        (True, {"MD32750": 3}, "target-refused", "set it to 1"),
        (True, {"SD43910": 1e-5}, "target-refused", "set it to 0"),
        (True, {"SD43900": 0.05}, "handshake", "differs"),
    ],
)
def test_a_control_is_left_alone(enable, values, event, told, hand_made_model, tmp_path):
    """Not enabled, compensating otherwise, or with a value that is not from the service."""
    prepare(tmp_path, hand_made_model, HANDSHAKE)
    played = Played(tmp_path / "target.toml", "sinumerik", STEP_UM, enable)

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
            assert running.publisher.newest["mill"].offset_mode != "follow"
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


def test_what_a_control_needs_is_written_over_no_other_file(command, tmp_path):
    given = tmp_path / "sinumerik.toml"
    block = re.search(r"^```toml target[^\n]*\n(.*?)^```", PAGES["sinumerik"], re.M | re.S)
    given.write_text(block[1])
    out = tmp_path / "parameters.txt"
    for _ in range(2):  # its own file it replaces
        assert command("target", given, "--out", out)[0] == 0
    notes = tmp_path / "notes.txt"
    notes.write_text("of another origin\n")
    for taken in (given, notes):
        before = taken.read_bytes()
        assert command("target", given, "--out", taken)[0] == 2
        assert taken.read_bytes() == before


def would_write(folder, command, table, more=""):
    """Run `target` on a table of offsets of X, for a Siemens control."""
    target, offsets = folder / "target.toml", folder / "offsets.csv"
    target.write_text(
        f'kind = "sinumerik"\nurl = "opc.tcp://127.0.0.1"\naxes = {{ X = 1 }}\n{more}'
    )
    offsets.write_text(table)
    return command("target", target, "--offsets", offsets)


@pytest.mark.parametrize(
    ("every", "expected"),
    [
        # One write changes a value by at most 5 um; the value is followed between two rows.
        (1.0, {0: -5, 1: -10, 2: -12, 10: -15, 20: -10}),
        # And what a row says between two writes is not seen.
        (20.0, {0: -5, 20: -10}),
    ],
)
def test_what_would_be_written_follows_at_the_pace_of_the_target(
    every, expected, command, tmp_path
):
    table = "time_s,offset_X_um,state\n0,-12,follow\n10,-15,follow\n20,-10,follow\n"
    code, said, _ = would_write(tmp_path, command, table, f"every_s = {every}\n")
    assert code == 0
    rows = [line.split(",") for line in said.splitlines()[1:]]
    assert {int(row[0]): round(1000.0 * float(row[3])) for row in rows} == expected


def test_a_node_whose_name_has_a_comma_is_one_cell_of_the_table_of_writes(command, tmp_path):
    table = "time_s,offset_X_um,state\n0,1.5,follow\n"
    nodes = 'nodes = { SD43900 = "ns=4;s=comp[1,{axis}]" }\n'
    code, said, _ = would_write(tmp_path, command, table, nodes)
    assert code == 0
    assert list(csv.reader(said.splitlines()))[1:] == [
        ["0", "X", "ns=4;s=comp[1,1]", "0.0015", "mm"]
    ]


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("time_s,offset_X_um,state\n1,1.0,follow\n1,2.0,follow\n", "does not increase at 1"),
        ("", "no rows"),
        ("time_s,offset_Y_um,state\n", "no rows"),
        ("offset_X_um,state\n1.0,follow\n", "no time_s"),
        ("time_s,offset_X_um,state\nnan,1.0,follow\n", "does not increase at nan"),
        ("time_s,offset_X_um,state\n0,1.0,follow\ninf,2.0,follow\n", "does not increase at inf"),
        # The service refuses these: K0 alone is no correction, and an axis would be left out.
        (
            "time_s,offset_X_um,slope_X_um_per_m,P0_X_mm,state\n0,1,40,50,follow\n",
            "slope_X_um_per_m: the target has no slope of axis X; add [slopes.X]",
        ),
        (
            "time_s,offset_X_um,offset_Y_um,state\n0,1,2,follow\n",
            "offset_Y_um: the target has no axis Y; add it to axes",
        ),
    ],
)
def test_a_table_that_leads_to_no_writes_as_it_is_none_is_refused(table, told, command, tmp_path):
    code, _, said = would_write(tmp_path, command, table)
    assert code == 2
    assert told in said
