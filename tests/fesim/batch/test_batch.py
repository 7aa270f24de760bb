"""Batches end to end: nothing is lost or run twice, whatever dies; the results say what is true."""

import errno
import json
import os
import runpy
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import moving_knee
import numpy as np
import pandas as pd
import pytest
import xarray as xr
import zarr
from batch_cases import grid, levels, study_in, tally, write_study
from nested_toml import as_toml
from repository import ROOT
from small_disk import mounted

from fesim.batch.crew import Report
from fesim.batch.folder import locked, response_path
from fesim.batch.local import local_crew
from fesim.batch.run import MOST_LOSSES, run_batch
from fesim.batch.study import read_study
from fesim.batch.summary import FIGURES
from fesim.batch.worker import run
from fesim.joint.gap import TOLERANCE
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import whole_file, write_text
from thermojoint.artefacts.response import read_response


class HereCrew:
    """Workers that work here, one case a gathering; some cases are the death of them."""

    def __init__(self, deadly=()):
        self.deadly, self.number, self.task = deadly, 0, None

    def members(self):
        return [f"worker {self.number}"]

    def idle(self):
        return [] if self.task else self.members()

    def hand(self, worker, task):
        self.task = task

    def gather(self, timeout):
        worker, task, self.task = self.members()[0], self.task, None
        if task.id in self.deadly:
            self.number += 1
            return [Report(worker, task, None, "killed by SIGKILL")]
        return [Report(worker, task, run(task))]


def here(*deadly):
    @contextmanager
    def recruit():
        yield HereCrew(deadly)

    return recruit


def nobody():
    raise AssertionError("workers were asked for")


def opened(folder):
    return xr.open_dataset(folder / "dataset.zarr", engine="zarr").load()


def kill_one_of(progress):
    worker = next(iter(progress.working))
    os.kill(int(worker.removeprefix("process ")), signal.SIGKILL)
    return worker


def gone(process_id, within=20.0):
    """Whether a process ends within some seconds."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        with suppress(FileNotFoundError):
            state = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
            if state != "Z":
                time.sleep(0.05)
                continue
        return True
    return False


@contextmanager
def started(study, out, cases, workers):
    """The command in a process of its own, once it has finished some cases."""
    command = [sys.executable, "-m", "thermojoint", "batch", study, "--out", out]
    with subprocess.Popen(
        [*map(str, command), "--workers", str(workers)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            while len(list((out / "records").glob("*.json"))) < cases:
                assert process.poll() is None, process.stderr.read()
                time.sleep(0.02)
            yield process
        finally:
            process.kill()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Eight cases on two processes, one of which is killed in the middle."""
    folder = tmp_path_factory.mktemp("batch")
    study = study_in(folder, levels(8), minutes=4.0)
    killed, told = [], []

    def watch(progress):
        if not killed and progress.counts.get("done", 0) >= 3 and len(progress.working) == 2:
            killed.append(kill_one_of(progress))

    end = run_batch(
        study,
        folder / "out",
        lambda: local_crew(2),
        watch=watch,
        tell=lambda case, text: told.append(text),
    )
    assert len(killed) == 1
    return study, folder / "out", end, killed[0], told


def test_a_killed_worker_costs_no_case_and_repeats_none_that_was_finished(finished):
    study, out, end, killed, told = finished
    assert (end.summary["status"] == "done").all()
    assert end.ran == len(study.cases) == 8
    events = tally(out)
    assert set(events["done"].values()) == {1}
    assert len(events["done"]) == 8
    assert events["lost"].total() == 1
    assert events["started"] == events["done"] + events["lost"]
    assert told == [f"{killed} is lost (killed by SIGKILL); the case starts again"]


def test_the_condensation_is_made_once_a_worker(finished):
    _, _, end, _, _ = finished
    condensed = end.summary["setup_seconds"] > 0.3 * end.summary["setup_seconds"].max()
    assert condensed.sum() <= 3


def test_a_batch_gives_what_single_simulations_give(finished):
    """But for rounding, which differs with the threads, and what it makes of a residual."""
    study, out, _, _, _ = finished
    one = study.cases[7]
    alone = simulate(one.case).response
    together = read_response(response_path(out, one.id))
    for name in set(alone.data_vars) - {"gap_residual", "heat_balance"}:
        if alone[name].dtype.kind == "f":
            scale = float(np.abs(alone[name]).max())
            np.testing.assert_allclose(together[name], alone[name], rtol=0.0, atol=1e-8 * scale)
    assert (together["gap_residual"] <= TOLERANCE).all()
    assert (np.abs(together["heat_balance"]) <= 1e-8).all()


def test_the_dataset_holds_every_response_under_its_labels(finished):
    study, out, _, _, _ = finished
    data = opened(out)
    assert (data["status"] == 1).all()
    assert set(data["heat_input.level"].coords) == {"case", "heat_input.level"}
    for one in study.cases[::5]:
        row, response = data.sel(case=one.id), read_response(response_path(out, one.id))
        assert float(row["heat_input.level"]) == one.values["heat_input.level"]
        for name in response.data_vars:
            np.testing.assert_array_equal(row[name].to_numpy(), response[name].to_numpy())
        assert data["displacement"].attrs["units"] == "m"


def test_displacements_alone_are_those_of_the_responses_and_go_on_as_well(finished, tmp_path):
    """No response is written; a record without its row in the dataset counts as not run."""
    whole, out, _, _, _ = finished
    study = replace(whole, cases=whole.cases[:4], keep="displacement")
    end = run_batch(study, tmp_path, here())
    assert (end.summary["status"] == "done").all()
    assert not (tmp_path / "responses").exists()
    data, every = opened(tmp_path), opened(out)
    assert set(data.data_vars) == {"displacement", "status"}
    for one in study.cases:
        ours, theirs = (each["displacement"].sel(case=one.id) for each in (data, every))
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12)
    figures = [name for name in FIGURES if name.startswith(("pressure", "temperature"))]
    expected = pd.read_parquet(out / "summary.parquet").set_index("id")
    found = end.summary.set_index("id")
    np.testing.assert_allclose(found[figures], expected.loc[found.index, figures], rtol=1e-6)
    (tmp_path / "records" / f"{study.cases[2].id}.json").unlink()
    assert run_batch(study, tmp_path, here()).ran == 1
    assert run_batch(study, tmp_path, nobody).ran == 0
    shutil.rmtree(tmp_path / "dataset.zarr")
    assert run_batch(study, tmp_path, here()).ran == 4
    assert (opened(tmp_path)["status"] == 1).all()


def test_the_tables_agree_and_say_what_the_responses_say(finished):
    study, out, end, _, _ = finished
    parquet = pd.read_parquet(out / "summary.parquet")
    # No case has bolts, secant steps, or asks for forces: nothing stands in their columns.
    columns = "bolt_force_min_N", "bolt_force_max_N", "secant_residual_K", "force_balance"
    empty = {"x": []} | {name: [""] for name in columns}
    table = pd.read_csv(out / "summary.csv", keep_default_na=False, na_values=empty)
    pd.testing.assert_frame_equal(parquet, end.summary)
    pd.testing.assert_frame_equal(table, parquet, check_dtype=False)
    assert list(table["id"]) == [one.id for one in study.cases]
    assert set(FIGURES) <= set(table.columns)
    row, response = table.iloc[4], read_response(response_path(out, table["id"][4]))
    track = 1e6 * response["displacement"].sel(axis="x").to_numpy()
    final, peak = row["displacement_x_final_um"], abs(row["displacement_x_peak_um"])
    assert final == pytest.approx(track[-1], rel=1e-12, abs=0.0)
    assert peak == pytest.approx(np.abs(track).max(), rel=1e-12, abs=0.0)
    assert row["pressure_min_MPa"] == pytest.approx(1e-6 * float(response["pressure"].min()))
    assert row["iterations"] == response["iterations"].sum()
    assert row["steps"] == 120


def test_a_finished_batch_asks_nobody_to_work(finished):
    study, out, end, _, _ = finished
    again = run_batch(study, out, nobody)
    assert (again.found, again.ran, again.stopped) == (8, 0, False)
    pd.testing.assert_frame_equal(again.summary, end.summary)


def test_a_batch_goes_on_once_a_full_disk_has_room(tmp_path):
    study = study_in(tmp_path, levels(8))
    whole = run_batch(study, tmp_path / "roomy", here())
    with mounted(tmp_path / "disk", 1) as disk:
        with pytest.raises(OSError, match="No space left on device"):
            run_batch(study, disk / "out", here())
        subprocess.run(["mount", "-o", "remount,size=50m", str(disk)], check=True)
        end = run_batch(study, disk / "out", here())
        assert 0 < end.found < 8 == end.found + end.ran
    told = ["status", *(name for name in end.summary if name.endswith("_um"))]
    pd.testing.assert_frame_equal(end.summary[told], whole.summary[told])


def test_an_error_of_the_disk_that_names_no_file_names_the_folder(tmp_path, monkeypatch):
    def full(*given):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("fesim.batch.dataset.store_response", full)
    with pytest.raises(OSError, match="No space left on device") as said:
        run_batch(study_in(tmp_path, levels(1)), tmp_path / "out", here())
    assert said.value.filename == str(tmp_path / "out")


def test_the_dataset_has_the_heat_of_screws(tmp_path):
    """Surfaces that it warms are sources of a response which its case does not list."""
    data = moving_knee.coarse_data()
    data["axes"]["y"]["ball_screw"] = moving_knee.SCREW | {
        "bearing_surface": "rear",
        "bearing_conductance_W_K": 3.0,
    }
    data["materials"]["steel"] = moving_knee.STEEL
    (tmp_path / "machine.toml").write_text(as_toml(data))
    (tmp_path / "study.toml").write_text(f'case = "machine.toml"\n{levels(1)}')
    run_batch(read_study(tmp_path / "study.toml"), tmp_path / "out", here())
    (stored,) = opened(tmp_path / "out")["source_power"].sel(source="y bearing")
    assert stored.max() > 0.0


def test_after_kill_9_the_rest_runs_and_nothing_runs_again(tmp_path):
    path, out = write_study(tmp_path, levels(8), minutes=5.0), tmp_path / "out"
    with started(path, out, 2, workers=1) as process:
        process.kill()
        process.wait()
        workers = {int(line.split()[-1].strip('}"\n')) for line in journal(out, "started")}
    before = tally(out)
    assert all(gone(worker) for worker in workers)
    (out / "responses" / ".half.abcd_123.nc").write_text("what was being written")
    end = run_batch(read_study(path), out, here())
    assert (end.summary["status"] == "done").all()
    assert end.found >= 2
    events = tally(out)
    assert set(events["done"].values()) == {1}
    found = set(before["done"])
    assert all(events["started"][case] == 1 for case in found)
    assert not list((out / "responses").glob(".*"))
    assert (opened(out)["status"] == 1).all()
    assert not opened(out)["displacement"].isnull().any()


def journal(out, event):
    lines = (out / "journal.jsonl").read_text().splitlines()
    return [line for line in lines if f'"event": "{event}"' in line]


def test_ctrl_c_finishes_what_is_at_work_and_the_same_command_goes_on(tmp_path):
    path, out = write_study(tmp_path, levels(8), minutes=5.0), tmp_path / "out"
    with started(path, out, 2, workers=2) as process:
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
        said = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert "the same command continues" in said
    events = tally(out)
    assert events["started"] == events["done"]
    assert 2 <= len(events["done"]) < 8
    table = pd.read_parquet(out / "summary.parquet")
    assert set(table["status"]) == {"done", "pending"}
    end = run_batch(read_study(path), out, here())
    assert not end.stopped
    assert set(tally(out)["started"].values()) == {1}
    assert len(tally(out)["done"]) == 8


def test_a_record_that_was_not_written_any_more_is_made_from_the_response(tmp_path):
    study = study_in(tmp_path, levels(2), minutes=1.0)
    run_batch(study, tmp_path / "out", here())
    lost = study.cases[0].id
    (tmp_path / "out" / "records" / f"{lost}.json").unlink()
    end = run_batch(study, tmp_path / "out", nobody)
    assert (end.summary["status"] == "done").all()
    assert end.summary["displacement_x_final_um"].notna().all()


@pytest.mark.parametrize("recorded", [True, False])
def test_a_damaged_response_is_told_of_and_the_case_runs_again(tmp_path, recorded):
    study, out = study_in(tmp_path, levels(2), 1.0), tmp_path / "out"
    before = run_batch(study, out, here()).summary
    lost = study.cases[1].id
    response_path(out, lost).write_bytes(b"")
    if recorded:
        shutil.rmtree(out / "dataset.zarr")  # to be made from the responses
    else:
        (out / "records" / f"{lost}.json").unlink()
    told = []
    end = run_batch(study, out, here(), tell=lambda case, text: told.append((case.id, text)))
    assert told == [(lost, "its response in the folder is damaged; it runs again")]
    assert (end.found, end.ran) == (1, 1)
    figures = ["status", *FIGURES]
    pd.testing.assert_frame_equal(end.summary[figures], before[figures])
    assert read_response(response_path(out, lost)).sizes["time"] == 31
    assert opened(out)["displacement"].notnull().all()


def test_a_damaged_record_is_made_again_from_the_response(tmp_path):
    study, out = study_in(tmp_path, levels(1), 1.0), tmp_path / "out"
    run_batch(study, out, here())
    record = out / "records" / f"{study.cases[0].id}.json"
    whole = json.loads(record.read_text())
    damaged = [b"", b"{", b"\xff\xfe", b"[]", b"3", b"{}", b'{"status": "done"}', b'{"status": []}']
    for content in damaged:
        record.write_bytes(content)
        end = run_batch(study, out, nobody)
        assert list(end.summary["status"]) == ["done"]
        assert json.loads(record.read_text()) == whole | {"seconds": 0.0, "setup_seconds": 0.0}


def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr("os.fsync", lambda number: synced.append((tmp_path / "a.json").exists()))
    write_text(tmp_path / "a.json", "{}")
    assert synced == [False]


def test_only_what_a_killed_batch_left_is_cleared_away(tmp_path):
    left = []
    for path in ("summary.csv", "summary.parquet", "responses/0f.nc", "records/0f.json"):
        with suppress(KeyboardInterrupt), whole_file(tmp_path / path) as part:
            left.append(part.rename(part.with_suffix(".kept")))
            raise KeyboardInterrupt
        left[-1] = left[-1].rename(part)
    (tmp_path / "dataset.zarr" / "status").mkdir(parents=True)
    for name in (".zmetadata.0f.partial", "status/3.0f.partial"):
        left.append(tmp_path / "dataset.zarr" / name)
        left[-1].touch()
    others = [tmp_path / name for name in (".env.local.bak", ".summary.old.csv", ".a.b.c")]
    others.append(tmp_path / "dataset.zarr" / "status" / "3")
    for path in others:
        path.touch()
    (tmp_path / "lock").touch()
    with locked(tmp_path):
        assert not any(path.exists() for path in left)
        assert all(path.exists() for path in others)


def test_the_last_look_at_a_batch_shows_all_of_it(tmp_path):
    study, seen = study_in(tmp_path, levels(2), 1.0), []
    run_batch(study, tmp_path / "out", here(), watch=seen.append)
    assert seen[0].counts == {}
    assert (seen[-1].counts, seen[-1].working) == ({"done": 2}, {})


def test_a_failing_case_is_reported_and_stops_no_other(tmp_path):
    # The third one lies outside the column: only the finite elements can tell.
    places = [[625.0, 450.0, 87.5], [625.0, 460.0, 87.5], [700.0, 1000.0, 87.5]]
    study, out = study_in(tmp_path, grid("probes.T1.position_mm", *places), 1.0), tmp_path / "out"
    told = []
    end = run_batch(study, out, here(), tell=lambda case, text: told.append((case.id, text)))
    assert list(end.summary["status"]) == ["done", "done", "failed"]
    reason = end.summary["reason"][2]
    assert "T1" in reason
    assert told == [(study.cases[2].id, reason)]
    data = opened(out)
    assert list(data["status"]) == [1, 1, 2]
    assert data["displacement"][2].isnull().all()
    # What failed for good fails again: it is not repeated either.
    assert run_batch(study, out, nobody).ran == 0


def test_a_case_that_kills_its_workers_is_given_up_and_tried_again_next_time(tmp_path):
    study, out = study_in(tmp_path, levels(3), 1.0), tmp_path / "out"
    deadly = study.cases[1].id
    end = run_batch(study, out, here(deadly))
    assert list(end.summary["status"]) == ["done", "broken", "done"]
    assert end.summary["reason"][1] == f"lost {MOST_LOSSES} workers: killed by SIGKILL"
    assert tally(out)["started"][deadly] == MOST_LOSSES
    again = run_batch(study, out, here())
    assert (again.found, again.ran) == (2, 1)
    assert list(again.summary["status"]) == ["done"] * 3


def test_a_kill_before_the_status_was_written_loses_no_case(tmp_path):
    study, out = replace(study_in(tmp_path, levels(3), 1.0), keep="displacement"), tmp_path / "out"
    run_batch(study, out, here())
    zarr.open_group(out / "dataset.zarr", mode="r+")["status"][...] = 0
    assert run_batch(study, out, nobody).ran == 0
    data = opened(out)
    assert (data["status"] == 1).all()
    assert not data["displacement"].isnull().all(["time", "axis"]).any()


def test_a_batch_whose_workers_never_come_back_ends_and_says_so(tmp_path):
    study, out = study_in(tmp_path, levels(6), 1.0), tmp_path / "out"
    with pytest.raises(InputError, match=r"6 workers are lost .* and none has come"):
        run_batch(study, out, here(*(case.id for case in study.cases)))
    end = run_batch(study, out, here())
    assert list(end.summary["status"]) == ["done"] * 6


def test_a_changed_study_finds_the_cases_it_has_in_common_with_the_old_one(tmp_path):
    out = tmp_path / "out"
    old = study_in(tmp_path, levels(3), 1.0)
    run_batch(old, out, here())
    new = study_in(
        tmp_path, grid("march.duration_min", 1.0, 2.0) + grid("heat_input.level", 0.75, 3.0), 1.0
    )
    end = run_batch(replace(new, title="Grown"), out, here())
    assert (end.found, end.ran) == (1, 3)
    data = opened(out)
    assert data.attrs["title"] == "Grown"
    run_batch(replace(new, title="Renamed"), out, nobody)
    assert opened(out).attrs["title"] == "Renamed"
    assert data.sizes["case"] == 4
    assert float(data["time"][-1]) == 120.0
    short = data["march.duration_min"] == 1.0
    assert data["displacement"].where(short, drop=True).sel(time=slice(61, None)).isnull().all()
    assert data["displacement"].sel(time=slice(0, 60)).notnull().all()


def test_a_grown_study_of_displacements_runs_only_what_is_new(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    whole, out = replace(study_in(tmp_path, levels(4), 1.0), keep="displacement"), tmp_path / "out"
    run_batch(replace(whole, cases=whole.cases[1:3]), out, here())
    before = opened(out)["displacement"].load()
    with monkeypatch.context() as killed:
        # As the displacements are about to be carried over: they exist nowhere else.
        killed.setattr("fesim.batch.dataset._write", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_batch(whole, out, nobody)
    xr.testing.assert_identical(opened(out)["displacement"], before)
    end = run_batch(whole, out, here())
    assert (end.found, end.ran) == (2, 2)
    assert not list(out.glob(".dataset*"))
    after = opened(out)["displacement"]
    assert after.notnull().all()
    np.testing.assert_array_equal(after.sel(case=before["case"]), before)


def test_cases_of_different_joints_and_steps_stand_in_one_dataset(tmp_path):
    out = tmp_path / "out"
    varied = grid("joints.knee.across", 1, 2) + grid("march.step_s", 2.0, 3.0)
    study = study_in(tmp_path, varied, 1.0)
    run_batch(study, out, here())
    data = opened(out)
    assert data.sizes["contact"] == 2 * data["pressure"].isel(case=0).notnull().any("time").sum()
    for one in study.cases:
        row = data.sel(case=one.id)
        response = read_response(response_path(out, one.id))
        kept = row["pressure"].dropna("time", how="all").dropna("contact", how="all")
        np.testing.assert_array_equal(kept["time"], response["time"])
        np.testing.assert_array_equal(kept.to_numpy(), response["pressure"].to_numpy())


def test_a_dataset_has_the_variables_of_the_responses_and_no_others(tmp_path):
    """Held temperatures among them."""
    path = write_study(tmp_path, levels(1), minutes=0.2)
    held = "[held_temperatures.screw_foot]\nrise_K = 2.0\n"
    with (tmp_path / "machine.toml").open("a") as machine:
        machine.write(held)
    study = read_study(path)
    run_batch(study, tmp_path / "out", here())
    data, (case,) = opened(tmp_path / "out"), study.cases
    response = read_response(response_path(tmp_path / "out", case.id))
    assert set(data.data_vars) == {*response.data_vars, "status"}
    np.testing.assert_array_equal(data["held_temperature"][0], response["held_temperature"])
    assert data["held"].to_numpy().tolist() == ["screw_foot"]


def test_two_batches_do_not_write_into_one_folder(tmp_path):
    study, out = study_in(tmp_path, levels(2), 1.0), tmp_path / "out"
    with locked(out), pytest.raises(InputError, match=f"another batch.*process {os.getpid()} on"):
        run_batch(study, out, nobody)


def test_a_lock_that_a_dead_process_left_is_in_nobodys_way(tmp_path):
    out = tmp_path / "out"
    hold = (
        "import sys, time\nfrom pathlib import Path\nfrom fesim.batch.folder import locked\n"
        "with locked(Path(sys.argv[1])):\n    print('held', flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", hold, out], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        with pytest.raises(InputError, match=f"process {process.pid}"), locked(out):
            pass
        process.kill()
    with locked(out):
        assert str(os.getpid()) in (out / "lock").read_text()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["study.toml", "--out", "study.toml"], "is a file"),
        (["study.toml", "--out", "out", "--workers", "0"], "--workers 0"),
        (["study.toml", "--out", "out", "--workers", "2", "--scheduler", "tcp://x:1"], "--workers"),
        (["bad.toml", "--out", "out"], "did you mean 'heat_input.level'?"),
        (["none.toml", "--out", "out"], "none.toml: cannot be read"),
    ],
)
def test_a_bad_command_ends_with_one_line_and_exit_code_2(
    command, tmp_path, monkeypatch, arguments, told
):
    write_study(tmp_path, grid("heat_input.levels", 1.0)).rename(tmp_path / "bad.toml")
    write_study(tmp_path, levels(2), 1.0)
    monkeypatch.chdir(tmp_path)
    code, _, err = command("batch", *arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert told in err
    assert not (tmp_path / "out" / "records").exists()


EXAMPLE = ROOT / "examples" / "batch"


@pytest.mark.long
def test_the_example_study_runs_and_its_script_reads_the_results(tmp_path):
    for name, old, new in (
        ("study.toml", "samples = 20", "samples = 3"),
        ("machine.toml", "duration_min = 35.0", "duration_min = 2.0"),
    ):
        text = (EXAMPLE / name).read_text()
        assert old in text
        (tmp_path / name).write_text(text.replace(old, new))
    end = run_batch(read_study(tmp_path / "study.toml"), tmp_path / "out", here())
    assert list(end.summary["status"]) == ["done"] * 6
    look = runpy.run_path(str(EXAMPLE / "look.py"))
    per_heat = look["displacement_per_heat"](tmp_path / "out")
    assert list(per_heat.index) == [0.2, 0.6]
    # Away from the warm side, and upwards.
    assert (per_heat["displacement_x_final_um"]["mean"] < 0.0).all()
    assert (per_heat["displacement_y_final_um"]["mean"] > 0.0).all()
    lost = look["pressure_lost"](tmp_path / "out").to_numpy()
    assert (lost > 0.0).all()
    assert lost[-1] > lost[0]
