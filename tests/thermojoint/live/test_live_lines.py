"""Axes of a control that receive a line: K0, slope and P0, by every way and with the handshake."""

import asyncio
import contextlib
import itertools
import json
import time
from functools import partial

import aiomqtt
import httpx
import numpy as np
import pytest
from asyncua import ua
from live_parts import PATIENCE_S, Broker, client_of, free_port, needs_broker, serving, until
from machine_fleet import fleet_of, keep
from machine_logs import along_log, as_csv
from played_control import Played

from calibrate.learning.learn import learn
from thermojoint.artefacts.errors import InputError
from thermojoint.compensation.offsets.handshake import STANDS
from thermojoint.compensation.offsets.settings import read_settings, with_slopes
from thermojoint.live.access_store import open_access
from thermojoint.live.arrivals import Arrival
from thermojoint.live.cancelling import cancelled
from thermojoint.live.loaded_models import load_model
from thermojoint.live.machine_state import Times, initial_state, restore_state
from thermojoint.live.publication import Layout, as_json, as_row, from_row
from thermojoint.live.settings import ModelSection, service_from_data
from thermojoint.live.store import last_received, layout_from, layout_text, open_store, stored_eras
from thermojoint.live.targets.dry_run import writes
from thermojoint.live.targets.linuxcnc import files_for
from thermojoint.live.targets.settings import lines_of, read_target
from thermojoint.live.tokens import add_token
from thermojoint.live.users import add_user
from thermojoint.live.writers import shdr
from thermojoint.models.learned import write_learned

START = 1_772_431_200.0
OFFSETS = """
rate_um_s = 1000.0
oldest_s = 1e6
recover_s = 0.0
freeze_s = 600.0
unusable = []
[axes.X]
follows = "x"
[axes.X.slope]
resolution_um_per_m = 1.0
"""
LOG = along_log(hours=3.0, seed=5, start=START, every=1)[0]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a model that was learned along an axis, and settings."""
    base = tmp_path_factory.mktemp("lines")
    write_learned(learn([along_log(every=5)[0]], ["x_um@y_pos_mm"], 4), base / "model.json")
    (base / "offsets.toml").write_text(OFFSETS)
    return base


def opened(place, more="", offsets=OFFSETS):
    (place / "other.toml").write_text(offsets + more)
    section = ModelSection(
        file=place / "model.json", interval_s=60.0, offsets=place / "other.toml", lateness_s=0.0
    )
    return load_model(section, place / "kept")


def readings(model, k):
    """Those of a sample of the log, in their units; none of the displacement."""
    columns = {name: LOG.columns[at].from_si(LOG.at(name)) for at, name in enumerate(LOG.names)}
    names = model.intake.names
    return tuple(float(columns[name][k]) if name != "x_um" else None for name in names)


def feed(fleet, store, count):
    mill = fleet.machines["mill"]
    for k in range(count):
        now = START + 60.0 * k
        keep(fleet, store, Arrival("mill", now, readings(mill.model, k), now, position=k))
    return mill.state.latest


def correction(said, positions):
    (line,) = said.layout.lines
    return said.offsets[0] + said.slopes[0] * (positions - line.reference)


def test_the_correction_cancels_the_displacement_at_every_position(place, tmp_path):
    model, store = opened(place), open_store(tmp_path / "history.sqlite")
    said = feed(fleet_of(model, store, START), store, 60)
    told = as_json(said)
    details = told["details"]
    assert told["offset_mode"] == "follow"
    assert told["P0_mm"]["X"] == pytest.approx(details["x_P0_mm"], abs=1e-6)
    ends = details["x_stroke_from_mm"], details["x_stroke_to_mm"]
    for position in np.linspace(*ends, 7):
        lever = 1e-3 * (position - details["x_P0_mm"])
        wanted = told["displacement_um"]["x"] + lever * details["x_slope_um_per_m"]
        line = told["offsets_um"]["X"] + lever * told["slopes_um_per_m"]["X"]
        assert line == pytest.approx(-wanted, abs=0.06 + 0.51 * abs(lever))
    back = from_row("mill", said.number, model.layout, as_row(said), said.status)
    assert as_json(back) == told | {"offset_mode": None}
    lines = "".join(shdr.lines_of(said))
    assert f"|mill:X_slope|{1e3 * said.slopes[0]:.7f}|mill:X_reference|" in lines


def test_what_is_kept_of_a_machine_without_a_line_is_as_before(place):
    plain = opened(place, offsets=OFFSETS.partition("[axes.X.slope]")[0])
    assert not {"slopes_um_per_m", "P0_mm"} & {*as_json(initial_state("mill", plain, START).latest)}
    layout = opened(place).layout
    text = layout_text(layout)
    assert layout_from(text) == layout
    # An update of the program alone begins no new era.
    assert json.loads(text)["details"] == [[name, unit] for name, unit, _ in layout.details]


@pytest.mark.parametrize("more", ["", "reference_mm = 200.0\n", "reference_mm = -50.0\n"])
def test_a_start_continues_the_line_that_the_control_received_last(place, tmp_path, more):
    """With another P0 as well: K0 is another one, and the correction is the same everywhere."""
    store = open_store(tmp_path / "history.sqlite")
    fleet = fleet_of(opened(place), store, START)
    before = feed(fleet, store, 60)
    era = fleet.machines["mill"].era
    other = opened(place, more)
    kept, received = stored_eras(store, [era])[era], last_received(store)["mill"]
    now = START + 60.0 * 60
    machine, _ = restore_state("mill", other, kept, None, received, Times(now, now))
    positions = np.linspace(-0.15, 0.25, 9)
    step = 0.5 * (0.1e-6 + 1e-6 * np.abs(positions - other.layout.lines[0].reference))
    moved = correction(machine.latest, positions) - correction(before, positions)
    assert (np.abs(moved) <= step * 1.001).all()
    assert abs(before.slopes[0]) > 20e-6


def test_a_model_of_one_place_has_no_slope(place, tmp_path):
    write_learned(learn([along_log()[0]], ["z_um"], 4), tmp_path / "model.json")
    text = OFFSETS.replace('"x"', '"z"')
    with pytest.raises(InputError, match=r"axes\.X\.slope: z is estimated at one place") as error:
        opened(tmp_path, offsets=text)
    assert "\n" not in str(error.value)
    plain = opened(tmp_path, offsets=text.partition("[axes.X.slope]")[0])
    assert plain.layout == Layout(("z",), ("X",), (), plain.layout.readings)


async def fed(place, names):
    """Lines of the log without what is estimated, to some machines."""
    as_csv(LOG, place / "log.csv", [name for name in LOG.names if name != "x_um"])
    for line in (place / "log.csv").read_text().splitlines(keepends=True):
        for name in names:
            with (place / f"{name}.csv").open("a") as file:
                file.write(line)
        await asyncio.sleep(0.1)


# --- by OPC UA, MQTT and HTTP --------------------------------------------------------------------


async def by_opcua(panel):
    """A control that takes over what it receives and acknowledges it."""
    node = lambda name: panel.get_node(f"ns=2;s=mill.{name}")  # noqa: E731
    for count in itertools.count():
        line = [
            await node(name).read_data_value(raise_on_bad_status=False)
            for name in ("Offset.X", "Slope.X")
        ]
        await node("Control.Enable").write_value(True)
        await node("Control.Heartbeat").write_value(count, ua.VariantType.UInt32)
        for name, value in zip(("Acknowledged.X", "AcknowledgedSlope.X"), line, strict=True):
            await node(f"Control.{name}").write_value(value.Value.Value)
        await asyncio.sleep(0.1)


def acknowledged(said, count):
    keys = ("offsets_um", "slopes_um_per_m")
    return {"enable": True, "heartbeat": count} | {key: said[key] for key in keys}


async def by_http(page):
    for count in itertools.count():
        said = (await page.get("/lathe/latest")).json()
        (await page.post("/lathe/control", json=acknowledged(said, count))).raise_for_status()
        await asyncio.sleep(0.1)


async def by_mqtt(plant):
    await plant.subscribe("thermojoint/drill/displacement")
    count = itertools.count()
    async for message in plant.messages:
        said = json.dumps(acknowledged(json.loads(message.payload), next(count)))
        await plant.publish("thermojoint/drill/control", said)


def content(place, folder, names, offsets=OFFSETS):
    """Of the file of a service, whose machines have handshakes by these ways."""
    (folder / "offsets.toml").write_text(offsets)
    for name in names:
        (folder / f"{name}.csv").write_text("")
    limits = {"heartbeat_s": 3.0, "differs_um": 5.0, "differs_s": 1.0}
    return {
        "folder": "state",
        "models": {"m": {"file": str(place / "model.json"), "interval_s": 60.0,
                         "lateness_s": 0.0, "offsets": "offsets.toml"}},
        "machines": {name: {"model": "m", "source": "line", "handshake": limits | {"by": by}}
                     for name, by in names.items()},
        "sources": {"line": {"kind": "csv", "path": "{machine}.csv"}},
        "behind_s": 1e12,
    }  # fmt: skip


async def followed_by(running, works, names):
    """Run the works of controls until each follows a slope, then return what ends them."""
    newest = running.publisher.newest
    tasks = [asyncio.create_task(work) for work in works]
    await until(
        lambda: (
            [task.result() for task in tasks if task.done()]
            or all(
                newest[name].handshake == STANDS
                and newest[name].offset_mode == "follow"
                and abs(newest[name].slopes[0]) > 20e-6
                for name in names
            )
        )
    )

    return partial(cancelled, *tasks)


async def acknowledged_slope(page):
    shakes = (await page.get("/lathe/handshake")).json()
    return shakes["acknowledged_slopes_um_per_m"]["X"]


def test_controls_receive_k0_slope_and_p0_by_opcua_and_http_and_acknowledge_them(place, tmp_path):
    names = {"mill": "opcua", "lathe": "http"}
    ports = {name: free_port() for name in names.values()}
    with contextlib.closing(open_access(tmp_path / "state")) as store:
        now = time.time()
        token = add_token(store, "control", "operator", (now, now + 600.0))
    add_user(tmp_path / "users", "control", "operator", "control-secret")
    data = content(place, tmp_path, names) | {
        "users": "users",
        "opcua": {"port": ports["opcua"]},
        "http": {"port": ports["http"], "security": "none"},
    }

    async def live():
        async with (
            serving(data, tmp_path) as running,
            await client_of(tmp_path, ports["opcua"], "control", "control-secret") as panel,
            httpx.AsyncClient(headers={"Authorization": f"Bearer {token}"},
                              base_url=f"http://127.0.0.1:{ports['http']}/api/machines") as page,
        ):  # fmt: skip
            works = (fed(tmp_path, names), by_opcua(panel), by_http(page))
            end = await followed_by(running, works, names)
            node = panel.get_node("ns=2;s=mill.Slope.X")
            value = await node.read_data_value()
            assert value.StatusCode.is_good()
            assert abs(value.Value.Value) > 20.0
            unit = await node.get_child("0:EngineeringUnits")
            assert (await unit.read_value()).DisplayName.Text == "µm/m"
            reference = await panel.get_node("ns=2;s=mill.Reference.X").read_value()
            said = (await page.get("/mill/latest")).json()
            assert said["P0_mm"]["X"] == pytest.approx(reference, abs=1e-6)
            assert (await page.get("/mill")).json()["P0_mm"].keys() == {"X"}
            past = (
                await page.get("/mill/history", params={"since": START, "until": START + 1e5})
            ).json()
            assert max(map(abs, past["slopes_um_per_m"]["X"])) > 20.0
            # The control acknowledges what it read last, which may be one message behind.
            async with asyncio.timeout(10.0):
                while abs(await acknowledged_slope(page)) < 15.0:
                    await asyncio.sleep(0.1)
            await end()

    asyncio.run(live())


@needs_broker
def test_a_control_receives_k0_slope_and_p0_by_mqtt_and_acknowledges_them(place, tmp_path):
    data = content(place, tmp_path, {"drill": "mqtt"})

    async def live(broker):
        data["mqtt"] = {"security": "none", "port": broker.port}
        async with (
            serving(data, tmp_path) as running,
            aiomqtt.Client("127.0.0.1", broker.port) as plant,
        ):
            works = (fed(tmp_path, ["drill"]), by_mqtt(plant))
            end = await followed_by(running, works, ["drill"])
            await end()

    with Broker(tmp_path, "allow_anonymous true") as broker:
        asyncio.run(live(broker))


# --- written into a control ----------------------------------------------------------------------

STEP_UM = 10.0
LINE = OFFSETS.replace("X", "Z").replace("1000.0", "8.0") + "reference_mm = 50.0\n"
SLOPES = "\n[slopes.Z]\nreference_mm = 50.0\nstroke_mm = [-160.0, 260.0]\n"


@pytest.mark.parametrize(
    ("kind", "switch", "reference"),
    [("sinumerik", {"MD32750": 3}, {"SD43920": 50.0}),
     ("beckhoff", {}, {"P-AXIS-00272": 500_000})],
)  # fmt: skip
def test_k0_and_slope_are_written_into_a_control(place, tmp_path, kind, switch, reference):
    played = Played(tmp_path / "target.toml", kind, STEP_UM, more=SLOPES)
    data = content(place, tmp_path, {"mill": "target"}, LINE)
    handshake = {"by": "target", "heartbeat_s": 3.0, "differs_um": 10.0}
    data["machines"]["mill"] |= {"target": "target.toml", "handshake": handshake}

    def events(running, text):
        found = running.archive.events("mill", 0.0, 1e11, 1000)
        return any(text in one.text for one in found if one.kind == "target-refused")

    async def live():
        # A control that computes with another P0, or without the slope, is left alone.
        await played.open(**switch)
        async with serving(data, tmp_path) as running:
            await until(lambda: events(running, "set it to"))
        await played.server.stop()
        assert played.record == []
        await played.open(**switch, **reference)
        async with serving(data, tmp_path) as running:
            newest = running.publisher.newest
            feeding = asyncio.create_task(fed(tmp_path, ["mill"]))
            await until(lambda: newest["mill"].offset_mode == "follow")
            await until(
                lambda: (
                    played.slopes
                    and abs(played.newest - 1e6 * newest["mill"].offsets[0]) < 0.11
                    and abs(played.slopes[-1][1] - 1e6 * newest["mill"].slopes[0]) < 1.1
                    and abs(played.slopes[-1][1]) > 20.0
                )
            )
            feeding.cancel()
        await played.server.stop()

    asyncio.run(asyncio.wait_for(live(), 4 * PATIENCE_S))
    record = [(at, "offset", um) for at, um in played.record]
    record += [(at, "slope", um) for at, um in played.slopes]
    positions = np.linspace(-0.16, 0.26, 7) - 0.05
    now, found = {"offset": 0.0, "slope": 0.0}, [np.zeros(7)]
    for _, what, value in sorted(record):
        now[what] = value
        found.append(now["offset"] + now["slope"] * positions)
    # One write of each, a moment apart, moves the correction by half the step.
    assert np.abs(np.diff(found, axis=0)).max() <= 0.5 * STEP_UM + 0.3


def test_linuxcnc_takes_no_slope(place, tmp_path):
    data = content(place, tmp_path, {"mill": "http"}) | {"http": {"security": "none"}}
    service = service_from_data(data, "test", tmp_path)
    with pytest.raises(InputError, match="one offset for all positions"):
        files_for(service, "mill", tmp_path / "mill.ini", tmp_path / "token", None)


@pytest.mark.parametrize(
    ("target", "offsets", "told"),
    [
        ("", LINE, "axis Z takes no slope here"),
        (SLOPES, LINE.partition("[axes.Z.slope]")[0], "has no slope in the offsets"),
        (SLOPES.replace("50.0", "51.0"), LINE, "reference_mm 51 is not P0 of the offsets, 50 mm"),
        (SLOPES.replace("260.0", "150.0"), LINE, "is not all of the model's"),
        (SLOPES.replace("-160.0", "260.0"), LINE, "give its two ends in order"),
        (SLOPES.replace("slopes.Z", "slopes.Y"), LINE, "no axis named 'Y'"),
        (SLOPES, LINE.replace("8.0", "11.0"), "slower than rate_um_s 11"),
    ],
)
def test_a_slope_that_only_one_side_has_is_refused_in_one_line(
    place, tmp_path, target, offsets, told
):
    (tmp_path / "offsets.toml").write_text(offsets)
    (tmp_path / "target.toml").write_text(
        f'kind = "beckhoff"\nurl = "opc.tcp://127.0.0.1"\nlargest_step_um = 10.0\n'
        f"axes = {{ Z = 3 }}\n{target}"
    )
    strokes = {"x": opened(place).output.output.slopes[0]}
    settings = read_settings(tmp_path / "offsets.toml")
    settings = with_slopes(settings, strokes, "offsets.toml")
    with pytest.raises(InputError, match=told) as error:
        read_target(tmp_path / "target.toml", settings.output)
    assert "\n" not in str(error.value)


def test_every_write_of_a_line_is_shown_before_it_is_made(tmp_path):
    (tmp_path / "target.toml").write_text(
        f'kind = "sinumerik"\nurl = "opc.tcp://127.0.0.1"\naxes = {{ Z = 3 }}\n{SLOPES}'
    )
    given = read_target(tmp_path / "target.toml")
    assert list(lines_of(given))[1:5] == [
        "$MA_TEMP_COMP_TYPE[AX3]=3",
        "$SA_TEMP_COMP_ABS_VALUE[AX3]=0 ; mm",
        "$SA_TEMP_COMP_SLOPE[AX3]=0 ; mm/mm",
        "$SA_TEMP_COMP_REF_POSITION[AX3]=50 ; mm",
    ]
    table = ["time_s,offset_Z_um,slope_Z_um_per_m,P0_Z_mm,state", "0,-1.5,40,50,follow"]
    found = [(node[-30:], value) for _, _, node, value, _ in writes(given, table, "offsets.csv")]
    # 5 um at most: 2.5 um by K0, and 2.5 um at 210 mm by the slope, in whole steps of 1 um/m.
    assert [value for _, value in found] == ["-0.0015", "1.1e-05"]
    for bad, told in (("P0_Z_mm", "no P0_Z_mm"), ("slope_Z_um_per_m", "no slope_Z_um_per_m")):
        with pytest.raises(InputError, match=told):
            list(writes(given, [table[0].replace(bad, "other"), table[1]], "offsets.csv"))
    with pytest.raises(InputError, match=r"P0_Z_mm 60 is not slopes\.Z\.reference_mm 50"):
        list(writes(given, [table[0], table[1].replace(",50,", ",60,")], "offsets.csv"))
