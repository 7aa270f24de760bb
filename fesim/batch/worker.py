"""Execution of one case in a worker process: task, outcome, and set-ups kept in memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Literal
from warnings import catch_warnings, simplefilter

import numpy as np

from fesim.axes.setup import MovingSetup
from fesim.batch.study import Keep
from fesim.batch.summary import Figures, figures_of
from fesim.case.identity import case_id, file_digest, shared_key
from fesim.case.schema import Case
from fesim.setup.machine import Setup, with_laws
from fesim.simulate import prepared, simulate
from thermojoint.artefacts.errors import ConvergenceError, InputError, UnreadableError
from thermojoint.artefacts.response import response_bytes

if TYPE_CHECKING:
    from thermojoint.artefacts.response import AnyResponse

#: Number of set-ups that a worker keeps: the current and the previous one.
KEPT = 2

#: Temporary errors, after which a case may be repeated.
PASSING = (UnreadableError, MemoryError, OSError)
#: Errors caused by the case itself, for which repetition is useless.
LASTING = (InputError, ConvergenceError, ArithmeticError, np.linalg.LinAlgError)

#: A process runs one case at a time, even with several threads of a Dask worker: two threads must
#: not use the factors of the direct solver at once.
_ONE_AT_A_TIME = Lock()


@dataclass(frozen=True)
class Task:
    """A case to be sent to a worker."""

    #: Its id and the key of its set-up (`fesim.case.identity`).
    id: str
    key: str
    #: The case as JSON.
    case: str
    #: Result to return, as in `fesim.batch.study.Study`.
    keep: Keep = "response"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case."""

    #: Id of the case.
    id: str
    #: ``"done"``, ``"failed"`` if running it again would fail again, or ``"broken"`` if it might
    #: not: out of memory, a file that cannot be read or has changed, a lost worker.
    status: Literal["done", "failed", "broken"]
    #: One line; empty if it is done.
    reason: str = ""
    #: Time of the simulation without the condensation, and of the condensation (0 if cached), s.
    seconds: float = 0.0
    setup_seconds: float = 0.0
    #: See `fesim.batch.summary`.
    figures: Figures = field(default_factory=dict)
    #: Response of the case, as far as it is stored.
    response: AnyResponse | None = None
    #: The response as a NetCDF file; empty if only its displacement is stored.
    encoded: bytes = b""
    #: Warnings about its structure during its condensation.
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Shared:
    """A case representing all that share its condensation; compared by key only."""

    key: str
    case: Case = field(compare=False)


def run(task: Task) -> Outcome:
    """Run one case; return its errors as its outcome."""
    begun, condensing = perf_counter(), 0.0
    try:
        with _ONE_AT_A_TIME, np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            begun = perf_counter()
            case = Case.model_validate_json(task.case)
            with _files_as_read(task, case):
                with catch_warnings(record=True) as said:
                    simplefilter("always", UserWarning)
                    shared, condensing = _condensation(_Shared(task.key, case))
                own = with_laws(shared, case) if isinstance(shared, Setup) else shared
                response = simulate(case, setup=own, accuracy=False).arrays
        figures, encoded = figures_of(response), b""
        if task.keep == "displacement":
            response = response.only("displacement")
        else:
            encoded = response_bytes(response)
    except (*PASSING, *LASTING) as error:
        return Outcome(
            id=task.id,
            status="broken" if isinstance(error, PASSING) else "failed",
            reason=_line(error),
            seconds=perf_counter() - begun - condensing,
            setup_seconds=condensing,
        )
    return Outcome(
        id=task.id,
        status="done",
        seconds=perf_counter() - begun - condensing,
        setup_seconds=condensing,
        figures=figures,
        response=response,
        encoded=encoded,
        warnings=tuple(str(one.message) for one in said if one.category is UserWarning),
    )


@contextmanager
def _files_as_read(task: Task, case: Case) -> Iterator[None]:
    """Refuse a case whose files have changed since its id was computed, before or after its run.

    Otherwise a file edited in the meantime, or an older copy on another machine, would give a
    result under the id of other input.
    """
    files: list[Path] = []

    def digest(path: Path) -> str:
        files.append(path)
        return file_digest(path)

    _compare(case_id(case, digest), task.id)
    try:
        yield
    finally:
        # After an error, too: a file that is being written may be its cause.
        if files:
            _compare(case_id(case), task.id)


def _compare(present: str, expected: str) -> None:
    if present != expected:
        raise UnreadableError(
            "a file of the case is not the one that the study was read with; give every worker "
            "the same files and start the batch again"
        )


def _condensation(shared: _Shared) -> tuple[Setup | MovingSetup, float]:
    """Return a condensation and its computing time, s; 0 if it was in memory."""
    known, begun = _condensed.cache_info().misses, perf_counter()
    setup = _condensed(shared)
    made = _condensed.cache_info().misses > known
    return setup, perf_counter() - begun if made else 0.0


@lru_cache(maxsize=KEPT)
def _condensed(shared: _Shared) -> Setup | MovingSetup:
    """The only place where a batch condenses; set-ups are immutable and therefore cached."""
    setup = prepared(shared.case)
    # The mesh file may have changed: the set-up must be the one that the key identifies.
    _compare(shared_key(shared.case), shared.key)
    return setup


def _line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    expected = isinstance(error, InputError | ConvergenceError)
    return text if expected else f"{type(error).__name__}: {text}"
