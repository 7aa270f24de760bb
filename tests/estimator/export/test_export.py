"""An exported estimator is the estimator: compiled, sanitised, and run against Python."""

import ctypes
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from exported import (
    PRECISIONS,
    SANITISED,
    counts,
    library,
    needs_gcc,
    needs_gxx,
    operations,
    selftest,
    written,
)
from in_process import run

from estimator.export.c_source import literal
from estimator.export.program import REFUSED, Precision
from estimator.exporting import export_program
from estimator.fchs.estimator import Fchs
from estimator.interface import Status, follow
from estimator.measured import response_samples
from thermojoint.artefacts.errors import InputError
from thermojoint.cli.app import app
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly
from thermojoint.models.filters.phi import divided_differences, phi_functions

DT = 20.0


def test_an_unknown_precision_is_refused(fchs):
    with pytest.raises(InputError, match="no precision named 'half'; known: double, single"):
        export_program(fchs, "half", "spindle")


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_day_of_the_coarse_machine_is_the_same_in_c(fchs, coarse_day, precision, tmp_path):
    samples = list(response_samples(coarse_day, fchs.assembly.model))[1:]
    found = export_program(fchs, precision, "spindle", samples)
    figures = selftest(written(found, tmp_path), "spindle", "-O1", *SANITISED)
    assert figures["samples"] == len(samples) == 4320
    assert figures["state"] == found.state
    worst, largest = figures["largest difference"], figures["largest displacement"]
    assert largest > 20e-6
    assert worst <= (1e-12 * largest if precision is Precision.DOUBLE else 0.01e-6)


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_program_holds_at_any_interval_over_gaps_and_with_every_warning(
    fchs, precision, tmp_path
):
    """The duty cycle that is compiled in by default has uneven intervals and a gap of an hour."""
    found = export_program(fchs, precision, "spindle")
    selftest(written(found, tmp_path), "spindle", "-O2", *SANITISED)


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_pole_that_lies_near_the_leak_costs_no_digits(hand_made_model, fchs, precision, tmp_path):
    """Their residues cancel to 3 parts in 100 000; the program takes the leak out again."""
    poles = fchs.assembly.sources.poles
    slow = np.sort(poles.real[poles.imag == 0.0])[-3]
    leaking = replace(hand_made_model, leak=float(-slow * (1.0 + 3e-5)))
    model = Fchs(assemble(leaking, DT, 7200.0))
    found = export_program(model, precision, "spindle")
    figures = selftest(written(found, tmp_path), "spindle", "-O1", *SANITISED)
    if precision is Precision.SINGLE:
        assert figures["largest difference"] < 1e-9


def test_divided_differences_are_means_of_derivatives_however_near_the_two_are():
    """f[a, z] is the mean of f' from a to z; φ_0' = φ_0, φ_1' = φ_1 - φ_2."""
    z = np.array([-1e-9, -1e-3, -1e-3 * (1 + 1e-9), -0.7 + 0.4j, -5.0, -5.0 + 2j, -9.0, 0.0])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for at in (0.0, -1e-3, -0.7, -5.0 * (1 + 1e-12), -7.0):
        direct, mean = divided_differences(at, z)
        along = at + 0.5 * (1.0 + nodes[:, None]) * (z - at)
        phi = phi_functions(along)
        np.testing.assert_allclose(direct, 0.5 * weights @ phi[0], rtol=1e-13)
        np.testing.assert_allclose(mean, 0.5 * weights @ (phi[1] - phi[2]), rtol=1e-13)


@needs_gcc
def test_the_program_needs_nothing_of_the_library_but_math(fchs, tmp_path):
    folder = written(export_program(fchs, Precision.DOUBLE, "spindle"), tmp_path)
    subprocess.run(
        ["gcc", "-std=c99", "-ffreestanding", "-O0", "-c", "spindle.c"], cwd=folder, check=True
    )
    listed = subprocess.run(
        ["nm", "-u", "spindle.o"], cwd=folder, check=True, capture_output=True, text=True
    )
    wanted = set(listed.stdout.replace(" U ", "").split())
    # A compiler may copy structures by these two; it brings them along.
    assert wanted - {"memcpy", "memset", "_GLOBAL_OFFSET_TABLE_"} == {"exp", "sin", "cos", "fabs"}


class Estimate(ctypes.Structure):
    _fields_ = (
        ("displacement", ctypes.c_double * 2),
        ("heat", ctypes.c_double),
        ("sources", ctypes.c_double * 2),
        ("deviation", ctypes.c_double * 2),
        ("linear", ctypes.c_double * 2),
        ("nonlinear", ctypes.c_double * 2),
        ("status", ctypes.c_uint),
    )


@pytest.fixture(scope="module")
def program(fchs, tmp_path_factory):
    """The compiled program, and the size of its state."""
    folder = tmp_path_factory.mktemp("program")
    found = export_program(fchs, Precision.DOUBLE, "spindle")
    loaded = library(found, folder)
    loaded.spindle_step.argtypes = [ctypes.c_void_p, ctypes.c_double] + 2 * [ctypes.c_void_p]
    loaded.spindle_step.restype = ctypes.c_uint
    return loaded, found.state


def started(program):
    loaded, size = program
    state = ctypes.create_string_buffer(size)
    loaded.spindle_init(state)
    return state


def step(program, state, interval, values):
    readings, found = (ctypes.c_double * 3)(*values), Estimate()
    word = program[0].spindle_step(state, interval, readings, ctypes.byref(found))
    assert word == found.status
    return found


@needs_gcc
def test_every_detail_is_the_one_of_python(fchs, program):
    samples = [(DT, 1.0, 0.4, 2.0), (2 * DT, 1.2, 0.5, 2.2), (3.3 * DT, 1.1, 0.6, 2.1)]
    state, last = started(program), 0.0
    for sample, (_, found) in zip(
        samples, follow(fchs, samples, fchs.initial_state()), strict=True
    ):
        got = step(program, state, sample[0] - last, sample[1:])
        last = sample[0]
        parts = (got.heat, *got.sources, *got.deviation, *got.linear, *got.nonlinear)
        np.testing.assert_allclose(parts, found.details, rtol=1e-11, atol=1e-18)
        np.testing.assert_allclose(list(got.displacement), found.displacement, rtol=1e-11)
        assert got.status == found.status


@needs_gcc
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 9.9e37, -6000.0])
def test_what_is_no_temperature_is_left_out_and_the_next_sample_covers_the_gap(program, value):
    good, later = (1.0, 0.4, 2.0), (1.1, 0.5, 2.1)
    state, other = started(program), started(program)
    for one in (state, other):
        step(program, one, DT, good)
    for channel in range(3):
        bad = [*good]
        bad[channel] = value
        assert step(program, state, DT, bad).status == REFUSED
    got, expected = step(program, state, DT, later), step(program, other, 4 * DT, later)
    assert list(got.displacement) == list(expected.displacement)
    assert state.raw == other.raw


@needs_gcc
@pytest.mark.parametrize("interval", [0.0, -1.0, np.nan, np.inf])
def test_time_that_does_not_go_on_changes_nothing(program, interval):
    state = started(program)
    step(program, state, DT, (1.0, 0.4, 2.0))
    before = state.raw
    assert step(program, state, interval, (1.0, 0.4, 2.0)).status == REFUSED
    assert state.raw == before


@needs_gcc
def test_the_status_says_what_is_beyond_the_calibration(program):
    state = started(program)
    assert step(program, state, DT, (0.0, 0.0, 0.0)).status == Status.OK
    assert step(program, state, DT, (0.0, 3.0, 0.0)).status & Status.BEYOND_TEMPERATURE
    assert not step(program, state, DT, (0.0, 3.0, 0.0)).status & Status.UNSETTLED
    assert step(program, state, 3600.0, (0.0, 3.0, 0.0)).status & Status.UNSETTLED
    assert step(program, started(program), DT, (0.0, 3.0, 0.0)).status & Status.UNSETTLED
    assert step(program, state, DT, (7.9, 0.0, 0.0)).status & Status.BEYOND_HEAT
    assert step(program, state, 100.0, (7.9, 0.0, 0.0)).status & Status.BEYOND_TIME


COUNTING = """
int main() { static spindle_state state; static spindle_estimate found;
  const spindle_real readings[3] = {1.0, 0.5, 1.5};
  const double intervals[] = {20.0, 20.0, 0.01, 1.0, 7.0, 60.0, 600.0, 1e5};
  spindle_init(&state);
  for (double one : intervals) {
    CLEAR();
    spindle_step(&state, one, readings, &found);
    PRINT();
  } }
"""


@needs_gxx
def test_no_sample_costs_more_than_is_printed(fchs, tmp_path):
    """The same source with numbers that count what is done with them."""
    found = export_program(fchs, Precision.DOUBLE, "spindle")
    counted = np.array(counts(found, tmp_path, "spindle", COUNTING))
    usual, worst = operations(found.usual), operations(found.worst)
    assert (counted[:2] <= usual).all()
    assert (counted[1] == usual).all()
    assert (counted <= worst).all()
    assert counted[2:, 0].max() > 0.9 * worst[0]


def test_constants_are_exact_to_the_last_bit():
    for value in (0.1, -1e-300, 3.0, 2.0**-1074, 1.7e308):
        assert float.fromhex(literal(value, Precision.DOUBLE)) == value
        single = np.float32(value) if abs(value) < 1e38 else None
        if single is not None:
            text = literal(value, Precision.SINGLE)
            assert text.endswith("f")
            assert np.float32(float.fromhex(text[:-1])) == single


def test_what_has_no_number_is_refused(fchs):
    with pytest.raises(InputError, match="single"):
        literal(1e300, Precision.SINGLE)
    with pytest.raises(InputError, match="--name 1st"):
        export_program(fchs, Precision.DOUBLE, "1st")


@needs_gcc
def test_a_response_has_no_columns_to_rename(fchs, tmp_path, capsys):
    write_assembly(fchs.assembly, tmp_path / "estimator.json")
    names = (tmp_path / "estimator.json", "--out", tmp_path / "program")
    assert run("export", *names, "--samples", tmp_path / "r.nc", "--column", "a=T1_K") == 2
    assert "--column: goes with a log" in capsys.readouterr().err


def test_the_command_writes_a_folder_that_compiles_and_prints_what_it_costs(fchs, tmp_path, capsys):
    file, out = tmp_path / "estimator.json", tmp_path / "program"
    write_assembly(fchs.assembly, file)
    log = tmp_path / "log.csv"
    rows = [f"{DT * k},{0.1 * k},{0.02 * k},{0.1 * k}" for k in range(1, 30)]
    log.write_text("time_s,delta_T_K,T1_K,T2_K\n" + "\n".join(rows) + "\n")
    arguments = ["export", str(file), "--to", "c", "--out", str(out), "--samples", str(log)]
    app([*arguments, "--precision", "single"], standalone_mode=False)
    told = capsys.readouterr().out
    figures = selftest(out, "thermojoint", "-O1")
    assert figures["samples"] == 29
    assert f"state      {figures['state']:.0f} bytes" in told
    assert "multiplications" in told
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "plc.c").touch()
    with pytest.raises(InputError, match="another origin"):
        app([*arguments[:5], str(tmp_path / "own")], standalone_mode=False)
