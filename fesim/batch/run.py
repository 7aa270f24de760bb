"""Main loop of a batch: assigns cases to workers, writes results, resumes after interruptions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from fesim.batch import dataset as collected
from fesim.batch import folder as on_disk
from fesim.batch.crew import Crew, Report
from fesim.batch.queue import Queue
from fesim.batch.study import Study, StudyCase
from fesim.batch.summary import figures_of
from fesim.batch.worker import Outcome, Task
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import read_response

if TYPE_CHECKING:
    import pandas as pd

#: A case that has lost this many workers is abandoned: it is the probable cause.
MOST_LOSSES = 3
#: The tables are rewritten after this many seconds, and after this many times the duration of
#: writing them, which is seconds with 100 000 rows.
TABLE_INTERVAL, TABLE_SHARE = 10.0, 20.0
#: Longest wait for reports before a stop is noticed, s.
TICK = 0.2


@dataclass(frozen=True)
class Progress:
    """Progress of a batch."""

    #: Number of cases finished in an earlier run.
    found: int
    #: Cases by status: ``done``, ``failed``, ``broken``, including those found.
    counts: dict[str, int]
    #: From worker to its current case.
    working: dict[str, str]
    #: Number of workers.
    workers: int


@dataclass(frozen=True)
class Finished:
    """Result of a batch."""

    #: As in ``summary.csv`` and ``summary.parquet``.
    summary: pd.DataFrame
    #: Numbers of cases finished earlier and in this run.
    found: int
    ran: int
    #: Whether the batch was stopped early.
    stopped: bool


def run_batch(
    study: Study,
    folder: Path,
    recruit: Callable[[], AbstractContextManager[Crew]],
    *,
    watch: Callable[[Progress], None] = lambda progress: None,
    tell: Callable[[StudyCase, str], None] = lambda case, text: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Finished:
    """Run all unfinished cases of a study.

    Parameters
    ----------
    study : Study
        Study to run.
    folder : Path
        Folder of the results (`fesim.batch.folder`).
    recruit : callable
        Returns the workers, e.g. ``lambda: local_crew(2)``; not called if there is nothing to run.
    watch : callable
        Called regularly with the progress.
    tell : callable
        Called with a case and one line for each failure, lost worker and damaged response.
    stopped : callable
        Returns True once no further case is to start; running ones are finished.

    Raises
    ------
    InputError
        Another batch writes into the folder, or the workers cannot be reached or do not survive
        their first cases.
    """
    with on_disk.locked(folder), _named(folder):
        keeper = _Keeper(study, folder)
        for damaged in keeper.damaged:
            tell(damaged, "its response in the folder is damaged; it runs again")
        kept = len(keeper.records)
        left = [case for case in study.cases if case.id not in keeper.records]
        try:
            if left:
                with recruit() as crew:
                    _work_off(left, crew, keeper, watch, tell, stopped)
        finally:
            table = keeper.write_tables()
    missing = len(study.cases) - len(keeper.records)
    return Finished(table, kept, len(keeper.records) - kept, missing > 0)


@contextmanager
def _named(folder: Path) -> Iterator[None]:
    """Add the folder to an error of the disk without a file name, such as those of Zarr."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(folder)
        raise


class _Keeper:
    """Writer of dataset, records and tables of a study."""

    def __init__(self, study: Study, folder: Path) -> None:
        self.study, self.folder = study, folder
        #: Records of the cases that need not run again, by id.
        self.records = on_disk.read_records(folder, study)
        #: Cases whose responses in the folder are unreadable, which run again.
        self.damaged: list[StudyCase] = []
        self._dataset = collected.open_dataset(folder / "dataset.zarr", study)
        self._due = monotonic() + TABLE_INTERVAL
        # A write to the store takes as long for one case as for all.
        self._unsaved: dict[str, str] = {}
        self._recover()

    def _recover(self) -> None:
        """Make records and dataset consistent with the responses, after a kill or another study."""
        stored, now = collected.stored_status(self._dataset), dict[str, str]()
        for case in self.study.cases:
            path = on_disk.response_path(self.folder, case.id)
            unrecorded = case.id not in self.records and path.is_file()
            lost = self._status(case) == "done" and stored[case.id] != "done"
            if lost and not path.is_file():
                # Only its displacement was stored. Unless the dataset has been recreated, it is
                # there, and the process was killed before the status was written.
                if not collected.holds_response(self._dataset, case.id):
                    del self.records[case.id]
            elif unrecorded or lost:
                self._take_in(case, path)
            if self._status(case) != stored[case.id]:
                now[case.id] = self._status(case)
        collected.store_status(self._dataset, now)

    def _status(self, case: StudyCase) -> str:
        return str(self.records[case.id]["status"]) if case.id in self.records else "pending"

    def _take_in(self, case: StudyCase, path: Path) -> None:
        """Store a response from the folder in the dataset, and create its record if missing."""
        try:
            response = read_response(path)
        except InputError:
            self.damaged.append(case)
            self.records.pop(case.id, None)
            return
        if case.id in self.records:
            collected.store_response(self._dataset, case.id, response)
        else:
            figures = figures_of(response)
            self.keep(Outcome(case.id, "done", figures=figures, response=response))

    def keep(self, outcome: Outcome) -> None:
        """Write an outcome; the record comes last and marks it as finished."""
        if outcome.encoded:
            on_disk.write_response_bytes(self.folder, outcome)
        if outcome.response is not None:
            collected.store_response(self._dataset, outcome.id, outcome.response)
        self._unsaved[outcome.id] = outcome.status
        self.records[outcome.id] = on_disk.write_record(self.folder, outcome)
        if monotonic() > self._due:
            self.write_tables()

    def write_tables(self) -> pd.DataFrame:
        """Write the current summary, and the status of cases missing in the dataset."""
        begun = monotonic()
        collected.store_status(self._dataset, self._unsaved)
        self._unsaved.clear()
        table = on_disk.summary(self.study, self.records)
        on_disk.write_summary(self.folder, table)
        ended = monotonic()
        self._due = ended + max(TABLE_INTERVAL, TABLE_SHARE * (ended - begun))
        return table


@dataclass
class _Losses:
    """Workers that were lost with a case, and whether any has come back with one."""

    cases: Counter[str] = field(default_factory=Counter)
    returned: bool = False

    def outcome_of(self, report: Report, members: int) -> Outcome | None:
        """Return the outcome of a report, or None if its worker is lost and the case starts again.

        Raises
        ------
        InputError
            One worker after the other is lost and none has come back; `members` are at work.
        """
        if report.outcome is not None:
            self.returned = True
            return report.outcome
        case = report.task.id
        self.cases[case] += 1
        if not self.returned and self.cases.total() >= MOST_LOSSES * (1 + members):
            raise InputError(
                f"batch: {self.cases.total()} workers are lost ({report.detail}) and none has come "
                "back with a case; simulate one of the cases alone to see why"
            )
        if self.cases[case] < MOST_LOSSES:
            return None
        return Outcome(case, "broken", f"lost {MOST_LOSSES} workers: {report.detail}")


def _work_off(
    left: list[StudyCase],
    crew: Crew,
    keeper: _Keeper,
    watch: Callable[[Progress], None],
    tell: Callable[[StudyCase, str], None],
    stopped: Callable[[], bool],
) -> None:
    cases = {case.id: case for case in left}
    queue = Queue(
        Task(case.id, case.key, case.case.model_dump_json(), keeper.study.keep) for case in left
    )
    working: dict[str, Task] = {}
    losses, warned = _Losses(), set[str]()
    kept = len(keeper.records)
    counts = Counter(str(record["status"]) for record in keeper.records.values())

    def hand_out() -> int:
        members = crew.members()
        queue.keep(members)
        if not stopped():
            for worker in crew.idle():
                task = queue.next_for(worker)
                if task is not None:
                    on_disk.note(keeper.folder, "started", task.id, worker)
                    crew.hand(worker, task)
                    working[worker] = task
        return len(members)

    def show(workers: int) -> None:
        at_work = {worker: task.id for worker, task in working.items()}
        watch(Progress(kept, dict(counts), at_work, workers))

    def settle(report: Report) -> None:
        case, worker = report.task.id, report.worker
        if report.outcome is None:
            on_disk.note(keeper.folder, "lost", case, worker, report.detail)
        outcome = losses.outcome_of(report, len(crew.members()))
        if outcome is None:
            tell(cases[case], f"{worker} is lost ({report.detail}); the case starts again")
            queue.give_back(report.task)
            return
        keeper.keep(outcome)
        counts[outcome.status] += 1
        on_disk.note(keeper.folder, outcome.status, case, worker, outcome.reason)
        if outcome.status != "done":
            tell(cases[case], outcome.reason)
        for line in set(outcome.warnings) - warned:
            tell(cases[case], f"warning: {line}")
        warned.update(outcome.warnings)

    show(hand_out())
    while working or (len(queue) and not stopped()):
        reports = crew.gather(TICK)
        for report in reports:
            del working[report.worker]
            if report.outcome is not None:
                queue.learn(report.task, report.outcome)
        for report in reports:
            if report.outcome is None:
                settle(report)
        # Before the outcomes are written, so that no worker waits for the disk.
        workers = hand_out()
        for report in reports:
            if report.outcome is not None:
                settle(report)
        show(workers)
