"""Interfaces of the service: thousands of malformed readings change nothing."""

import asyncio
import json
import math
import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
from asyncua import ua
from hypothesis import given, settings
from hypothesis import strategies as st
from log_dialects import DIALECTS, logs

from benchmarks.live_fuzz import DOORS, check
from estimator.intake import of_columns
from estimator.quality import Quality
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.tables.clock import Hands
from thermojoint.live.arrivals import ABSENT, Arrival, Note
from thermojoint.live.loaded_models import load_model
from thermojoint.live.opcua_values import status_of, variables_of
from thermojoint.live.publication import Layout
from thermojoint.live.readers import csv_lines, mqtt, opcua
from thermojoint.live.readers.reader import source_names
from thermojoint.live.settings import ModelSection, MqttSource, OpcuaSource

NAMES = ("T1_degC", "T2_degC")
TOPICS = mqtt.topics_of(MqttSource(kind="mqtt", topic="hall/{machine}"), {"mill": NAMES})
ONE_EACH = mqtt.topics_of(
    MqttSource(kind="mqtt", topic="hall/{machine}/{reading}"), {"mill": NAMES}
)
JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4)
    ),
    max_leaves=10,
)


@pytest.fixture(scope="module")
def model(model, tmp_path_factory):
    return load_model(ModelSection(file=model), tmp_path_factory.mktemp("kept"))


@pytest.mark.parametrize("door", DOORS)
def test_damaged_readings_change_no_estimate_and_leave_nothing(door, model):
    found = check(door, model, 150, seed=1)
    assert found["equal"]
    assert found["grown_kb"] < 512.0


@given(st.binary(max_size=200) | JSON.map(lambda one: json.dumps(one).encode()))
def test_any_payload_is_readings_or_a_note(payload):
    found = mqtt.item_of(TOPICS, "hall/mill", payload)
    if isinstance(found, Arrival):
        assert all(one is None or isinstance(one, float) for one in found.readings)
        assert isinstance(found.time, float)
    else:
        assert len(found.text) < 300


@given(st.text(max_size=60))
def test_any_topic_is_of_a_machine_or_a_note(topic):
    found = mqtt.item_of(TOPICS, topic, b'{"time": 1, "T1_degC": 2}')
    assert isinstance(found, Arrival) == (topic == "hall/mill")


def test_a_topic_may_name_its_machine_and_its_reading_twice():
    source = MqttSource(kind="mqtt", topic="{machine}/{reading}/{machine}_{reading}")
    topics = mqtt.topics_of(source, {"mill": NAMES})
    payload = b'{"time": 1, "value": 2}'
    found = mqtt.item_of(topics, "mill/T2_degC/mill_T2_degC", payload)
    assert (found.machine, found.readings) == ("mill", [None, 2.0])
    assert topics.filter == "+/+/+"
    assert isinstance(mqtt.item_of(topics, "mill/T2_degC/lathe_T2_degC", payload), Note)


def pipe_of(path, *names, **source_names):
    """A pipe that ends with its file."""
    named = {name: name for name in names} | source_names
    return csv_lines.CsvReader("mill", path, named, len(names), 0.0, follow=False)


def read(reader, position=None):
    """What a stream says: arrivals, and notes."""

    async def whole():
        return [one async for some in reader.read({reader.machine: position}) for one in some]

    found = asyncio.run(whole())
    arrivals = [one for one in found if isinstance(one, Arrival)]
    return arrivals, [one for one in found if isinstance(one, Note)]


def test_a_later_row_shows_the_decimal_sign_of_a_stream(tmp_path):
    """The machine rests in its first row, and ``1.500`` is no 1.5 rpm beside ``20,5`` °C."""
    path = tmp_path / "log.csv"
    path.write_text("time_s;T1_degC;n_rpm\n0;20;0\n10;20,5;1.500\n20;21;1.500\n")
    reader = pipe_of(path, "T1_degC", "n_rpm")
    arrivals, _ = read(reader)
    assert [list(one.readings) for one in arrivals] == [[20.0, 0.0], [20.5, 1500.0], [21.0, 1500.0]]
    rest, _ = read(reader, json.loads(json.dumps(arrivals[1].position)))
    assert [list(one.readings) for one in rest] == [[21.0, 1500.0]]


@given(st.binary(max_size=200))
def test_any_line_is_a_row_or_a_note(line):
    reader = pipe_of(Path("-"), *NAMES)
    header = csv_lines.header_of(["T2_degC,time_s,T1_degC,other", "20,1,20,a"], reader)
    found, _ = csv_lines.items_in(reader, header, line.replace(b"\n", b""), Hands())
    assert all(isinstance(one, Arrival | Note) for one in found)


@pytest.mark.parametrize("dialect", DIALECTS)
@settings(max_examples=10, deadline=None)
@given(samples=logs(), cut=st.integers(0, 11))
def test_a_stream_in_any_dialect_gives_the_samples_of_the_file(
    tmp_path_factory, dialect, samples, cut
):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_bytes(dialect(samples, "utf-8"))
    reader = pipe_of(path, "T1_degC", "x_um", "n_rpm")
    log, (arrivals, notes) = read_log([path]), read(reader)
    assert [one.kind for one in notes] == ["source-read"]
    np.testing.assert_array_equal([one.time for one in arrivals], log.times)
    for column, told in zip(
        log.columns, np.array([one.readings for one in arrivals]).T, strict=True
    ):
        np.testing.assert_array_equal(column.to_si(told), log.at(column.name))
    # Read on from any kept sample it is the rest.
    cut %= len(samples)
    rest, _ = read(reader, json.loads(json.dumps(arrivals[cut].position)))
    assert [(one.time, one.readings) for one in rest] == [
        (one.time, one.readings) for one in arrivals[cut + 1 :]
    ]


def test_another_file_under_the_same_header_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{k},2{k},20\n" for k in range(9)]
    path.write_text("time_s,T1_degC,T2_degC\n" + "".join(rows[:4]), "utf-8")
    arrivals, _ = read(pipe_of(path, *NAMES))
    path.write_text("time_s,T1_degC,T2_degC\n" + "".join(rows[4:]), "utf-8")
    again, _ = read(pipe_of(path, *NAMES), arrivals[-1].position)
    assert [one.time for one in again] == [4.0, 5.0, 6.0, 7.0, 8.0]


def file_of(path, header, rows):
    path.write_text(header + "".join(f"{at};20;20\n" for at in rows), "utf-8")
    return path


@pytest.mark.parametrize("clock", ["Zeit", "Zeit [Europe/Berlin]"])
@pytest.mark.parametrize("following", [False, True])
def test_a_change_of_summer_time_holds_in_the_next_file(tmp_path, clock, following):
    """A logger in local time begins a file every hour; whether the service runs then or not."""
    names = ";T1_degC;T2_degC\n"
    path = file_of(tmp_path / "log.csv", clock + names, ["25.10.2026 02:40", "25.10.2026 02:50"])
    later = [
        (f"{clock}{names}", ["25.10.2026 02:00", "25.10.2026 02:10"]),
        (f"{clock}{names}", ["25.10.2026 03:00", "25.10.2026 03:10"]),
    ]
    times, position = [], None
    if following:
        times = asyncio.run(rotated(replace(pipe_of(path, *NAMES), follow=True), later))
    else:
        for part in (None, *later):
            if part is not None:
                file_of(path, *part)
            arrivals, _ = read(pipe_of(path, *NAMES), position)
            position = json.loads(json.dumps(arrivals[-1].position))
            times += [one.time for one in arrivals]
    np.testing.assert_array_equal(np.diff(times), [600.0, 600.0, 600.0, 3000.0, 600.0])


def test_a_clock_without_a_date_goes_on_in_the_file_of_the_next_day(tmp_path):
    names = "Uhrzeit;T1_degC;T2_degC\n"
    path = file_of(tmp_path / "log.csv", names, ["23:50:00", "23:55:00"])
    reader = replace(pipe_of(path, *NAMES), follow=True)
    times = asyncio.run(rotated(reader, [(names, ["00:00:00", "00:05:00"])]))
    np.testing.assert_array_equal(np.diff(times), [300.0] * 3)


def test_midnights_before_a_new_start_of_the_clock_do_not_count_in_the_next_file(tmp_path):
    names = "Uhrzeit;T1_degC;T2_degC\n"
    path = file_of(tmp_path / "log.csv", names, ["23:50:00", "00:00:00", "00:05:00"])
    arrivals, _ = read(pipe_of(path, *NAMES))
    later = replace(pipe_of(path, *NAMES), starts=86400.0)
    # A corrected start of the same file leaves its midnights passed.
    again, _ = read(later, arrivals[-2].position)
    assert [one.time for one in again] == [2 * 86400.0 + 300.0]
    file_of(path, names, ["08:00:00"])
    [first], _ = read(later, arrivals[-1].position)
    assert first.time == 86400.0 + 8 * 3600.0


async def rotated(reader, later):
    """The times that a reader finds in a file that is replaced by another one when it is read."""
    times, waiting = [], list(later)
    async for some in reader.read({}):
        times += [one.time for one in some if isinstance(one, Arrival)]
        if len(times) % 2 == 0 and any(isinstance(one, Arrival) for one in some):
            if not waiting:
                return times
            new = file_of(reader.path.with_name("new"), *waiting.pop(0))
            new.rename(reader.path)
    return times


@pytest.mark.parametrize("piped", [False, True])
def test_rows_below_another_header_are_not_read_by_the_first(tmp_path, piped):
    """A logger that was started again with its thermometers swapped: T2 was taken for T1."""
    path = tmp_path / "log.csv"
    text = "time_s,T1_degC,T2_degC\n0,20,30\n1,20,30\ntime_s,T2_degC,T1_degC\n2,30,20\n"
    if piped:
        os.mkfifo(path)
        writer = Thread(target=path.write_text, args=(text,))
        writer.start()
    else:
        path.write_text(text)
    found = []

    async def whole():
        async for some in pipe_of(path, *NAMES).read({}):
            found.extend(one for one in some if isinstance(one, Arrival))

    with pytest.raises(InputError, match=r"log\.csv: a header with other columns than the first"):
        asyncio.run(whole())
    assert [one.time for one in found] == [0.0, 1.0]
    if piped:
        writer.join()


def test_a_damaged_time_in_a_stream_leaves_out_its_row(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time_s,T1_degC,T2_degC\n0,20,20\n1e18,20,20\n2,20,20\n", "utf-8")
    arrivals, notes = read(pipe_of(path, *NAMES))
    assert [one.time for one in arrivals] == [0.0, 2.0]
    assert "'1e18' is not a time" in notes[1].text


def test_a_stream_has_the_units_clocks_and_missing_readings_of_every_table(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "Halle 4;2\nUhrzeit;T1 [°F];T2 [°C];Ende\n23:59:50;68,0;20,5;\nkein;68;20;\n"
        "23:59:58;---;9999;\n\nUhrzeit;T1 [°F];T2 [°C];Ende\n00:00:05;OL;1_0;\n"
        "00:00:10;77;-9999,0;a\n",
        "utf-8",
    )
    arrivals, notes = read(pipe_of(path, *NAMES))
    assert [one.time for one in arrivals] == [86390.0, 86398.0, 86410.0]
    expected = [[20.0, 20.5], [np.nan, np.nan], [25.0, np.nan]]
    np.testing.assert_allclose([one.readings for one in arrivals], expected, rtol=1e-14)
    assert [one.kind for one in notes] == ["source-read", "malformed", "malformed", "clock"]
    assert "T1 [°F] (temperature, degF), T2 [°C]" in notes[0].text
    assert "'kein' is not a time like that of the first row" in notes[1].text
    assert "'1_0' is not a number" in notes[2].text
    assert "midnight passed" in notes[3].text
    # The clock goes on where it stood.
    [last], _ = read(pipe_of(path, *NAMES), arrivals[1].position)
    assert last.time == 86410.0


def test_columns_and_the_clock_may_have_names_of_their_own(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("Schritt;Fühler 1;Fühler 2\nnichts\n1,5;20,5;21\n", "utf-8")
    names = {"T1_degC": "Fühler 1", "T2_degC": "Fühler 2", "time_s": "Schritt"}
    [arrival], notes = read(pipe_of(path, *NAMES, **names))
    assert (arrival.time, arrival.readings) == (1.5, [20.5, 21.0])
    assert [one.kind for one in notes] == ["source-read", "malformed"]
    with pytest.raises(InputError, match="no T3_degC; add it, or name it under columns"):
        read(pipe_of(path, *NAMES, "T3_degC", **names))


def test_a_message_says_one_time_and_one_or_all_readings():
    found = mqtt.item_of(
        TOPICS, "hall/mill", b'{"time": "2026-03-02T06:00:00Z", "T2_degC": null, "more": [1]}'
    )
    assert found.time == datetime(2026, 3, 2, 6, tzinfo=UTC).timestamp()
    assert found.readings[0] is None
    assert math.isnan(found.readings[1])
    one = mqtt.item_of(ONE_EACH, "hall/mill/T2_degC", b'{"time": 5, "value": 21.5}')
    assert (one.time, list(one.readings)) == (5.0, [None, 21.5])
    assert ONE_EACH.filter == "hall/+/+"


@pytest.mark.parametrize(
    "payload",
    [
        b'{"T1_degC": 2.0}',
        b'{"time": 1}',
        b'{"time": true, "T1_degC": 2.0}',
        b'{"time": 1, "T1_degC": "2.0"}',
        b'{"time": 1, "T1_degC": true}',
        b'{"time": 1, "T1_degC": 1' + b"0" * 400 + b"}",
        b"[" * 5000,
        b'{"time": 1, "T1_degC": 2.0, "x": "' + b"x" * 20_000 + b'"}',
    ],
)
def test_what_is_no_readings_is_refused_as_a_whole(payload):
    assert isinstance(mqtt.item_of(TOPICS, "hall/mill", payload), Note)


def test_a_bad_value_of_opcua_is_a_missing_reading():
    stamp = datetime(2026, 3, 2, 6, tzinfo=UTC)
    good = ua.DataValue(ua.Variant(21.5), SourceTimestamp=stamp)
    bad = ua.DataValue(
        ua.Variant(21.5),
        StatusCode=ua.StatusCode(ua.StatusCodes.BadSensorFailure),
        SourceTimestamp=stamp,
    )
    assert list(opcua.item_of("mill", (1,), 2, good).readings) == [None, 21.5]
    assert math.isnan(opcua.item_of("mill", (1,), 2, bad).readings[1])
    assert isinstance(opcua.item_of("mill", (1,), 2, ua.DataValue(ua.Variant("x"))), Note)
    assert isinstance(opcua.item_of("mill", (1,), 2, ua.DataValue(ua.Variant(1.0))), Note)


def test_values_of_one_time_are_one_arrival_in_the_order_of_time():
    def at(k, reading, value):
        told = [None, None]
        told[reading] = value
        return Arrival("mill", float(k), told, 0.0)

    found = opcua.in_order([at(2, 0, 1.0), at(1, 0, 2.0), Note("x", "y"), at(1, 1, 3.0)])
    assert isinstance(found[0], Note)
    assert [(one.time, list(one.readings)) for one in found[1:]] == [
        (1.0, [2.0, 3.0]),
        (2.0, [1.0, None]),
    ]


def test_two_readings_may_be_one_variable_or_topic():
    """As two columns of a CSV may be: a thermometer that others are compared with."""
    one = mqtt.topics_of(MqttSource(kind="mqtt", topic="{reading}"), {"mill": ("air", "T", "air")})
    assert mqtt.item_of(one, "air", b'{"time": 1, "value": 2}').readings == [2.0, None, 2.0]
    source = OpcuaSource(
        kind="opcua", url="opc.tcp://127.0.0.1", node="ns=2;s={reading}", security="none"
    )
    fed = {"mill": SimpleNamespace(intake=SimpleNamespace(wanted=3))}
    service = SimpleNamespace(folder=None)
    nodes = opcua.opcua_reader(service, source, {"mill": ("air", "T", "air")}, fed).nodes
    assert nodes == {"ns=2;s=air": ("mill", (0, 2)), "ns=2;s=T": ("mill", (1,))}
    value = ua.DataValue(ua.Variant(2.0), SourceTimestamp=datetime(2026, 3, 2, tzinfo=UTC))
    assert opcua.item_of(*nodes["ns=2;s=air"], 3, value).readings == [2.0, None, 2.0]


def test_a_displacement_that_opcua_does_not_read_is_not_asked_for_in_vain():
    source = OpcuaSource(
        kind="opcua", url="opc.tcp://127.0.0.1", node="ns=2;s={reading}", security="none"
    )
    fed = {"mill": SimpleNamespace(intake=SimpleNamespace(wanted=1))}
    service = SimpleNamespace(folder=None)
    assert opcua.opcua_reader(service, source, {"mill": ("T", ABSENT)}, fed).nodes
    with pytest.raises(InputError, match=r"columns: 'probe' is a displacement.* mill\.Probe"):
        opcua.opcua_reader(service, source, {"mill": ("T", "probe")}, fed)


def test_of_two_values_of_a_variable_at_one_time_the_last_counts():
    """As in every source, whether or not a server sends them in one message."""

    def at_one_time(value):
        return Arrival("mill", 1.0, [value, None], 0.0)

    for first, last in ((21.0, 22.0), (math.nan, 22.0)):
        found = opcua.in_order([at_one_time(first), at_one_time(last)])
        assert [list(one.readings) for one in found] == [[last, None]]


@pytest.mark.parametrize(
    ("quality", "number", "status", "code"),
    [
        (Quality.GOOD, 1, "ok", "Good"),
        (Quality.GOOD, 1, "beyond-time", "Good"),
        (Quality.UNCERTAIN, 1, "silent", "UncertainLastUsableValue"),
        (Quality.UNCERTAIN, 1, "beyond-heat silent", "UncertainLastUsableValue"),
        (Quality.UNCERTAIN, 1, "refused", "UncertainLastUsableValue"),
        (Quality.UNCERTAIN, 1, "sensor-distrusted:T1", "UncertainSubNormal"),
        (Quality.UNCERTAIN, 1, "unsettled", "UncertainInitialValue"),
        (Quality.UNCERTAIN, 1, "beyond-heat", "UncertainEngineeringUnitsExceeded"),
        (Quality.BAD, 1, "silent", "BadNoCommunication"),
        (Quality.BAD, 0, "no-sample", "BadWaitingForInitialData"),
        (Quality.BAD, 1, "ok", "BadSensorFailure"),
    ],
)
def test_every_doubt_has_a_status_code_of_opcuas_own(quality, number, status, code):
    class Said:
        pass

    said = Said()
    said.quality, said.number, said.status = quality, number, status
    assert ua.StatusCode(status_of(said)).name == code


def test_an_opcua_client_sees_a_reading_in_the_unit_of_its_name():
    """A position in m was one in µm, a feed in mm/min one in minutes, a speed one in seconds."""
    units = {
        "T1_degC": "°C", "T1 [°C]": "°C", "T1_K": "K", "x_um": "µm", "y_pos_m": "m",
        "y_pos_mm": "mm", "n_rpm": "rpm", "n_rad_s": "rad/s", "n_deg_s": "°/s",
        "y_mm_min": "mm/min", "y_mm_s": "mm/s", "spindle_kW": "kW", "state": "",
    }  # fmt: skip
    layout = Layout(("x",), (), (), tuple(units))
    for wanted in (0, len(units)):  # as probes, which operators write, and as readings
        found = {one.name: one.unit for one in variables_of(layout, True, wanted)}
        assert {name: found[name] for name in units} == units


def test_readings_of_the_displacement_are_read_only_where_the_columns_name_them(model):
    """A log that holds the truth does not correct an estimator that will have none."""
    log = replace(model, intake=of_columns(("T1_degC", "x_um"), 1))
    lines, found = ["time_s,T1_degC,x_um\n", "1,20.0,35.0\n", "2,20.0,35.0\n"], []
    for columns in ({}, {"x_um": "x_um"}):
        names = dict(zip(log.intake.names, source_names(log, columns, "columns"), strict=True))
        reader = csv_lines.CsvReader("mill", Path("x.csv"), names, 1, 0.0, True)
        found.append(csv_lines.header_of(lines, reader).places[1] is None)
    assert found == [True, False]
