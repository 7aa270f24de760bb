"""The uncertainty of a parameter of a thermal test: what enters it, and how it adds up."""

import json

import numpy as np
import pytest

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import write_response
from thermojoint.standards.iso230_3.evaluation import evaluate, with_uncertainties
from thermojoint.standards.iso230_3.instruments import Instruments, read_instruments
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import Record, with_tilts
from thermojoint.standards.iso230_3.uncertainty import scatter

HOUR = 3600.0
TIMES = np.arange(0.0, 4 * HOUR + 1.0, 60.0)
GIVEN = """
[probe]
error_um = 0.9
drift_um = 1.2
distance_error_mm = 1.0
[thermometer]
error_K = 0.3
[holder]
length_mm = 200.0
expansion_1_K = 12e-6
rise_K = 1.5
[repeat]
displacement_um = 0.7
temperature_K = 0.05
"""


def warmed(noise=0.0):
    grown = -np.expm1(-TIMES / HOUR)
    noise = noise * np.random.default_rng(1).standard_normal((2, TIMES.size))
    pair = {"X1": 60e-6 * grown + noise[0], "X2": 20e-6 * grown + noise[1]}
    record = Record(TIMES, pair, {"nose": 20.0 + 10.0 * grown, "holder": 20.0 + 2.0 * grown})
    return with_tilts(record, {"B": ("X1", "X2")}, 0.2)


def read(tmp_path, text):
    path = tmp_path / "instruments.toml"
    path.write_text(text)
    return read_instruments(path)


def budgets(record, instruments):
    return with_uncertainties(evaluate(Protocol.SPINDLE, record), record, instruments).uncertainties


def parts(found):
    return {one.source: one.standard for one in found.contributions}


def test_a_displacement_has_probe_drift_holder_and_repeat(tmp_path):
    found = budgets(warmed(), read(tmp_path, GIVEN))["d(X1)t"]
    limits = {"probe": 0.9, "drift of the probe": 0.6, "holder of the probe": 0.5 * 3.6}
    expected = {name: 1e-6 * limit * np.sqrt(2 / 3) for name, limit in limits.items()}
    assert parts(found) == pytest.approx(expected | {"repeat": 0.7e-6}, rel=1e-9, abs=0)
    total = np.sqrt(sum(value**2 for value in [*expected.values(), 0.7e-6]))
    assert found.combined == pytest.approx(total, rel=1e-9, abs=0)
    assert found.expanded == pytest.approx(2 * total, rel=1e-9, abs=0)


def test_a_tilt_has_two_probes_and_their_distance(tmp_path):
    found = budgets(warmed(), read(tmp_path, GIVEN))
    one, tilt = parts(found["d(X1)t"]), parts(found["d(B)t"])
    assert tilt["probe"] == pytest.approx(np.sqrt(2) * one["probe"] / 0.2, rel=1e-9, abs=0)
    turned = 40e-6 * -np.expm1(-4.0) / 0.2
    assert tilt["distance"] == pytest.approx(turned * 1e-3 / 0.2 / np.sqrt(3), rel=1e-9, abs=0)
    # No repeated tests of a tilt were given.
    assert tilt["repeat"] < 1e-6


def test_a_temperature_has_its_thermometer(tmp_path):
    found = parts(budgets(warmed(), read(tmp_path, GIVEN))["ΔT(nose)60"])
    assert found == pytest.approx({"thermometer": 0.3 * np.sqrt(2 / 3), "repeat": 0.05}, rel=1e-9)


def test_ranges_of_tests_with_errors_as_assumed_scatter_by_the_combined_uncertainty():
    """Probe and drift drawn within their limits, noise with its deviation, 4000 tests."""
    instruments, noise = Instruments(), 0.3e-6
    found = budgets(warmed(noise), instruments)["d(X1)t"]
    rng, size = np.random.default_rng(2), (2, 4000)
    readings = noise * rng.standard_normal(size)
    readings += rng.uniform(-1.0, 1.0, size) * instruments.probe.value
    readings += rng.uniform(-0.5, 0.5, size) * instruments.drift.value
    assert found.combined == pytest.approx((readings[1] - readings[0]).std(), rel=0.1, abs=0)


def test_a_holder_grows_with_its_thermometer(tmp_path):
    text = GIVEN.replace("rise_K = 1.5", 'rise_K = "holder"')
    found = budgets(warmed(), read(tmp_path, text))
    rise = 2.0 * -np.expm1(-1.0)
    assert parts(found["d(X1)60"])["holder of the probe"] == pytest.approx(
        0.5 * 0.2 * 12e-6 * rise * np.sqrt(2 / 3), rel=1e-9, abs=0
    )
    wrong = read(tmp_path, text.replace('"holder"', '"older"'))
    with pytest.raises(InputError, match=r"holder: no temperature .* did you mean 'holder'"):
        budgets(warmed(), wrong)


def test_what_is_not_given_is_assumed_and_said_so(tmp_path):
    found = budgets(warmed(), read(tmp_path, "[probe]\nerror_um = 0.2\n"))["d(X1)t"]
    bases = {one.source: one.basis for one in found.contributions}
    assert bases["probe"] == "instruments.toml"
    assert bases["drift of the probe"].startswith("assumed")
    assert "no repeated tests" in bases["repeat"]
    assert "holder of the probe" not in bases


@pytest.mark.parametrize("unread", [0, 40])
def test_the_scatter_of_readings_is_that_of_their_noise(unread):
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(20.0, 60.0, 2000))
    smooth = 100.0 * np.sin(times / 4e4) + np.where(times > 4e4, 50.0, 0.0)
    values = smooth + 0.5 * rng.standard_normal(times.size)
    values[rng.permutation(times.size)[:unread]] = np.nan
    assert scatter(times, values) == pytest.approx(0.5, rel=0.1)
    assert scatter(times, smooth) < 1e-2


def test_readings_that_hardly_change_scatter_by_their_resolution():
    values = np.where(np.arange(50) > 25, 0.3, 0.1)
    assert scatter(np.arange(50.0), values) == pytest.approx(0.2 / np.sqrt(12), rel=1e-9)
    assert scatter(np.arange(2.0), values[:2]) < 1e-9


def test_a_tilt_scatters_by_the_resolution_of_its_probes():
    """In whole micrometres: their differences differ in the last digits of a number."""
    grown = -np.expm1(-TIMES / HOUR)
    pair = {"X1": 1e-6 * np.round(40.0 * grown), "X2": 1e-6 * np.round(15.0 * grown)}
    tilt = with_tilts(Record(TIMES, pair, {}), {"B": ("X1", "X2")}, 0.15).tilts["B"]
    assert scatter(TIMES, tilt) >= 0.999 * 1e-6 / 0.15 / np.sqrt(12)


# --- the command


@pytest.fixture
def log(tmp_path):
    path, record = tmp_path / "log.csv", warmed(1e-7)
    rows = zip(TIMES, record.displacements["X1"], record.temperatures["holder"], strict=True)
    text = "".join(f"{t:.0f},{1e6 * x:.3f},{warm:.2f}\n" for t, x, warm in rows)
    path.write_text(f"time_s,x_um,holder_degC\n{text}")
    return path


def test_the_command_shows_the_uncertainty_in_table_report_and_json(command, log, tmp_path):
    instruments = tmp_path / "instruments.toml"
    instruments.write_text(GIVEN.replace("rise_K = 1.5", 'rise_K = "holder"'))
    page, content = tmp_path / "page.html", tmp_path / "found.json"
    given = ["--test", "spindle", "--instruments", instruments, "--out", page, "--json", content]
    code, out, _ = command("iso230-3", log, *given)
    assert code == 0
    row = json.loads(content.read_text("utf-8"))["parameters"][0]
    budget = row["uncertainty"]
    own = [one["standard"] for one in budget["contributions"]]
    assert budget["expanded"] == pytest.approx(2 * np.linalg.norm(own))
    assert 1.0 < budget["expanded"] < row["value"]
    shown = f"{budget['expanded']:.2g}"
    for where in (out, page.read_text("utf-8")):
        assert shown in where
        assert "instruments.toml, holder" in where


def test_a_response_has_no_uncertainty_unless_instruments_are_given(
    command, coarse_response, tmp_path
):
    path, instruments = tmp_path / "response.nc", tmp_path / "instruments.toml"
    write_response(coarse_response, path)
    instruments.write_text("")
    for options, known in ([], False), (["--instruments", instruments], True):
        content = tmp_path / "etve.json"
        assert command("iso230-3", path, "--test", "etve", *options, "--json", content)[0] == 0
        rows = json.loads(content.read_text("utf-8"))["parameters"]
        assert all((row["uncertainty"] is not None) == known for row in rows)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[probe]\nerorr_um = 1.0\n", "error_um"),
        ("[thermometer]\nerror_K = -0.1\n", "thermometer.error_K"),
        ("[holder]\nlength_mm = 100.0\nexpansion_1_K = 1e-5\n", "rise_K"),
    ],
)
def test_a_wrong_file_of_instruments_is_refused_in_one_line(command, log, tmp_path, text, said):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    code, _, err = command("iso230-3", log, "--test", "spindle", "--instruments", path)
    assert (code, err.count("\n")) == (2, 1)
    assert said in err
