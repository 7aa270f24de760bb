"""Batches on a real Dask cluster of two worker processes, one of which is killed in the middle."""

import os
import signal
from functools import partial
from importlib.metadata import PackageNotFoundError

import pytest
from batch_cases import levels, study_in, tally

from fesim.batch.folder import response_path
from fesim.batch.run import run_batch
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import read_response

distributed = pytest.importorskip("distributed")

from fesim.batch.cluster import OWN_VERSION, DaskCrew, dask_crew  # noqa: E402 - it needs Dask
from thermojoint.cli import batch_run  # noqa: E402 - it needs Dask


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as running:
        yield running


def process_ids(cluster):
    with distributed.Client(cluster, set_as_default=False) as client:
        return client.run(os.getpid)


def test_a_worker_that_dask_loses_costs_no_case_and_repeats_none_that_was_finished(
    tmp_path, cluster
):
    study, out = study_in(tmp_path, levels(8), minutes=4.0), tmp_path / "out"
    processes, killed, told = process_ids(cluster), [], []
    assert len(processes) == 2

    def watch(progress):
        if not killed and progress.counts.get("done", 0) >= 3 and len(progress.working) == 2:
            killed.append(next(iter(progress.working)))
            os.kill(processes[killed[0]], signal.SIGKILL)

    end = run_batch(
        study,
        out,
        lambda: dask_crew(cluster.scheduler_address),
        watch=watch,
        tell=lambda case, text: told.append(text),
    )
    assert len(killed) == len(told) == 1
    assert f"{killed[0]} is lost" in told[0]
    assert (end.summary["status"] == "done").all()
    events = tally(out)
    assert set(events["done"].values()) == {1}
    assert len(events["done"]) == 8
    assert events["started"] == events["done"] + events["lost"]
    assert events["lost"].total() == 1
    assert read_response(response_path(out, study.cases[0].id)).sizes["time"] == 121


def test_the_command_uses_a_cluster_that_is_there(tmp_path, cluster):
    study, out = study_in(tmp_path, levels(3), 1.0), tmp_path / "out"
    recruit = partial(batch_run.crew_of, 1, cluster.scheduler_address)
    end = batch_run.run_cases(study, "study", out, recruit)
    assert (end.ran, batch_run.worst(end)) == (3, 0)
    workers = {line.split('"worker": ')[1] for line in (out / "journal.jsonl").open()}
    assert all("tcp://" in worker for worker in workers)


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path):
    study = study_in(tmp_path, levels(2), 1.0)
    with pytest.raises(InputError, match="no Dask scheduler responds there"):
        run_batch(study, tmp_path / "out", lambda: dask_crew("tcp://127.0.0.1:9", timeout=1.0))


def test_a_cluster_with_another_version_is_refused(cluster, monkeypatch):
    monkeypatch.setattr("fesim.batch.cluster.OWN_VERSION", "0.0.0")
    with (
        pytest.raises(InputError, match="install the same version there"),
        dask_crew(cluster.scheduler_address) as crew,
    ):
        crew.members()


class FakeClient:
    """A cluster whose workers are named here, each with its version or what asking it raises."""

    def __init__(self, **workers):
        self.workers, self.asked = workers, []

    def nthreads(self):
        return dict.fromkeys(self.workers, 1)

    def run(self, function, *arguments, workers):
        [worker] = workers
        self.asked.append(worker)
        if isinstance(self.workers[worker], Exception):
            raise self.workers[worker]
        return {worker: self.workers[worker]}


def test_a_worker_that_leaves_while_it_is_asked_ends_nothing():
    client = FakeClient(a=OWN_VERSION, b=OSError("Timed out"))
    crew = DaskCrew(client, lambda text: None)
    assert crew.members() == ["a"]
    client.workers["b"] = OWN_VERSION
    assert crew.members() == crew.idle() == ["a", "b"]
    assert client.asked == ["a", "b", "b"]


def test_a_later_worker_of_another_version_is_told_of_once_and_gets_no_cases():
    told = []
    client = FakeClient(a=OWN_VERSION)
    crew = DaskCrew(client, told.append)
    assert crew.members() == ["a"]
    client.workers |= {"b": "0.0.0", "c": PackageNotFoundError(), "d": OWN_VERSION}
    for _ in range(2):
        assert crew.members() == crew.idle() == ["a", "d"]
    assert len(told) == 2
    assert "worker b has thermojoint 0.0.0" in told[0]
    assert "worker c has thermojoint not installed" in told[1]
