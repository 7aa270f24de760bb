"""Common interface of worker pools: local processes and Dask clusters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fesim.batch.worker import Outcome, Task


@dataclass(frozen=True)
class Report:
    """Report of a worker on its case."""

    #: Name of the worker.
    worker: str
    #: Case of the worker.
    task: Task
    #: Outcome; None if the worker and its case were lost.
    outcome: Outcome | None
    #: Exit code or signal of the worker, or error of its program.
    detail: str = ""


class Crew(Protocol):
    """Workers with one case each at a time; names of lost workers are not reused."""

    def idle(self) -> list[str]:
        """Currently idle workers; others may have joined or left."""

    def hand(self, worker: str, task: Task) -> None:
        """Give an idle worker a case."""

    def gather(self, timeout: float) -> list[Report]:
        """Wait for reports, `timeout` seconds at most."""

    def members(self) -> list[str]:
        """All current workers."""
