"""Who does the work: the one interface of local processes and of a Dask cluster."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fesim.batch.worker import Outcome, Task


@dataclass(frozen=True)
class Report:
    """What a worker has to say about its case.

    Attributes
    ----------
    worker : str
        Its name.
    task : Task
        Its case.
    outcome : Outcome or None
        None if the worker is gone, and the case with it.
    detail : str
        How the worker ended, or why its program failed.
    """

    worker: str
    task: Task
    outcome: Outcome | None
    detail: str = ""


class Crew(Protocol):
    """Workers, each with one case at a time; the name of a lost one does not come back."""

    def idle(self) -> list[str]:
        """Workers without a case, as of now; new ones may have come and old ones gone."""

    def hand(self, worker: str, task: Task) -> None:
        """Give an idle worker a case."""

    def gather(self, timeout: float) -> list[Report]:
        """Wait for reports, `timeout` seconds at most."""

    def members(self) -> list[str]:
        """Every worker, as of now."""
