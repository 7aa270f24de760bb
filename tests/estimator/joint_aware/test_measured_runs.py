"""A measured log calibrates the machine's physics where there is a mesh."""

import copy
from pathlib import Path

import numpy as np
import pytest
from observed import SENSORS, observed_data, run, step
from typer.testing import CliRunner

from calibrate.joint_aware.calibration import (
    calibrated_range,
    machine_of,
    sensors_of,
    warn_of_contradictions,
)
from calibrate.joint_aware.measured_runs import runs_of
from calibrate.joint_aware.readings import run_in
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.response import make_response
from thermojoint.cli.app import app
from thermojoint.reduced.machine import reduce_machine

pytestmark = pytest.mark.filterwarnings("ignore:log. no ambient_degC")


@pytest.fixture(scope="module")
def case(coarse_data):
    return observed_data(coarse_data) | {"probes": probes(coarse_data)}


def probes(coarse_data):
    found = observed_data(coarse_data)["probes"]
    return {name: found[name] for name in SENSORS}


@pytest.fixture(scope="module")
def response(case):
    return run(case, set_up(case_from_data(case, "case", Path())), step(2.0))


def log_of(response, path, warm=0.0):
    """The response as a logger would have written it, in degrees and micrometres."""
    temperatures = response["temperature"].sel(probe=list(SENSORS)).to_numpy() + 21.5 + warm
    moved = 1e6 * response["displacement"].sel(axis=["x", "y"]).to_numpy() + [3.0, -2.0]
    heat = response["source_power"].to_numpy()[:, :1]
    table = np.column_stack([response["time"].to_numpy(), heat, temperatures, moved])
    header = ",".join(["time_s", "heat_W", *(f"{name}_degC" for name in SENSORS), "x_um", "y_um"])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def test_a_run_of_a_log_is_the_response_that_was_measured(case, response, tmp_path):
    log = read_log([log_of(response, tmp_path / "log.csv")])
    with pytest.warns(
        UserWarning, match="no ambient_degC: it is taken as that of the start of each"
    ):
        found = runs_of(log, case_from_data(case, "case", Path()), ["x_um", "y_um"])
    one = found["run 1"]
    wanted = response["temperature"].sel(probe=list(SENSORS)).to_numpy()
    assert one["temperature"].to_numpy() == pytest.approx(wanted, abs=1e-6)
    assert one["heat_input"].to_numpy() == pytest.approx(
        response["heat_input"].to_numpy(), abs=1e-9
    )
    moved = response["displacement"].sel(axis=["x", "y"]).to_numpy()
    assert one["displacement"].sel(axis=["x", "y"]).to_numpy() == pytest.approx(moved, abs=1e-11)


def with_pause(path, after, seconds, warm=0):
    """The log with a pause after some rows, then all rows but the first `warm` again."""
    header, first, *rows = path.read_text("utf-8").splitlines()
    # Power is on when the logger is switched on.
    rows = [",".join([*first.split(",")[:1], rows[0].split(",")[1], *first.split(",")[2:]]), *rows]
    begun = float(rows[after - 1].split(",")[0]) + seconds - float(rows[warm].split(",")[0])
    again = [row.partition(",") for row in rows[warm:]]
    more = [f"{float(time) + begun:.9g},{rest}" for time, _, rest in again]
    path.write_text("\n".join([header, *rows[:after], *more]), encoding="utf-8")
    return path


def test_after_a_pause_in_which_the_machine_cools_it_starts_from_rest_again(
    case, response, tmp_path
):
    """The heat of the first row after a night would have counted for the night."""
    count = response.sizes["time"]
    path = with_pause(log_of(response, tmp_path / "log.csv"), count, 86400.0)
    found = runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])
    assert list(found) == ["run 1", "run 2"]
    for variable in ("time", "temperature", "displacement", "heat_input"):
        one, again = (run[variable].to_numpy() for run in found.values())
        assert again == pytest.approx(one, abs=1e-9)


def test_rows_that_are_missing_on_a_warm_machine_make_no_run(case, response, tmp_path):
    half = response.sizes["time"] // 2
    path = with_pause(log_of(response, tmp_path / "log.csv"), half, 600.0, warm=half)
    found = runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])
    assert list(found) == ["run 1"]


def test_misread_samples_are_left_out_with_a_warning(case, response, tmp_path):
    """One at the start would be the zero of its displacement in the whole run."""
    path = log_of(response, tmp_path / "log.csv")
    header, *rows = path.read_text("utf-8").splitlines()
    for k in (0, 20):
        rows[k] = ",".join([*rows[k].split(",")[:-1], "-999"])
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    with (
        pytest.warns(UserWarning, match="y_um: its first reading is after the first heat"),
        pytest.warns(UserWarning, match="y_um: samples with a spike, left out: 2"),
    ):
        found = runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])
    moved = response["displacement"].sel(axis=["x", "y"]).to_numpy()
    wanted = moved - [moved[0, 0], moved[1, 1]]
    wanted[[0, 20], 1] = np.nan
    assert found["run 1"]["displacement"].sel(axis=["x", "y"]).to_numpy() == pytest.approx(
        wanted, abs=1e-11, nan_ok=True
    )


@pytest.mark.filterwarnings("error:.*spike")
def test_the_cold_sensor_of_a_source_before_a_step_is_no_spike(case, response, tmp_path):
    """Half of its rise comes between the first two readings."""
    steep = response.copy(deep=True)
    seconds = response["time"].to_numpy()
    steep["temperature"].loc[{"probe": SENSORS[0]}] = 8.0 * (1.0 - 0.5 ** (seconds / seconds[1]))
    log = read_log([log_of(steep, tmp_path / "log.csv")])
    found = runs_of(log, case_from_data(case, "case", Path()), ["x_um", "y_um"])
    assert found["run 1"].sizes["time"] == seconds.size


def test_a_first_temperature_that_is_misread_is_left_out_with_a_warning(case, response, tmp_path):
    path = log_of(response, tmp_path / "log.csv")
    header, first, *rows = path.read_text("utf-8").splitlines()
    cells = first.split(",")
    cells[2] = "85.0"
    path.write_text("\n".join([header, ",".join(cells), *rows]), encoding="utf-8")
    with pytest.warns(UserWarning, match=f"{SENSORS[0]}_degC: samples with a spike, left out: 1"):
        found = runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])
    assert found["run 1"].sizes["time"] == response.sizes["time"] - 1


def probed(path, x, y):
    """The log with the displacements in some of its rows only."""
    header, *rows = path.read_text("utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    for k, row in enumerate(cells):
        row[-2:] = [row[-2] if k in x else "", row[-1] if k in y else ""]
    path.write_text("\n".join([header, *map(",".join, cells)]), encoding="utf-8")
    return path


def test_a_probe_may_read_one_axis_after_the_other_and_seldom(case, response, tmp_path):
    x, y = [0, 30, 60, 90], [1, 31, 61, 91]
    path = probed(log_of(response, tmp_path / "log.csv"), x, y)
    with pytest.warns(UserWarning, match="run 1: y_um: its first reading is after the first heat"):
        found = runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])
    one = found["run 1"]
    assert one.sizes["time"] == response.sizes["time"]
    for axis, at in (("x", x), ("y", y)):
        moved = response["displacement"].sel(axis=axis).to_numpy()
        wanted = np.full(moved.size, np.nan)
        wanted[at] = moved[at] - moved[at[0]]
        assert one["displacement"].sel(axis=axis).to_numpy() == pytest.approx(
            wanted, abs=1e-11, nan_ok=True
        )


def test_a_displacement_that_is_hardly_read_is_refused_by_its_name(case, response, tmp_path):
    path = probed(log_of(response, tmp_path / "log.csv"), range(0, 10_000, 5), [0, 60])
    with pytest.raises(
        InputError, match="run 1: y_um: 2 readings in rows with all others; a run needs 3"
    ):
        runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])


def test_a_thermometer_that_is_elsewhere_in_the_case_is_said(case, response):
    name = SENSORS[0]
    moved = copy.deepcopy(case)
    moved["probes"][name]["position_mm"][1] += 30.0
    with pytest.warns(UserWarning, match=f"probe '{name}' of run 1 is 30 mm from that of the case"):
        warn_of_contradictions(case_from_data(moved, "case", Path()), SENSORS, {"run 1": response})


def test_a_thermometer_that_one_run_lacks_is_said(case, response):
    machine, name = case_from_data(case, "case", Path()), SENSORS[-1]
    runs = {"run 1": response, "run 2": response.drop_sel(probe=name)}
    with pytest.warns(UserWarning, match=f"probe '{name}' of the case is left out, .* in run 2; "):
        assert sensors_of(machine, runs) == SENSORS[:-1]


def test_a_thermometer_of_another_name_than_in_the_case_is_said(case, response):
    renamed = copy.deepcopy(case)
    renamed["probes"]["T9"] = renamed["probes"].pop(SENSORS[-1])
    machine = case_from_data(renamed, "case", Path())
    with pytest.warns(UserWarning, match=f"'T9' .* not in run 1; .* one of {SENSORS[-1]}"):
        assert sensors_of(machine, {"run 1": response}) == SENSORS[:-1]


@pytest.mark.filterwarnings("error")
def test_a_probe_that_no_log_reads_is_no_thermometer(case, response):
    """Such as the displaced point."""
    tip = {"tip": case["probes"][SENSORS[0]]}
    machine = case_from_data(case | {"probes": case["probes"] | tip}, "case", Path())
    assert sensors_of(machine, {"run 1": response}) == SENSORS


def test_a_displacement_of_other_points_than_in_the_case_is_said(case, response):
    other = copy.deepcopy(case)
    del other["displacement"]["relative_to"]
    with pytest.warns(UserWarning, match="run 1 is that of A relative to B, in the case that of A"):
        warn_of_contradictions(case_from_data(other, "case", Path()), (), {"run 1": response})


def test_heat_that_a_response_does_not_divide_among_sources_is_said(case, response):
    """One source of the case runs by itself, so that the heat input does not tell its power."""
    (source,), both = case["sources"].values(), copy.deepcopy(case)
    both["sources"]["motor"] = source | {"heat_input": {"kind": "step", "level": 0.5}}
    several = case_from_data(both, "case", Path())
    with pytest.warns(UserWarning, match="run 1 has no power of each source.*'motor' of the case"):
        warn_of_contradictions(several, (), {"run 1": response.drop_vars("source_power")})


def test_the_ambient_is_known_by_its_name_in_any_unit(case, response, tmp_path):
    path = log_of(response, tmp_path / "log.csv")
    first, *rows = path.read_text("utf-8").splitlines()
    room = np.linspace(70.7, 74.3, len(rows))
    rows = [f"{row},{now:.6f}" for row, now in zip(rows, room, strict=True)]
    path.write_text("\n".join([f"{first},ambient [°F]", *rows]), encoding="utf-8")
    found = runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])
    ambient = found["run 1"]["ambient"].to_numpy()
    assert ambient == pytest.approx((room - room[0]) / 1.8, abs=1e-5)


def test_heat_that_changes_within_a_step_counts_by_its_mean(machine):
    times = 0.25 * machine.step * np.arange(1, 41)
    heat = np.where(np.arange(40) % 4 == 0, 2.0, 0.0)
    axes, probes = ["x", "y", "z"], list(machine.sensor_names)
    values = {
        "heat_input": heat,
        "temperature": np.zeros((40, len(probes))),
        "displacement": np.zeros((40, 3)),
    }
    fine = make_response(values, {"time": times, "probe": probes, "axis": axes})
    inputs = run_in(fine, machine, "run").inputs[:, : machine.power.size]
    assert inputs == pytest.approx(np.tile(0.5 * machine.power, (10, 1)), rel=1e-12)


def test_a_machine_whose_source_is_stronger_than_the_case_says_is_known_by_its_recorded_heat(
    case, machine
):
    """A fit laid it on expansion and films, as heat is known to a tenth."""
    stronger = copy.deepcopy(case)
    stronger["sources"]["bearings"]["reference_power_W"] *= 1.5
    response = run(stronger, set_up(case_from_data(stronger, "case", Path())), step(2.0), 1.0)
    inputs = run_in(response, machine, "run").inputs
    assert inputs[:, 0] == pytest.approx(np.full(len(inputs), 3.0 * machine.power[0]), rel=1e-12)
    assert calibrated_range(machine, {"run": response}).heat == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize(
    ("replaced", "by", "what"),
    [
        ("heat_W", "heat_A", "one column of the heat in W"),
        ("s_degC,b_degC,T1_degC,T2_degC", "p_degC,q_degC,r_degC,t_degC", "no temperature of a pr"),
        ("x_um", "tip_um", "no column|named 'x_um'"),
        ("T1_degC,T2_degC", "T1_degC,T1_degF", "both the temperature 'T1'"),
    ],
)
def test_a_log_that_does_not_say_what_the_machine_needs_is_refused(
    case, response, tmp_path, replaced, by, what
):
    path = log_of(response, tmp_path / "log.csv")
    path.write_text(path.read_text("utf-8").replace(replaced, by, 1), encoding="utf-8")
    with pytest.raises(InputError, match=what) as caught:
        runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um", "y_um"])
    assert "\n" not in str(caught.value)


def test_a_held_surface_is_read_from_the_log(case, response, tmp_path):
    """There was no probe of its name, whatever the log had."""
    (tmp_path / "held.csv").write_text("time_s,rise_K\n0,0\n600,2\n")
    held = case | {"held_temperatures": {"rear": {"file": str(tmp_path / "held.csv")}}}
    path = log_of(response, tmp_path / "log.csv")
    first, *rows = path.read_text("utf-8").splitlines()
    rows = [f"{row},{27.5 + 0.01 * k:.9g}" for k, row in enumerate(rows)]
    path.write_text("\n".join([f"{first},rear_degC", *rows]), encoding="utf-8")
    machine = case_from_data(held, "case", Path())
    runs = runs_of(read_log([path]), machine, ["x_um", "y_um"])
    names = sensors_of(machine, runs)
    assert names == (*SENSORS, "rear")
    inputs = run_in(runs["run 1"], machine_of(machine, names), "run 1").inputs
    surface = 27.5 - 21.5 + 0.01 * np.arange(1, len(inputs) + 1)
    assert inputs[:, 1] == pytest.approx(surface, abs=0.011)


def test_a_load_is_read_from_the_log(case, response, tmp_path):
    """A calibration refused the log of a machine under a changing load, whatever it had."""
    (tmp_path / "cut.csv").write_text("time_s,factor\n0,0\n600,1\n")
    cut = {"surface": "rear", "force_N": [0.0, 0.0, 100.0], "file": str(tmp_path / "cut.csv")}
    machine = case_from_data(case | {"loads": {"cut": cut}}, "case", Path())
    path = log_of(response, tmp_path / "log.csv")
    with pytest.raises(InputError, match="no column named 'cut_percent'"):
        runs_of(read_log([path]), machine, ["x_um", "y_um"])
    first, *rows = path.read_text("utf-8").splitlines()
    rows = [f"{row},{0.5 * k:g}" for k, row in enumerate(rows)]
    path.write_text("\n".join([f"{first},cut_percent", *rows]), encoding="utf-8")
    run = runs_of(read_log([path]), machine, ["x_um", "y_um"])["run 1"]
    factors = run["load_factor"].sel(load="cut").to_numpy()
    assert factors == pytest.approx(0.005 * np.arange(factors.size))


def test_the_power_of_a_motor_is_not_the_heat_of_its_source(case, response, tmp_path):
    """An estimator reads it beside the temperatures; a run counted all of it as heat."""
    source = case["sources"]["bearings"] | {"power_share": 0.3}
    shared = case_from_data(case | {"sources": {"bearings": source}}, "case", Path())
    path = log_of(response, tmp_path / "log.csv")
    text = path.read_text("utf-8")
    path.write_text(text.replace("heat_W", "bearings_power_W", 1), encoding="utf-8")
    with pytest.raises(InputError, match="one column of the heat in W is needed"):
        runs_of(read_log([path]), shared, ["x_um", "y_um"])
    first, *rows = text.splitlines()
    rows = [f"{row},{float(row.split(',')[1]) / 0.3:.9g}" for row in rows]
    path.write_text("\n".join([f"{first},bearings_power_W", *rows]), encoding="utf-8")
    found = runs_of(read_log([path]), shared, ["x_um", "y_um"])["run 1"]
    wanted = response["heat_input"].to_numpy()
    assert found["heat_input"].to_numpy() == pytest.approx(wanted, abs=1e-9)


def test_a_run_that_begins_warm_is_refused(case, response, tmp_path):
    path = log_of(response.isel(time=slice(200, None)), tmp_path / "log.csv")
    with pytest.raises(InputError, match="begin with the machine at rest"):
        runs_of(read_log([path]), case_from_data(case, "case", Path()), ["x_um"])


def test_a_response_that_begins_warm_is_refused(case, response):
    """Heat and films of the machine were fitted to what it had left from before."""
    made = case_from_data(case, "case", Path())
    machine = reduce_machine(made, set_up(made), SENSORS)
    assert run_in(response, machine, "step").times[0] == 0.0
    warm = response.assign(temperature=response["temperature"] + 5.0)
    warm["temperature"].attrs = response["temperature"].attrs
    with pytest.raises(InputError, match=r"step: \w+ begins \+5.0 K from the ambient"):
        run_in(warm, machine, "step")


def test_the_command_needs_the_machine(response, tmp_path):
    log = log_of(response, tmp_path / "log.csv")
    out = tmp_path / "model.h5"
    given = ["learn", str(log), "--displacement", "x_um", "--kind", "joint-aware"]
    result = CliRunner().invoke(app, [*given, "--out", str(out)])
    assert "--case" in str(result.exception)
    assert not out.exists()
