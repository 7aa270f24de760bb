"""One case in a worker: what comes back, whatever happens to its files and to the disk."""

import moving_knee
import numpy as np
import pytest
from batch_cases import levels, study_in, write_study

from fesim.batch import worker
from fesim.batch.study import read_study
from fesim.batch.summary import columns, figures_of, is_open, is_sliding
from fesim.batch.worker import Task, run
from fesim.case.history import read_history
from fesim.case.identity import case_id, condensation_key, file_digest, shared_key
from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from fesim.solid.linear_solver import VARIABLE
from meshes.exchange import read_structure
from thermojoint.artefacts.errors import InputError, UnreadableError

HEAT = "time_s,heat_input\n0,1\n60,2\n"


def task_of(one):
    return Task(one.id, one.key, one.case.model_dump_json())


@pytest.fixture
def sampled(tmp_path):
    """A study of one case, whose heat stands in a file, and the file."""
    heat = tmp_path / "heat.csv"
    heat.write_text(HEAT)
    varied = "[[grid]]\npath = 'heat_input'\nvalues = [{kind = 'sampled', file = 'heat.csv'}]\n"
    return read_study(write_study(tmp_path, varied, 1.0)), heat


@pytest.mark.parametrize("read", [file_digest, read_history, read_structure])
def test_a_file_that_is_not_there_is_told_from_one_that_is_wrong(tmp_path, read):
    with pytest.raises(UnreadableError, match=r"none\.vtu"):
        read(tmp_path / "none.vtu")
    if read is not file_digest:
        (tmp_path / "wrong.vtu").write_bytes(b"\xff wrong")
        with pytest.raises(InputError) as refusal:
            read(tmp_path / "wrong.vtu")
        assert type(refusal.value) is InputError


def test_a_case_whose_file_is_out_of_reach_breaks_off_and_runs_when_it_is_back(sampled):
    study, heat = sampled
    [one] = study.cases
    heat.unlink()
    outcome = run(task_of(one))
    assert (outcome.status, outcome.response) == ("broken", None)
    assert "heat.csv: cannot be read" in outcome.reason
    heat.write_text(HEAT)
    assert run(task_of(one)).status == "done"


def test_a_file_that_is_not_the_one_of_the_study_gives_no_result(sampled):
    study, heat = sampled
    heat.write_text(HEAT.replace("2", "3"))
    outcome = run(task_of(study.cases[0]))
    assert (outcome.status, outcome.response) == ("broken", None)
    assert "not the one that the study was read with" in outcome.reason


@pytest.mark.parametrize("half", [HEAT.replace("2", "3"), "time_s,heat_in"])
def test_a_file_that_is_edited_during_the_run_gives_no_result(sampled, monkeypatch, half):
    study, heat = sampled

    def edited(case, **others):
        heat.write_text(half)
        return simulate(case, **others)

    monkeypatch.setattr(worker, "simulate", edited)
    outcome = run(task_of(study.cases[0]))
    assert (outcome.status, outcome.response) == ("broken", None)
    assert "not the one that the study was read with" in outcome.reason


def test_a_mesh_that_is_edited_while_it_is_condensed_is_not_kept(
    coarse_data, tmp_path, monkeypatch
):
    mesh, condensed = tmp_path / "machine.vtu", []
    mesh.write_text("as read")
    data = coarse_data | {"structure": {"kind": "mesh", "file": "machine.vtu"}}
    case = case_from_data(data, "case", tmp_path)
    task = Task(case_id(case), condensation_key(case), case.model_dump_json())

    def edited(case):
        condensed.append(mesh.read_text())
        mesh.write_text("edited")

    monkeypatch.setattr(worker, "prepared", edited)
    for _ in range(2):
        mesh.write_text("as read")
        assert run(task).status == "broken"
    assert condensed == ["as read"] * 2


def test_a_full_disk_breaks_a_case_off_and_does_not_end_the_worker(tmp_path, monkeypatch):
    def full(response):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(worker, "response_bytes", full)
    study = study_in(tmp_path, levels(1), 1.0)
    outcome = run(task_of(study.cases[0]))
    assert (outcome.status, outcome.response) == ("broken", None)
    assert "No space left on device" in outcome.reason


def test_a_solver_that_this_computer_lacks_breaks_a_case_off(tmp_path, monkeypatch):
    worker._condensed.cache_clear()
    study = study_in(tmp_path, levels(1), 1.0)
    monkeypatch.setenv(VARIABLE, "pardizo")
    assert run(task_of(study.cases[0])).status == "broken"
    monkeypatch.delenv(VARIABLE)
    assert run(task_of(study.cases[0])).status == "done"


def test_only_a_condensation_that_is_made_takes_time(tmp_path):
    worker._condensed.cache_clear()
    study = study_in(tmp_path, levels(2), 1.0)
    first, second = (run(task_of(one)) for one in study.cases)
    assert first.setup_seconds > 0.0
    assert second.setup_seconds == 0.0
    assert first.seconds > 0.0
    assert second.seconds > 0.0


def test_an_element_slides_in_the_steps_that_change_its_slip():
    slip = np.zeros((4, 2, 2))
    slip[2:, 1, 0] = 1e-9
    slip[3, 0, 1] = 1e-14  # what the gap equations leave
    assert is_sliding(slip).tolist() == [[False, False], [False, True], [False, False]]


def test_a_run_that_goes_on_is_open_by_its_preload_not_by_its_first_row(coarse_response):
    going_on = coarse_response.isel(time=slice(10, None)).copy(deep=True)
    pressure = going_on["pressure"].to_numpy()
    pressure[:, 0] = 1.0  # open all the time, at a millionth of its preload
    going_on = going_on.assign(pressure=(going_on["pressure"].dims, pressure))
    area = going_on["contact_area"].to_numpy()
    assert figures_of(going_on)["open_share_final"] == pytest.approx(area[0] / area.sum())


def test_an_element_is_open_below_a_thousandth_of_its_own_preload():
    pressure = np.array([[4e6, 1e5, 1e5], [4.1e3, 1.1e2, 0.0], [3.9e3, 0.9e2, 1e5]])
    assert is_open(pressure).tolist() == [[False] * 3, [False, False, True], [True, True, False]]


@pytest.mark.parametrize("changes", [{}, {"joints": {"knee": {"preload_MPa": 3.0}}}])
def test_a_machine_with_axes_moves_as_in_a_simulation(changes):
    case = moving_knee.coarse().replace(**changes)
    outcome = run(Task(case_id(case), shared_key(case), case.model_dump_json()))
    assert outcome.reason == ""
    alone = simulate(case, accuracy=False).response
    for name in ("displacement", "line_slope", "asked_displacement"):
        found, expected = outcome.response[name].to_numpy(), alone[name].to_numpy()
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-13)


def test_a_machine_with_axes_has_figures_of_its_lines_and_of_where_its_displacement_is_largest():
    case = moving_knee.coarse()
    response = simulate(case, accuracy=False).response
    figures, along_x = figures_of(response), response.sel(axis="x", moving_axis="y")
    assert set(columns(["y"])) >= set(figures)
    final = along_x.isel(time=-1)
    for name, variable in (
        ("K0_y_final_um", "line_offset"),
        ("slope_y_final_um_per_m", "line_slope"),
        ("left_y_final_um", "line_left"),
    ):
        expected = pytest.approx(1e6 * final[variable].item(), rel=1e-12)
        assert figures[f"displacement_x_{name}"] == expected
    everywhere = 1e6 * along_x["asked_displacement"]
    assert abs(figures["displacement_x_asked_y_peak_um"]) == np.abs(everywhere).max().item()
    assert figures["displacement_x_asked_y_final_um"] in everywhere.isel(time=-1).to_numpy()
