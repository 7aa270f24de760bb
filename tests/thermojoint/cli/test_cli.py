"""The command line: what every command writes and says, and one line for every mistake."""

import io
import json
import re
import signal
import subprocess
import sys
import time
import tomllib
from importlib.resources import files

import numpy as np
import pytest
import typer
from reference_case import lasting
from repository import ROOT, TOP, modules

from thermojoint.artefacts.response import read_response, write_response
from thermojoint.cli.app import app
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly
from thermojoint.models.model_file import Provenance, read_model, write_model
from thermojoint.paper import reproduce
from thermojoint.pictures import view


@pytest.fixture(scope="module")
def files_at_hand(tmp_path_factory, coarse_response, hand_made_model):
    """A good case, response, model and CSV, and spoilt ones of each."""
    folder = tmp_path_factory.mktemp("input")
    (folder / "case.toml").write_text(lasting(1.0))
    write_response(coarse_response, folder / "response.nc")
    write_model(hand_made_model, folder / "model.json", Provenance(case="by hand"))
    (folder / "samples.csv").write_text(
        "time_s,delta_T_K,T1_K,T2_K\n"
        + "".join(f"{2 * k},{0.01 * k},{0.001 * k},{0.002 * k**2}\n" for k in range(20))
    )

    def spoil(name, original, old, new):
        text = (folder / original).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    spoil("unknown-key.toml", "case.toml", "friction_coefficient", "friction_coeficient")
    spoil("no-region.toml", "case.toml", '"column_base"', '"column_bas"')
    spoil("no-probe.toml", "case.toml", 'point = "A"', 'point = "C"')
    spoil("negative.toml", "case.toml", "conductivity_W_mK = 47.0", "conductivity_W_mK = -47.0")
    spoil("nan.toml", "case.toml", "density_kg_m3 = 7200.0", "density_kg_m3 = nan")
    spoil("broken.toml", "case.toml", "[joints.knee]", "[joints.knee")
    spoil(
        "backwards.toml",
        "case.toml",
        'kind = "step"\nlevel = 1.0',
        'kind = "sampled"\nfile = "backwards-history.csv"',
    )
    (folder / "backwards-history.csv").write_text("time_s,heat_input\n0,0\n10,1\n10,2\n")
    whole = (folder / "response.nc").read_bytes()
    (folder / "truncated.nc").write_bytes(whole[: len(whole) // 2])
    text = (folder / "model.json").read_text()
    (folder / "truncated.json").write_text(text[: len(text) // 2])
    spoil("other-version.json", "model.json", '"schema_version": 3', '"schema_version": 99')
    spoil("nan.csv", "samples.csv", "\n20,0.1,", "\n20,nan,")
    spoil("word.csv", "samples.csv", "\n20,0.1,", "\n20,warm,")
    spoil("backwards.csv", "samples.csv", "\n20,", "\n18,")
    spoil("short-row.csv", "samples.csv", "\n20,0.1,", "\n20,")
    spoil("no-column.csv", "samples.csv", "T2_K", "T2_F")
    (folder / "two-units.csv").write_text(
        "time_s,a_degC,b_degC,T1_degC,T1_degF,T2_degC,ambient_degC\n0,20,20,20,150,20,20\n"
    )
    spoil("open-circuit.csv", "samples.csv", "\n20,0.1,", "\n20,0.1,9.9e37,0\n21,0,")
    spoil("stray-quote.csv", "samples.csv", "\n20,0.1,", '\n20,0.1,"' + 140_000 * "0")
    (folder / "truncated.npz").write_bytes(b"PK\x03\x04 not a state")
    return folder


MISTAKES = {
    "unknown key": (["simulate", "unknown-key.toml", "--out"], "friction_coefficient"),
    "missing region": (["simulate", "no-region.toml", "--out"], "column_base"),
    "missing probe": (["simulate", "no-probe.toml", "--out"], "'C'"),
    "negative property": (["simulate", "negative.toml", "--out"], "conductivity_W_mK"),
    "NaN property": (["simulate", "nan.toml", "--out"], "density_kg_m3"),
    "no TOML": (["simulate", "broken.toml", "--out"], "TOML"),
    "no such case": (["simulate", "nowhere.toml", "--out"], "nowhere.toml"),
    "history goes back": (["simulate", "backwards.toml", "--out"], "times must increase"),
    "truncated state": (
        ["simulate", "case.toml", "--continue", "truncated.npz", "--out"],
        "truncated.npz",
    ),
    "truncated response": (["validate", "model.json", "truncated.nc", "--json"], "truncated"),
    "a model for baselines": (
        ["validate", "model.json", "response.nc", "--baselines", "model.json", "--json"],
        "thermojoint-baselines",
    ),
    "truncated reference": (
        ["calibrate", "--reference", "truncated.nc", "--input", "2=response.nc", "--out"],
        "truncated",
    ),
    "truncated model": (["estimate", "truncated.json", "samples.csv", "--out"], "truncated"),
    "another version": (["estimate", "other-version.json", "samples.csv", "--out"], "version"),
    "no such model": (["estimate", "nothing.json", "samples.csv", "--out"], "nothing.json"),
    "sample is a word": (["estimate", "model.json", "word.csv", "--out"], "'warm'"),
    "samples go back": (["estimate", "model.json", "backwards.csv", "--out"], "lines 11 and 12"),
    "row too short": (["estimate", "model.json", "short-row.csv", "--out"], "line 12"),
    "stray quote": (
        ["estimate", "model.json", "stray-quote.csv", "--out"],
        "line 12: not readable as CSV",
    ),
    "a case for a case": (["inspect", "case.toml", "--case"], "give its mesh file"),
    "column missing": (["estimate", "model.json", "no-column.csv", "--out"], "T2_K"),
    "a temperature twice": (
        ["estimate", "model.json", "two-units.csv", "--out"],
        "'T1_degC' and 'T1_degF' are both the temperature 'T1'",
    ),
    "no such samples": (["estimate", "model.json", "no.csv", "--out"], "no.csv"),
    "response for a case": (["view", "truncated.nc", "--out"], "truncated"),
    "no level": (
        ["calibrate", "--reference", "response.nc", "--input", "response.nc", "--out"],
        "LEVEL=RESPONSE",
    ),
    "level that is not the response's": (
        ["calibrate", "--reference", "response.nc", "--input", "2=response.nc", "--out"],
        "heat input",
    ),
}


#: What commands write; the others write pictures.
WRITTEN = {"simulate": "nc", "estimate": "csv", "validate": "json", "calibrate": "json"}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_exit_code_2_and_no_file(
    mistake, command, files_at_hand, tmp_path, monkeypatch
):
    arguments, said = MISTAKES[mistake]
    monkeypatch.chdir(files_at_hand)
    before = sorted(files_at_hand.iterdir())
    code, out, err = command(*arguments, tmp_path / f"out.{WRITTEN.get(arguments[0], 'png')}")
    assert code == 2
    assert err.startswith("thermojoint: ")
    assert err.count("\n") == 1
    assert said in err
    assert "Traceback" not in out + err
    assert out == ""
    assert list(tmp_path.iterdir()) == []
    assert sorted(files_at_hand.iterdir()) == before


@pytest.mark.parametrize(("name", "told"), [("nan.csv", "nan"), ("open-circuit.csv", "9.9e37")])
def test_what_is_no_reading_leaves_out_its_row_and_is_said(
    name, told, command, files_at_hand, tmp_path
):
    """A thermocouple that is open, or a logger's NaN, moves no estimate."""
    out, alone = tmp_path / "out.csv", tmp_path / "alone.csv"
    code, _, err = command(
        "estimate", files_at_hand / "model.json", files_at_hand / name, "--out", out
    )
    assert code == 0
    assert "readings missing: 1 x" in err
    lines = (files_at_hand / name).read_text().splitlines(keepends=True)
    (tmp_path / "without.csv").write_text("".join(one for one in lines if told not in one))
    command("estimate", files_at_hand / "model.json", tmp_path / "without.csv", "--out", alone)
    assert out.read_text() == alone.read_text()


def test_every_mistake_of_a_case_is_told_at_once_a_line_each(files_at_hand, command, tmp_path):
    text = (files_at_hand / "case.toml").read_text("utf-8")
    case = tmp_path / "case.toml"
    case.write_text(f"colour = 1\n{text.replace('step_s = ', 'step_s = -')}", "utf-8")
    code, out, err = command("simulate", case, "--out", tmp_path / "out.nc")
    assert (code, out) == (2, "")
    assert sorted(line.split(": ")[0] for line in err.splitlines()) == ["thermojoint"] * 2
    assert "no key named 'colour'" in err
    assert "march.step_s: input should be greater than 0" in err


def test_a_mistake_ends_the_real_process_without_a_traceback(files_at_hand, tmp_path):
    done = subprocess.run(
        [
            *(sys.executable, "-m", "thermojoint", "simulate"),
            *(files_at_hand / "unknown-key.toml", "--out", tmp_path / "out.nc"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "did you mean 'friction_coefficient'" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["simulate"], ["tables", "--nonsense"], ["no-command"]])
def test_wrong_usage_ends_with_2(command, arguments):
    code, _, err = command(*arguments)
    assert code == 2
    assert "Traceback" not in err


@pytest.mark.parametrize(
    "name",
    [
        *("simulate", "calibrate", "tables", "estimate", "validate", "reproduce", "view"),
        *("verify", "mesh", "inspect", "iso230-3", "compensate", "control"),
    ],
)
def test_every_command_has_help_with_an_example(command, name):
    code, out, _ = command(name, "--help")
    assert code == 0
    assert "Example" in out
    assert f"thermojoint {name}" in out


def stripped(text):
    """Text without what a terminal puts around and between its words."""
    return re.sub(r"[\s│─╭╮╰╯]", "", re.sub(r"\x1b\[[0-9;]*m", "", text))


HELPED = typer.main.get_command(app).commands


@pytest.mark.parametrize("name", HELPED)
def test_help_keeps_its_brackets(command, name):
    """Rich takes words in brackets for styles, unless they are escaped."""
    _, out, _ = command(name, "--help")
    texts = [HELPED[name].help, *(getattr(one, "help", None) for one in HELPED[name].params)]
    for text in filter(None, texts):
        plain = re.sub(r"\[/?bold\]", "", text)
        for bracketed in re.findall(r"\\?(\[[^\[\]]+\])", plain):
            assert stripped(bracketed) in stripped(out), bracketed


HAL_COMPONENT = "thermojoint/live/targets/linuxcnc_component.py"


def test_every_option_that_a_message_advises_exists():
    known = {option for one in HELPED.values() for param in one.params for option in param.opts} | {
        "--version",
        "--help",
    }
    # The HAL component is a program of its own, with its own options.
    for package in TOP:
        for path in set(modules(package)) - {ROOT / HAL_COMPONENT}:
            advised = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", path.read_text("utf-8")))
            assert advised <= known, path


def test_the_version_is_printed(command):
    code, out, _ = command("--version")
    assert code == 0
    assert re.fullmatch(r"thermojoint \d+\.\d+\.\d+\n", out)


def test_an_output_that_cannot_be_is_refused_before_any_work(command, files_at_hand, monkeypatch):
    monkeypatch.setattr("fesim.setup.machine.set_up", None)  # would fail if it were called
    case = files_at_hand / "case.toml"
    code, _, err = command("simulate", case, "--out", files_at_hand)
    assert (code, err.count("\n")) == (2, 1)
    code, _, err = command("simulate", case, "--out", case / "below-a-file.nc")
    assert (code, err.count("\n")) == (2, 1)
    code, _, err = command("reproduce", "--case", case, "--out", case)
    assert (code, err.count("\n")) == (2, 1)


def test_a_folder_of_snapshots_that_cannot_be_is_refused_before_any_work(
    command, tmp_path, monkeypatch
):
    monkeypatch.setattr("fesim.setup.machine.set_up", None)  # would fail if it were called
    case, taken = tmp_path / "case.toml", tmp_path / "run-snapshots"
    case.write_text(lasting(0.1))
    taken.write_text("a file")
    run = ["simulate", case, "--out", tmp_path / "run.nc"]
    code, _, err = command(*run, "--snapshots", taken)
    assert (code, err) == (2, f"thermojoint: {taken}: is a file; give a folder\n")
    code, _, err = command(*run, "--snapshots", taken / "below")
    assert (code, err.count("\n")) == (2, 1)
    case.write_text(case.read_text() + "\n[output]\nsnapshots_s = [2.0]\n")
    code, _, err = command(*run)
    assert (code, err) == (2, f"thermojoint: {taken}: is a file; give a folder\n")


@pytest.mark.parametrize("show", ["curves", "pressure"])
def test_a_picture_format_that_cannot_be_is_refused_before_any_work(
    show, command, files_at_hand, tmp_path, monkeypatch
):
    monkeypatch.setattr(view, "run_to_end", None)  # would fail if it were called
    case = files_at_hand / "case.toml"
    code, _, err = command("view", case, "--show", show, "--out", tmp_path / "x.xyz")
    assert (code, err.count("\n")) == (2, 1)
    assert list(tmp_path.iterdir()) == []


def test_an_inspection_that_cannot_draw_writes_nothing(command, files_at_hand, tmp_path):
    out, data = tmp_path / "machine.svg", tmp_path / "machine.json"
    code, told, err = command("inspect", files_at_hand / "case.toml", "--json", data, "--out", out)
    assert (code, told) == (2, "")
    assert "name it machine.png" in err
    assert list(tmp_path.iterdir()) == []


def test_a_continued_simulation_is_the_uninterrupted_one(command, files_at_hand, tmp_path):
    case = files_at_hand / "case.toml"
    assert command("simulate", case, "--out", tmp_path / "whole.nc")[0] == 0
    (tmp_path / "half.toml").write_text(lasting(0.5))
    begun = ["simulate", tmp_path / "half.toml", "--out", tmp_path / "half.nc"]
    assert command(*begun, "--save-state", tmp_path / "half.npz")[0] == 0
    going_on = ["simulate", case, "--out", tmp_path / "rest.nc"]
    code, out, err = command(*going_on, "--continue", tmp_path / "half.npz")
    assert code == 0
    assert "gap residual" in out
    assert "wrote" in err
    half, rest, whole = (
        read_response(tmp_path / f"{name}.nc")["displacement"].to_numpy()
        for name in ("half", "rest", "whole")
    )
    # Three set-ups, each with the rounding of its own factorisation.
    joined = np.concatenate([half, rest])
    np.testing.assert_allclose(joined, whole, rtol=0.0, atol=1e-9 * np.abs(whole).max())


def test_a_continued_simulation_without_a_snapshot_leaves_those_before_it(command, tmp_path):
    """An empty folder took the place of theirs."""
    asked, fields = "\n[output]\nsnapshots_s = [6.0]\n", tmp_path / "fields"
    for name, minutes in (("half", 0.2), ("longer", 0.5)):
        (tmp_path / f"{name}.toml").write_text(lasting(minutes) + asked)
    run = ["simulate", tmp_path / "half.toml", "--out", tmp_path / "half.nc"]
    assert command(*run, "--snapshots", fields, "--save-state", tmp_path / "half.npz")[0] == 0
    written = sorted(fields.iterdir())
    assert fields / "structure_000003.vtu" in written
    going_on = ["simulate", tmp_path / "longer.toml", "--out", tmp_path / "rest.nc"]
    going_on += ["--continue", tmp_path / "half.npz"]
    code, _, err = command(*going_on, "--snapshots", fields)
    assert (code, err.count("\n")) == (2, 1)
    assert "no time after the state, at 12 s" in err
    assert sorted(fields.iterdir()) == written
    assert command(*going_on)[0] == 0
    assert not (tmp_path / "rest-snapshots").exists()


def test_a_simulation_ends_with_what_a_person_wants_to_know(command, files_at_hand, tmp_path):
    out = tmp_path / "out.nc"
    code, told, _ = command("simulate", files_at_hand / "case.toml", "--out", out)
    assert code == 0
    response = read_response(out)
    displacement = 1e6 * response["displacement"].to_numpy()
    assert "Displacement of A relative to B (µm)" in told
    for axis, track in zip("xyz", displacement.T, strict=True):
        (row,) = (line for line in told.splitlines() if line.startswith(f"│ {axis} "))
        final, peak = (float(cell) for cell in row.split("│")[2:4])
        assert final == pytest.approx(track[-1], abs=1e-3)
        assert abs(peak) == pytest.approx(np.abs(track).max(), abs=1e-3)
    hottest = response["temperature"].max("time")
    probe = hottest["probe"].to_numpy()[hottest.to_numpy().argmax()]
    assert f"{float(hottest.max()):.4g} K above the initial ambient; probe {probe}, after" in told
    last = 1e-6 * response["pressure"].to_numpy()[-1]
    assert f"Contact pressure: {last.min():.4g} to {last.max():.4g} MPa at the end" in told
    assert re.search(r"at the end: [\d.]+% open \(at most [\d.]+%\), [\d.]+% sliding", told)
    assert told.index("Displacement") < told.index("Contact pressure") < told.index("Solver")


def test_an_implausible_case_is_simulated_with_a_warning(command, tmp_path):
    text = lasting(0.1).replace("density_kg_m3 = 7200.0", "density_kg_m3 = 7.2", 1)
    (tmp_path / "case.toml").write_text(text)
    code, _, err = command("simulate", tmp_path / "case.toml", "--out", tmp_path / "out.nc")
    assert code == 0
    warnings = [line for line in err.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == 1
    assert "7.2 g/cm3 would be 7200 kg/m3" in warnings[0]


def test_a_measured_csv_in_kelvin_is_estimated_with_a_warning(command, files_at_hand, tmp_path):
    rows = "".join(f"{2 * k},0.1,293.15,293.2\n" for k in range(3))
    (tmp_path / "kelvin.csv").write_text("time_s,delta_T_K,T1_K,T2_K\n" + rows)
    given = [files_at_hand / "model.json", tmp_path / "kelvin.csv"]
    code, _, err = command("estimate", *given, "--out", tmp_path / "out.csv")
    assert code == 0
    told = [line for line in err.splitlines() if line.startswith("warning: ")]
    assert [line.partition(" = ")[0].rpartition(" ")[2] for line in told] == ["T1_K", "T2_K"]
    assert all("absolute temperature" in line for line in told)


def test_snapshots_are_written_where_they_are_asked_for(command, tmp_path):
    case = lasting(0.1) + "\n[output]\nsnapshots_s = [2.0, 6.0]\n"
    (tmp_path / "case.toml").write_text(case)
    arguments = ["simulate", tmp_path / "case.toml", "--out", tmp_path / "run.nc"]
    assert command(*arguments)[0] == 0
    folder = tmp_path / "run-snapshots"
    assert (folder / "snapshots.pvd").is_file()
    assert len(list(folder.glob("structure_*.vtu"))) == 2


def read_estimate(path):
    """The numbers of an estimate; FCHS has no band, and the status is text."""
    names = path.read_text().splitlines()[0].split(",")
    texts = ("status", "quality")
    numbers = [k for k, name in enumerate(names) if name not in texts and "_band_" not in name]
    return np.genfromtxt(path, delimiter=",", names=True, usecols=numbers)


def test_an_estimate_is_the_same_from_a_response_and_from_a_csv(
    command, files_at_hand, tmp_path, coarse_response
):
    """The response is above the ambient at its start, the thermometers see the ambient move."""
    temperature = {
        str(name): coarse_response["temperature"].to_numpy()[:, k]
        for k, name in enumerate(coarse_response["probe"].to_numpy())
    }
    time = coarse_response["time"].to_numpy()
    ambient, drift = 21.0, 1e-3 * time
    columns = [time, *(temperature[name] + ambient for name in ("a", "b", "T1", "T2"))]
    rows = np.column_stack([*columns, ambient + drift])
    header = "time_s,a_degC,b_degC,T1_degC,T2_degC,ambient_degC"
    np.savetxt(tmp_path / "read.csv", rows, "%.17g", ",", header=header, comments="")
    moving = {"ambient": ("time", drift, coarse_response["ambient"].attrs)}
    write_response(coarse_response.assign(moving), tmp_path / "moving.nc")
    model = files_at_hand / "model.json"
    for source, out in ((tmp_path / "moving.nc", "one"), (tmp_path / "read.csv", "two")):
        assert command("estimate", model, source, "--out", tmp_path / out)[0] == 0
    one, two = read_estimate(tmp_path / "one"), read_estimate(tmp_path / "two")
    assert one.dtype.names == two.dtype.names
    assert {"time_s", "heat_input", "source_1", "deviation_T2_K", "x_um"} <= {*one.dtype.names}
    for name in one.dtype.names:
        scale = np.abs(one[name]).max()
        assert two[name] == pytest.approx(one[name], rel=1e-6, abs=1e-6 * scale)
    assert one["x_um"] == pytest.approx(one["linear_x_um"] + one["nonlinear_x_um"], abs=1e-6)


def test_an_estimate_resumed_on_the_streams_goes_on_as_if_never_stopped(
    command, files_at_hand, tmp_path, monkeypatch
):
    model = files_at_hand / "model.json"
    lines = (files_at_hand / "samples.csv").read_text().splitlines(keepends=True)

    def stream(part, *options):
        monkeypatch.setattr(sys, "stdin", iter(part))
        code, out, _ = command("estimate", model, "-", "--out", "-", "--interval-s", "2", *options)
        assert code == 0
        return out.splitlines()

    whole = stream(lines)
    state = tmp_path / "state.json"
    first = stream(lines[:11], "--save-state", state)
    second = stream([lines[0], *lines[11:]], "--continue", state)
    assert first + second[1:] == whole


def test_an_assembled_estimator_needs_no_second_sample_to_know_its_interval(
    command, files_at_hand, tmp_path
):
    model, lines = tmp_path / "estimator.json", (files_at_hand / "samples.csv").read_text()
    write_assembly(assemble(read_model(files_at_hand / "model.json"), 2.0, 7200.0), model)
    one, many = tmp_path / "one.csv", files_at_hand / "samples.csv"
    one.write_text("".join(lines.splitlines(keepends=True)[:2]))
    assert command("estimate", model, one, "--out", tmp_path / "first.csv")[0] == 0
    assert command("estimate", model, many, "--out", tmp_path / "all.csv")[0] == 0
    first, every = ((tmp_path / name).read_text().splitlines() for name in ("first.csv", "all.csv"))
    assert first == every[:2]


def test_a_logger_stopped_by_a_signal_leaves_its_state(files_at_hand, tmp_path):
    state = tmp_path / "state.json"
    arguments = ["estimate", files_at_hand / "model.json", "-", "--out", "-", "--interval-s", "2"]
    with subprocess.Popen(
        [sys.executable, "-m", "thermojoint", *arguments, "--save-state", state],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as running:
        # The logger writes its remarks in another encoding.
        running.stdin.write(b"time_s,delta_T_K,T1_K,T2_K,21 \xb0C\n0,0,0,0,-\n2,0.1,0,0,-\n")
        running.stdin.flush()
        rows = [running.stdout.readline() for _ in range(3)]
        running.send_signal(signal.SIGTERM)
        _, err = running.communicate(timeout=60)
    assert rows[2].startswith(b"2,")
    assert running.returncode == 128 + signal.SIGTERM
    assert b"Traceback" not in err
    assert json.loads(state.read_text())["state"][0] == 2.0


def test_a_log_without_a_complete_row_is_refused_and_a_stream_keeps_its_state(
    command, files_at_hand, tmp_path, monkeypatch
):
    model, state = files_at_hand / "model.json", tmp_path / "state.json"
    header = "time_s,delta_T_K,T1_K,T2_K\n"
    options = ["--interval-s", "2", "--save-state", state, "--out"]
    for rows in ("", "0,0.1,,0\n2,0.1,,0\n"):
        (tmp_path / "log.csv").write_text(header + rows, encoding="utf-8")
        code, _, err = command(
            "estimate", model, tmp_path / "log.csv", *options, tmp_path / "e.csv"
        )
        assert code == 2
        assert "log.csv: no samples; give rows below the header" in err
        assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
    monkeypatch.setattr(sys, "stdin", iter([header]))
    code, out, err = command("estimate", model, "-", *options, "-")
    assert (code, out.count("\n")) == (2, 1)
    assert "standard input: no samples" in err
    assert state.exists()


def test_an_interrupted_estimate_leaves_no_file(files_at_hand, tmp_path):
    arguments = ["estimate", files_at_hand / "model.json", "-", "--out", tmp_path / "out.csv"]
    with subprocess.Popen(
        [sys.executable, "-m", "thermojoint", *arguments], stdin=subprocess.PIPE
    ) as running:
        running.stdin.write(b"time_s,delta_T_K,T1_K,T2_K\n0,0,0,0\n2,0,0,0\n4,0,0,0\n")
        running.stdin.flush()
        while not list(tmp_path.iterdir()):  # half-written, hidden
            time.sleep(0.01)
        running.send_signal(signal.SIGINT)
    assert running.returncode == 130
    assert list(tmp_path.iterdir()) == []


def test_a_bad_row_ends_a_stream_with_the_state_before_it(
    command, files_at_hand, tmp_path, monkeypatch
):
    model = files_at_hand / "model.json"
    lines = (files_at_hand / "samples.csv").read_text().splitlines(keepends=True)
    given = [*lines[:11], "20,warm,0,0\n", *lines[12:]]

    def estimate(part, *options):
        monkeypatch.setattr(sys, "stdin", iter(part))
        return command("estimate", model, "-", "--interval-s", "2", *options)

    whole = estimate([*lines[:11], *lines[12:]], "--out", "-")[1].splitlines()
    state, out = tmp_path / "state.json", tmp_path / "out.csv"
    code, first, _ = estimate(given, "--out", "-", "--save-state", state)
    assert code == 2
    rest = estimate([lines[0], *lines[12:]], "--out", "-", "--continue", state)[1]
    assert first.splitlines() + rest.splitlines()[1:] == whole
    # A file is not written, and then there is no state to go on from either.
    state.unlink()
    assert estimate(given, "--out", out, "--save-state", state)[0] == 2
    assert list(tmp_path.iterdir()) == []


def test_standard_input_in_another_encoding_is_read(command, files_at_hand, monkeypatch):
    samples = (files_at_hand / "samples.csv").read_bytes().replace(b"T2_K\n", b"T2_K,\xb0C\n", 1)
    samples = re.sub(rb"(\d)\n", lambda end: end[1] + b",\xb0\n", samples)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(samples), encoding="utf-8"))
    code, out, err = command("estimate", files_at_hand / "model.json", "-", "--out", "-")
    assert code == 0
    assert len(out.splitlines()) == 21
    assert "clock time_s, from its own start\n  columns: delta_T_K (temperature), T1_K" in err
    assert "standard input: 20 rows, 0 s to 38 s, every 2 s" in err


def test_tables_of_a_model_as_tables_and_as_json(command, files_at_hand):
    code, out, _ = command("tables", files_at_hand / "model.json")
    assert code == 0
    assert "Table 3" in out
    code, out, _ = command("tables", files_at_hand / "model.json", "--json", "-")
    assert code == 0
    assert json.loads(out)["table1"]["thermal"]["K"] == 3.372


def test_json_on_standard_output_is_nothing_but_json(command, files_at_hand, tmp_path):
    for arguments in (
        ["tables", files_at_hand / "model.json"],
        ["validate", files_at_hand / "model.json", files_at_hand / "response.nc"],
        ["inspect", files_at_hand / "case.toml"],
    ):
        code, out, err = command(*arguments, "--json", "-")
        assert (code, err) == (0, "")
        code, table, _ = command(*arguments, "--json", tmp_path / "results.json")
        assert code == 0
        assert table
        assert json.loads(out) == json.loads((tmp_path / "results.json").read_text())
        (tmp_path / "results.json").unlink()


def test_results_as_json_have_one_option_everywhere():
    for name, command in HELPED.items():
        for option in command.params:
            words = f"{getattr(option, 'help', '')}".lower()
            if "results as json" in words:
                assert option.opts == ["--json"], name
    with_json = {
        name
        for name, command in HELPED.items()
        if any("--json" in option.opts for option in command.params)
    }
    written = {"tables", "validate", "verify", "inspect", "control", "iso230-3", "calibrate"}
    assert with_json == written | {"optimise", "sensitivity"}


def test_a_view_of_a_case_and_of_a_response(command, files_at_hand, tmp_path, coarse_response):
    structure, curves = tmp_path / "structure.png", tmp_path / "curves.svg"
    assert command("view", files_at_hand / "case.toml", "--out", structure)[0] == 0
    assert command("view", files_at_hand / "response.nc", "--out", curves)[0] == 0
    assert structure.read_bytes().startswith(b"\x89PNG")
    assert "</svg>" in curves.read_text()
    measured = tmp_path / "measured.nc"
    alone = coarse_response[["heat_input", "temperature", "displacement"]].copy()
    del alone.attrs["case"]
    write_response(alone, measured)
    picture = tmp_path / "field.png"
    code, _, err = command("view", measured, "--show", "temperature", "--out", picture)
    assert (code, err.count("\n"), picture.exists()) == (2, 1, False)


def test_the_reference_case_is_the_default(monkeypatch, command, tmp_path):
    seen = []
    monkeypatch.setattr(reproduce, "reproduce", lambda case, out: seen.append((case, out)))
    code, _, _ = command("reproduce", "--out", tmp_path / "results")
    assert code == 0
    [(case, _)] = seen
    text = files("thermojoint").joinpath("cases/reference.toml").read_text("utf-8")
    assert case.title == tomllib.loads(text)["title"]
    assert case.march.duration_min == 35.0
