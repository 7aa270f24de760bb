"""What comes in by the doors of the service: thousands of malformed readings change nothing."""

import json
import math
from datetime import UTC, datetime
from pathlib import Path

import pytest
from asyncua import ua
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.live_fuzz import DOORS, check
from estimator.quality import Quality
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.opcua_values import status_of
from thermojoint.live.readers import csv_pipe, mqtt, opcua
from thermojoint.live.served import served
from thermojoint.live.settings import ModelSection, MqttSource
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly

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
def model(hand_made_model, tmp_path_factory):
    base = tmp_path_factory.mktemp("doors")
    write_assembly(assemble(hand_made_model, 1.0, 7200.0), base / "model.json")
    return served(ModelSection(file=base / "model.json"), base / "kept")


@pytest.mark.parametrize("door", DOORS)
def test_damaged_readings_change_no_estimate_and_leave_nothing(door, model):
    found = check(door, model, 150, seed=1)
    assert found["equal"]
    assert found["grown_kb"] < 512.0


@given(st.binary(max_size=200) | JSON.map(lambda one: json.dumps(one).encode()))
def test_any_payload_is_readings_or_a_note(payload):
    found = mqtt.told_by(TOPICS, "hall/mill", payload)
    if isinstance(found, Arrival):
        assert all(one is None or isinstance(one, float) for one in found.told)
        assert isinstance(found.time, float)
    else:
        assert len(found.text) < 300


@given(st.text(max_size=60))
def test_any_topic_is_of_a_machine_or_a_note(topic):
    found = mqtt.told_by(TOPICS, topic, b'{"time": 1, "T1_degC": 2}')
    assert isinstance(found, Arrival) == (topic == "hall/mill")


@given(st.binary(max_size=200))
def test_any_line_is_a_row_or_a_note(line):
    pipe = csv_pipe.Pipe("mill", None, NAMES, 2, 0.0, follow=True)
    header = csv_pipe.header_of("T2_degC,time_s,T1_degC,other", pipe)
    found = csv_pipe._told(pipe, header, line.replace(b"\n", b""), None)
    assert isinstance(found, Arrival | Note)


def test_a_message_says_one_time_and_one_or_all_readings():
    found = mqtt.told_by(
        TOPICS, "hall/mill", b'{"time": "2026-03-02T06:00:00Z", "T2_degC": null, "more": [1]}'
    )
    assert found.time == datetime(2026, 3, 2, 6, tzinfo=UTC).timestamp()
    assert found.told[0] is None
    assert math.isnan(found.told[1])
    one = mqtt.told_by(ONE_EACH, "hall/mill/T2_degC", b'{"time": 5, "value": 21.5}')
    assert (one.time, list(one.told)) == (5.0, [None, 21.5])
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
    assert isinstance(mqtt.told_by(TOPICS, "hall/mill", payload), Note)


def test_a_bad_value_of_opcua_is_a_missing_reading():
    stamp = datetime(2026, 3, 2, 6, tzinfo=UTC)
    good = ua.DataValue(ua.Variant(21.5), SourceTimestamp=stamp)
    bad = ua.DataValue(
        ua.Variant(21.5),
        StatusCode=ua.StatusCode(ua.StatusCodes.BadSensorFailure),
        SourceTimestamp=stamp,
    )
    assert list(opcua.told_by("mill", 1, 2, good).told) == [None, 21.5]
    assert math.isnan(opcua.told_by("mill", 1, 2, bad).told[1])
    assert isinstance(opcua.told_by("mill", 1, 2, ua.DataValue(ua.Variant("x"))), Note)
    assert isinstance(opcua.told_by("mill", 1, 2, ua.DataValue(ua.Variant(1.0))), Note)


def test_values_of_one_time_are_one_arrival_in_the_order_of_time():
    def at(k, reading, value):
        told = [None, None]
        told[reading] = value
        return Arrival("mill", float(k), told, 0.0)

    found = opcua.in_order([at(2, 0, 1.0), at(1, 0, 2.0), Note("x", "y"), at(1, 1, 3.0)])
    assert isinstance(found[0], Note)
    assert [(one.time, list(one.told)) for one in found[1:]] == [
        (1.0, [2.0, 3.0]),
        (2.0, [1.0, None]),
    ]


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


def test_a_line_of_the_pipe_has_the_numbers_and_missing_readings_of_every_table():
    pipe = csv_pipe.Pipe("mill", Path("-"), ("a_degC", "b_degC"), 2, 0.0, follow=True)
    header = csv_pipe.header_of("time_s,a_degC,b_degC", pipe)
    assert csv_pipe.row_of("10,20.5,21", header, 0.0) == (10.0, [20.5, 21.0])
    time, (a, b) = csv_pipe.row_of("11,---,OL", header, 0.0)
    assert time == 11.0
    assert math.isnan(a)
    assert math.isnan(b)
    for line in ("12,1_0,20", "1_3,20,20", ",20,20"):
        with pytest.raises(ValueError, match=r"no number|time is missing"):
            csv_pipe.row_of(line, header, 0.0)
