"""Every kind of estimator goes through the same door, also one that another distribution brings."""

import asyncio
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from live_parts import serving, until
from machine_logs import machine_log
from typer.testing import CliRunner
from written_estimates import assert_compensate_reads_what_is_written

import thermojoint as tj
from estimator.interface import Channel, follow
from estimator.registry import known_schemas
from estimator.states import as_bytes, from_bytes
from thermojoint.artefacts.errors import ConvergenceError, InputError, ThermojointError
from thermojoint.cli.app import app
from thermojoint.live.archive import Archive
from thermojoint.models.baselines import Autoregression, Baselines, Regression, write_baselines
from thermojoint.models.parameters import Span
from thermojoint.models.sensors import ROLES

ROD = {"schema": "lagging-rod", "gain_um_K": 5.0, "tau_s": 300.0}
SETTINGS = """cycle_s = 1.0
resolution_um = 0.1
rate_um_s = 2.0
dead_band_um = 0.0
oldest_s = 60.0
freeze_s = 10.0
decay_s = 20.0

[axes.Z]
follows = "z"
sign = -1
"""
TIMES = 10.0 * np.arange(60)
RISE = 8.0 * (1.0 - np.exp(-TIMES / 200.0))


@pytest.fixture
def installed(monkeypatch):
    """The distribution of somebody else, as an installer would leave it."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "helpers" / "another_distribution"))


@pytest.fixture
def here(installed, tmp_path, monkeypatch):
    """A folder with the model of a rod, a log, settings of offsets, and a response."""
    monkeypatch.chdir(tmp_path)
    Path("rod.json").write_text(json.dumps(ROD))
    lines = ["time_s,T1_K", *(f"{t!r},{x!r}" for t, x in zip(TIMES, RISE, strict=True))]
    text = "\n".join(lines).replace("np.float64(", "").replace(")", "") + "\n"
    Path("log.csv").write_text(text)
    Path("offsets.toml").write_text(SETTINGS)
    response = tj.make_response(
        {
            "heat_input": np.ones(60),
            "temperature": RISE[:, None],
            "displacement": 5e-6 * RISE[:, None],
        },
        {"time": TIMES, "probe": ["T1"], "axis": ["z"]},
    )
    tj.write_response(response, Path("step.nc"))
    return tmp_path


def command(*words):
    result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_a_kind_from_outside_is_estimated_with_saved_and_resumed(here):
    command("estimate", "rod.json", "log.csv", "--out", "whole.csv")
    lines = Path("log.csv").read_text().splitlines(keepends=True)
    Path("first.csv").write_text("".join(lines[:31]))
    Path("second.csv").write_text("".join([lines[0], *lines[31:]]))
    command("estimate", "rod.json", "first.csv", "--out", "a.csv", "--save-state", "state.json")
    command("estimate", "rod.json", "second.csv", "--out", "b.csv", "--continue", "state.json")
    whole, a, b = (Path(f"{name}.csv").read_text().splitlines() for name in ("whole", "a", "b"))
    assert whole[0] == "time_s,lag_K,z_um,z_band_um,status,quality"
    assert [*a, *b[1:]] == whole
    Path("rod.json").write_text(json.dumps(ROD | {"tau_s": 200.0}))
    with pytest.raises(InputError, match="state of another model"):
        tj.resume_estimator("rod.json", "state.json")


def test_a_kind_from_outside_is_validated_with_noise_and_compensated(here):
    command("validate", "rod.json", "step.nc", "--json", "v.json")
    command("validate", "rod.json", "step.nc", "--noise-pp", "0.1", "--json", "noisy.json")
    (free,), (noisy,) = (json.loads(Path(f).read_text())["rows"] for f in ("v.json", "noisy.json"))
    assert free["peak_total_um"] == pytest.approx(40.0, rel=0.1)
    assert 0.0 < free["rms_error_um"] < 15.0
    assert noisy["rms_error_um"] != free["rms_error_um"]
    command("estimate", "rod.json", "step.nc", "--out", "e.csv")
    command("compensate", "e.csv", "--settings", "offsets.toml", "--out", "offsets.csv")
    last = Path("offsets.csv").read_text().splitlines()[-1].split(",")
    estimated = Path("e.csv").read_text().splitlines()[-1].split(",")
    assert float(last[1]) == pytest.approx(-float(estimated[2]), abs=0.5)


def test_a_kind_from_outside_is_served_and_goes_on_after_a_stop(here):
    lines = Path("log.csv").read_text().splitlines(keepends=True)
    start = 1_772_431_200.0
    moved = [
        lines[0],
        *(f"{start + t!r},{x!r}\n" for t, x in zip(TIMES.tolist(), RISE.tolist(), strict=True)),
    ]
    given = {
        "folder": "state",
        "models": {"m": {"file": "rod.json", "interval_s": 10.0}},
        "machines": {"mill": {"model": "m", "source": "line"}},
        "sources": {"line": {"kind": "csv", "path": "live.csv", "follow": False}},
    }
    for end in (31, 61):
        Path("live.csv").write_text("".join(moved[:end]))

        async def live():
            async with serving(given, here) as running:
                await until(running.stop.is_set)

        asyncio.run(live())
    history = Archive(here / "state" / "history.sqlite").history("mill", 0.0, 1e11, 10**6)
    rod = tj.open_estimator("rod.json")
    samples = [(start + t, x) for t, x in zip(TIMES.tolist(), RISE.tolist(), strict=True)]
    expected = [one.displacement for _, one in tj.follow(rod, samples, rod.initial_state())]
    np.testing.assert_allclose(history.columns.displacement, expected, rtol=1e-12, atol=0.0)


def test_without_the_distribution_its_models_are_refused_in_one_line(tmp_path):
    path = tmp_path / "rod.json"
    path.write_text(json.dumps(ROD))
    assert "lagging-rod" not in known_schemas()
    with pytest.raises(InputError, match="'lagging-rod' is not an installed kind") as error:
        tj.open_estimator(path)
    assert "\n" not in str(error.value)


def test_a_kind_refuses_what_it_has_no_use_for(here):
    for words, told in (
        (("estimate", "rod.json", "log.csv", "--ageing", "film"), "--ageing: not for a lagging"),
        (("estimate", "rod.json", "log.csv", "--warm"), "--warm: not for a lagging rod"),
        (("estimate", "rod.json", "log.csv", "--interval-s", "5"), "--interval-s: not for"),
        (("estimate", "rod.json", "log.csv", "--run-length-min", "5"), "--run-length-min: not"),
        (("validate", "rod.json", "step.nc", "--seed", "1"), "--seed: goes with --noise-pp"),
        (("validate", "rod.json", "step.nc", "--reference", "step.nc"), "reference: not for"),
        (("export", "rod.json"), "has no program"),
    ):
        out = "--json" if words[0] == "validate" else "--out"
        result = CliRunner().invoke(app, [*words, out, "out"])
        assert told in str(result.exception)
        assert not Path("out").exists()
    with pytest.raises(InputError, match="reading noise: not for a lagging rod"):
        tj.open_estimator("rod.json", reading_noise=1e-6)


@pytest.fixture(scope="module")
def models(hand_made_model, tmp_path_factory):
    """A model file of every kind that comes with the program, but for the joint-aware one."""
    folder = tmp_path_factory.mktemp("models")
    tj.write_model(hand_made_model, folder / "model.json", tj.Provenance("round numbers"))
    tj.write_assembly(tj.assemble(hand_made_model, 2.0, 7200.0), folder / "assembly.json")
    tj.write_learned(tj.learn(machine_log(), ["x_um", "z_um"], 2), folder / "learned.json")
    weights = Regression((), {"x": (1e-6, -2e-6, 3e-6, 4e-6)})
    arx = {"x": Autoregression((0.5,), ((1e-6, 0.0, 2e-6, 0.0),))}
    span = Span(3600.0, (0.0, 3.0), dict.fromkeys(ROLES, (0.0, 20.0)))
    write_baselines(Baselines(weights, weights, arx, 60.0, span), folder / "baselines.json")
    return folder


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("model.json", "fchs"),
        ("assembly.json", "fchs"),
        ("learned.json", "learned"),
        ("baselines.json", "ridge"),
    ],
)
def test_what_estimate_writes_is_what_compensate_reads(models, tmp_path, name, kind):
    assert_compensate_reads_what_is_written(models / name, tmp_path, kind)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("estimate", "assembly.json", "log.csv"), "--interval-s"),
        (("estimate", "assembly.json", "log.csv"), "--run-length-min"),
        (("export", "assembly.json"), "--run-length-min"),
    ],
)
def test_an_assembled_estimator_is_not_assembled_for_something_else(
    models, tmp_path, monkeypatch, words, option
):
    monkeypatch.chdir(models)
    result = CliRunner().invoke(app, [*words, option, "10", "--out", str(tmp_path / "out")])
    assert str(result.exception) == f"{option}: not for an assembled estimator; leave it out"
    assert not (tmp_path / "out").exists()


def test_a_log_in_fahrenheit_is_estimated_with_a_warning(models, tmp_path):
    names = [f"{name}_degC" for name in (*ROLES, "ambient")]
    rows = "".join(f"{2 * k},{','.join(['68'] * len(names))}\n" for k in range(3))
    (tmp_path / "log.csv").write_text(f"time_s,{','.join(names)}\n{rows}")
    said = command(
        "estimate", models / "baselines.json", tmp_path / "log.csv", "--out", tmp_path / "o"
    )
    assert said.count("warning: ") == 1
    assert "ambient_degC = 68 is implausible" in " ".join(said.split())


def test_a_regression_has_no_length_of_a_run(models, tmp_path):
    words = ["estimate", str(models / "baselines.json"), "log.csv", "--run-length-min", "10"]
    result = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "out")])
    told = "--run-length-min: not for a file of baselines; leave it out"
    assert str(result.exception) == told


def test_a_run_is_continued_with_what_it_was_begun_with(models, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, begun in (("first", 0), ("second", 100)):
        rows = "".join(f"{begun + 2 * k},0.2,0,0\n" for k in range(5))
        Path(f"{name}.csv").write_text("time_s,delta_T_K,T1_K,T2_K\n" + rows)
    model, other = str(models / "model.json"), "other.json"
    command("assemble", model, "--interval-s", "5", "--out", other)
    command("estimate", model, "first.csv", "--save-state", "state.json", "--out", "one.csv")
    going_on = ("second.csv", "--continue", "state.json", "--out", "two.csv")
    for words, told in (
        ((model, "--interval-s", "5"), "--interval-s 5: the run was begun with 2; leave it out"),
        ((model, "--run-length-min", "60"), "--run-length-min 60: the run was begun with 120"),
        ((other,), "assembled for 2 s and 120 min; give that one"),
    ):
        result = CliRunner().invoke(app, ["estimate", *words, *going_on])
        assert told in str(result.exception)
        assert not Path("two.csv").exists()
    command("estimate", model, "--interval-s", "2", "--run-length-min", "120", *going_on)


def test_a_damaged_state_is_refused_in_one_line(here):
    rod = tj.open_estimator("rod.json")
    tj.save_state(rod, rod.initial_state(), "state.json")
    text = Path("state.json").read_text()
    for damaged in (text.replace("null", "1.0"), text.replace("lagging-rod", "lagging-bar")):
        Path("state.json").write_text(damaged)
        with pytest.raises(InputError, match=r"damaged; start afresh") as error:
            tj.resume_estimator("rod.json", "state.json")
        assert "\n" not in str(error.value)


@given(
    hnp.arrays(float, st.integers(0, 40), elements=st.floats(allow_infinity=False, width=64)),
    st.integers(0, 10**6),
)
def test_a_state_comes_back_from_its_bytes_and_a_changed_byte_is_found(values, at):
    data = as_bytes("a model", values)
    assert from_bytes(data, "a model", "mill").tobytes() == values.tobytes()
    with pytest.raises(InputError, match="another model"):
        from_bytes(data, "another one", "mill")
    k = at % len(data)
    with pytest.raises(InputError, match=r"damaged|another model"):
        from_bytes(data[:k] + bytes([data[k] ^ 1]) + data[k + 1 :], "a model", "mill")


class Stopping:
    """Makes nothing of its second sample."""

    channels = (Channel("T1", "K"),)

    def __init__(self, error):
        self.error = error

    def sample(self, state, time, values):
        if time > 10.0:
            raise self.error("joint: no equilibrium; give smaller steps")
        return state, None


@pytest.mark.parametrize("error", [InputError, ConvergenceError])
def test_the_sample_that_stops_a_run_is_named_with_its_time(error):
    """Of a joint without an equilibrium nobody knew in which of a day's rows to look."""
    with pytest.raises(ThermojointError, match=r"^sample 1 at 20\.5 s: joint: no eq") as stopped:
        list(follow(Stopping(error), [(0.5, 1.0), (20.5, 1.0)], np.zeros(1)))
    assert type(stopped.value) is error
