"""Child processes: fresh interpreters that end with their parent and ignore Ctrl-C themselves.

Fresh, because forking a process with threads and a loaded MKL is not safe.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, parent_process, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from threading import Thread

from threadpoolctl import threadpool_limits

from thermojoint.artefacts.process_start import prepare_process
from thermojoint.artefacts.unfinished import cleared_at_stop


class _Child(SpawnProcess):
    """A process that does not receive Ctrl-C.

    A terminal sends it to every process, and the main process handles it. A child inherits the
    blocked signals, so even its start is not disturbed.
    """

    def start(self) -> None:
        _start_tracker()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_tracker() -> None:
    """Start Python's tracker of shared resources, without its warnings after a stop.

    If it were started with the first child, it would unblock the signals again.
    """
    before = os.environ.get("PYTHONWARNINGS", "")
    os.environ["PYTHONWARNINGS"] = f"{before},ignore:resource_tracker".lstrip(",")
    try:
        resource_tracker.ensure_running()
    finally:
        os.environ["PYTHONWARNINGS"] = before


class _Context(SpawnContext):
    Process = _Child


CONTEXT = _Context()


@contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of `count` processes, which are killed if the main process is stopped."""
    _start_tracker()
    given = count, CONTEXT, begin_child, (threads_of(count),)
    with cleared_at_stop(_kill_children), ProcessPoolExecutor(*given) as pool:
        yield pool


def threads_of(count: int) -> int:
    """Threads of the linear algebra in each of `count` processes that work side by side."""
    return max(1, (os.cpu_count() or 1) // count)


def begin_child(threads: int) -> None:
    """Begin a child process, which loads no unused modules and ends as soon as its parent has.

    Its linear algebra uses `threads`, unless ``OMP_NUM_THREADS`` is set.
    """
    prepare_process()
    if "OMP_NUM_THREADS" not in os.environ:
        # For libraries not loaded yet, and for loaded ones.
        os.environ["OMP_NUM_THREADS"] = str(threads)
        threadpool_limits(limits=threads)

    def watch() -> None:
        if (parent := parent_process()) is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()


def _kill_children() -> None:
    children = active_children()
    for child in children:
        child.kill()
    for child in children:
        child.join()
