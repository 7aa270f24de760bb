"""Workers of an existing Dask cluster.

Only cases and responses are transferred: the cluster needs no access to the batch's folder, but it
must find the files of a case (meshes, histories) under the same absolute paths.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from itertools import count
from threading import Event

from fesim.batch.crew import Report
from fesim.batch.worker import Outcome, Task, run
from thermojoint.artefacts.errors import InputError

try:
    from distributed import Client, Future
    from distributed.scheduler import KilledWorker
except ImportError as _error:
    raise InputError(
        "--scheduler: Dask is not installed; install thermojoint with its extra 'dask'"
    ) from _error

#: A scheduler that does not respond within this time, s, counts as absent.
CONNECT_TIMEOUT = 10.0
#: After this time, s, a missing response is requested again, or its worker counts as lost.
FETCH_TIMEOUT = 60.0

OWN_VERSION = version("thermojoint")


class DaskCrew:
    """Workers of a cluster, which may join and leave; see `fesim.batch.crew.Crew`.

    A worker with another version at the start ends the batch; one that joins later is reported once
    and gets no cases.
    """

    def __init__(self, client: Client, tell: Callable[[str], None]) -> None:
        self._client = client
        self._report = tell
        self._versions: dict[str, str] = {}
        self._looked = False
        self._working: dict[str, tuple[Task, Future]] = {}
        self._number = count()
        self._news = Event()

    def members(self) -> list[str]:
        """Every worker of this version, by its address."""
        try:
            addresses = list(self._client.nthreads())
        except (OSError, TimeoutError, RuntimeError) as error:
            raise InputError(
                "--scheduler: the connection is lost; start the batch again to continue"
            ) from error
        for address in addresses:
            if address not in self._versions:
                self._meet(address)
        self._looked = True
        return [address for address in addresses if self._versions.get(address) == OWN_VERSION]

    def idle(self) -> list[str]:
        """Workers without a case."""
        return [address for address in self.members() if address not in self._working]

    def hand(self, worker: str, task: Task) -> None:
        """Give an idle worker a case."""
        # Pinned, for the worker's condensation; and unique, or Dask would return a known result.
        future = self._client.submit(
            run,
            task,
            key=f"thermojoint-{task.id}-{next(self._number)}",
            workers=[worker],
            allow_other_workers=False,
            pure=False,
        )
        future.add_done_callback(lambda _: self._news.set())
        self._working[worker] = task, future

    def gather(self, timeout: float) -> list[Report]:
        """Wait for outcomes, `timeout` seconds at most, and check which workers are lost."""
        self._news.wait(timeout)
        self._news.clear()
        here = set(self.members())
        reports = []
        for worker, (task, future) in list(self._working.items()):
            status = future.status
            outcome = _fetch(future) if status == "finished" else None
            if outcome is not None:
                reports.append(Report(worker, task, outcome))
            elif status in ("error", "cancelled", "lost"):
                reports.append(Report(worker, task, None, _why(future)))
            elif worker not in here:
                future.cancel()
                reports.append(Report(worker, task, None, "the worker left the cluster"))
            else:
                continue
            del self._working[worker]
        return reports

    def close(self) -> None:
        """Cancel running cases."""
        for _, future in self._working.values():
            future.cancel()
        self._working.clear()

    def _meet(self, address: str) -> None:
        """Ask a new worker for its version."""
        try:
            theirs = self._client.run(version, "thermojoint", workers=[address])[address]
        except PackageNotFoundError:
            theirs = "not installed"
        except OSError:
            return  # It has probably left; otherwise it is asked again.
        self._versions[address] = theirs
        if theirs == OWN_VERSION:
            return
        text = (
            f"--scheduler: worker {address} has thermojoint {theirs}, here it is {OWN_VERSION}; "
            "install the same version there"
        )
        if not self._looked:
            raise InputError(text)
        self._report(f"{text}; it gets no cases")


@contextmanager
def dask_crew(
    address: str,
    tell: Callable[[str], None] = lambda text: None,
    timeout: float = CONNECT_TIMEOUT,
) -> Iterator[DaskCrew]:
    """Provide the workers of the cluster at `address`, e.g. ``tcp://10.0.0.1:8786``.

    Parameters
    ----------
    address : str
        Address of the scheduler.
    tell : callable
        Called with one line for each worker with another version that joins later.
    timeout : float, optional
        Time for the scheduler to respond, s.

    Raises
    ------
    InputError
        The scheduler does not respond, or the cluster has another version of this program.
    """
    # To report a lost connection in one line instead of three tracebacks.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: no Dask scheduler responds there") from error
    with client:
        crew = DaskCrew(client, tell)
        try:
            yield crew
        finally:
            crew.close()


def _fetch(future: Future) -> Outcome | None:
    """Return the outcome of a finished case, or None if its worker was lost before sending it."""
    try:
        outcome: Outcome = future.result(timeout=FETCH_TIMEOUT)
    except (TimeoutError, CancelledError, KilledWorker, OSError):
        return None
    return outcome


def _why(future: Future) -> str:
    error = future.exception() if future.status == "error" else None
    if error is None:
        return f"Dask: {future.status}"
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
