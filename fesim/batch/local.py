"""Local workers: one process each, with its own pipe.

Not `concurrent.futures.ProcessPoolExecutor`: there, one killed process breaks the whole pool, and a
case cannot be assigned to the worker with its condensation. Here a process that dies loses only its
own case and is replaced.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from fesim.batch.crew import Report
from fesim.batch.worker import Outcome, Task, run
from thermojoint.artefacts.processes import CONTEXT, begin_child, threads_of

#: Time for a worker to end on request, s.
_PATIENCE = 5.0


@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection
    task: Task | None = None


class LocalCrew:
    """A fixed number of processes; dead ones are replaced; see `fesim.batch.crew.Crew`."""

    def __init__(self, count: int) -> None:
        self._threads = threads_of(count)
        self._workers: dict[str, _Worker] = {}
        for _ in range(count):
            self._recruit()

    def members(self) -> list[str]:
        """Every worker: ``process`` and its process id."""
        return list(self._workers)

    def idle(self) -> list[str]:
        """Workers without a case."""
        return [name for name, worker in self._workers.items() if worker.task is None]

    def hand(self, worker: str, task: Task) -> None:
        """Give an idle worker a case; if it is already dead, `gather` reports it."""
        chosen = self._workers[worker]
        chosen.task = task
        try:
            chosen.pipe.send(task)
        except OSError:
            chosen.process.kill()

    def gather(self, timeout: float) -> list[Report]:
        """Wait for outcomes and lost workers, `timeout` seconds at most."""
        ends = [
            end
            for worker in self._workers.values()
            for end in (worker.pipe, worker.process.sentinel)
        ]
        ready = set(wait(ends, timeout))
        reports = []
        for name, worker in list(self._workers.items()):
            if worker.pipe not in ready and worker.process.sentinel not in ready:
                continue
            outcome = _receive(worker.pipe)
            task, worker.task = worker.task, None
            if outcome is None:
                self._replace(name)
            if task is not None:
                reports.append(Report(name, task, outcome, "" if outcome else _ending(worker)))
        return reports

    def close(self) -> None:
        """End every process, even if it is busy."""
        for worker in self._workers.values():
            worker.process.terminate()
        for worker in self._workers.values():
            worker.process.join(_PATIENCE)
            worker.process.kill()
            worker.process.join()
            worker.pipe.close()
        self._workers.clear()

    def _replace(self, name: str) -> None:
        worker = self._workers.pop(name)
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        self._recruit()

    def _recruit(self) -> None:
        ours, theirs = CONTEXT.Pipe()
        process = CONTEXT.Process(target=_serve, args=(theirs, self._threads), daemon=True)
        process.start()
        theirs.close()
        self._workers[f"process {process.pid}"] = _Worker(process, ours)


@contextmanager
def local_crew(count: int) -> Iterator[LocalCrew]:
    """Provide `count` worker processes, which end with the block."""
    crew = LocalCrew(count)
    try:
        yield crew
    finally:
        crew.close()


def _receive(pipe: Connection) -> Outcome | None:
    """Return a worker's message, or None if it died, even during transmission."""
    try:
        if pipe.poll():
            outcome: Outcome = pipe.recv()
            return outcome
    except (EOFError, OSError):
        pass
    return None


def _ending(worker: _Worker) -> str:
    code = worker.process.exitcode
    if code is not None and code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"exit code {code}"


def _serve(pipe: Connection, threads: int) -> None:
    """Main loop of a worker process: run cases until the other end of the pipe is closed."""
    begin_child(threads)
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        pipe.send(run(task))
