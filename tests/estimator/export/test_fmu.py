"""An exported estimator as a unit for co-simulation, run by FMPy."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from exported import STRICT, needs_gcc
from typer.testing import CliRunner

from estimator.export.c_source import c_files
from estimator.export.fmu import Standard, fmi_files, write_fmu
from estimator.export.program import Precision
from estimator.exporting import export_program
from estimator.interface import follow
from thermojoint.cli.app import app
from thermojoint.models.assembly_file import write_assembly

fmpy = pytest.importorskip("fmpy", reason="needs FMPy")
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu

DT = 20.0
SAMPLES = [(DT * k, 0.1 * k, 0.02 * k, 0.1 * k) for k in range(1, 40)]


@pytest.fixture(scope="module", params=Standard)
def unit(request, fchs, tmp_path_factory):
    path = tmp_path_factory.mktemp("unit") / "spindle.fmu"
    write_fmu(export_program(fchs, Precision.DOUBLE, "spindle"), path, request.param)
    return path


@pytest.fixture
def running(unit):
    """The unit, initialised, and its variables by name."""
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    description, folder = fmpy.read_model_description(unit), fmpy.extract(unit)
    second = description.fmiVersion == "2.0"
    slave = (FMU2Slave if second else FMU3Slave)(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="one",
    )
    slave.instantiate()
    if second:
        slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    yield slave, {one.name: one.valueReference for one in description.modelVariables}, second
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)


def stepped(running, samples):
    slave, names, second = running
    put, real, word = (
        (slave.setReal, slave.getReal, slave.getInteger)
        if second
        else (slave.setFloat64, slave.getFloat64, slave.getUInt32)
    )
    for time, *readings in samples:
        put([names[name] for name in ("delta_T", "T1", "T2")], readings)
        slave.doStep(time - DT, DT)
        shifts = real([names[f"displacement_{axis}"] for axis in ("x", "y")])
        yield [*shifts, *word([names["status"]])]


@needs_gcc
def test_the_unit_says_what_python_says(fchs, running):
    expected = [found for _, found in follow(fchs, SAMPLES, fchs.initial_state())]
    got = np.array(list(stepped(running, SAMPLES)))
    there = np.array([[*one.displacement, one.status] for one in expected])
    np.testing.assert_allclose(got, there, rtol=1e-11)


@needs_gcc
def test_a_kept_state_goes_on_and_a_reset_begins_anew(running):
    slave, _, second = running
    first = list(stepped(running, SAMPLES[:10]))
    kept = slave.getFMUstate() if second else slave.getFMUState()
    after = list(stepped(running, SAMPLES[10:20]))
    if second:
        slave.setFMUstate(slave.deSerializeFMUstate(slave.serializeFMUstate(kept)))
    else:
        slave.setFMUState(slave.deserializeFMUState(slave.serializeFMUState(kept)))
    assert list(stepped(running, SAMPLES[10:20])) == after
    slave.reset()
    assert list(stepped(running, SAMPLES[:10])) == first
    (slave.freeFMUstate if second else slave.freeFMUState)(kept)


@needs_gcc
def test_fmpy_finds_nothing_wrong_and_simulates_it(unit):
    assert validate_fmu(str(unit)) == []
    result = fmpy.simulate_fmu(str(unit), start_values={"delta_T": 5.0}, stop_time=400.0)
    assert result["displacement_x"][-1] != 0.0


@needs_gcc
@pytest.mark.parametrize("standard", Standard)
def test_its_sources_compile_without_a_word(fchs, standard, tmp_path):
    found = export_program(fchs, Precision.SINGLE, "spindle")
    for name, text in (c_files(found) | fmi_files(found, standard)).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    command = ["gcc", *STRICT, "-c", f"spindle_{standard}.c"]
    subprocess.run(command, cwd=tmp_path, check=True)


@needs_gcc
def test_the_command_writes_it_and_replaces_no_other_file(fchs, tmp_path):
    model, out = tmp_path / "estimator.json", tmp_path / "spindle.fmu"
    write_assembly(fchs.assembly, model)
    arguments = ["export", str(model), "--out", str(out), "--to"]
    for kind, version in (("fmu", "3.0"), ("fmi2", "2.0")):
        app([*arguments, kind], standalone_mode=False)
        assert fmpy.read_model_description(str(out)).fmiVersion == version
    Path(out).write_text("mine", encoding="utf-8")
    assert CliRunner().invoke(app, [*arguments, "fmu"]).exit_code != 0
    assert out.read_text("utf-8") == "mine"
