"""One case in a worker process: what goes in, what comes out, and the set-ups kept in memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from time import perf_counter
from typing import Literal

import numpy as np
import xarray as xr

from artefacts.errors import ConvergenceError, InputError
from artefacts.response import write_response
from fesim.batch.summary import Figures, figures_of
from fesim.case import Case
from fesim.setup import Setup, set_up, with_laws
from fesim.simulate import simulate

#: Set-ups that a worker keeps. Two: the one in use, and one to come back to.
KEPT = 2

#: What a case may fail of. The first ones follow from the case: repeating it changes nothing.
LASTING = (InputError, ConvergenceError, ArithmeticError, np.linalg.LinAlgError)
PASSING = (MemoryError, OSError)

#: A process works on one case at a time, however many threads a Dask worker has: the direct
#: solver's factors are not to be used by two.
_ONE_AT_A_TIME = Lock()


@dataclass(frozen=True)
class Task:
    """A case on its way to a worker.

    Attributes
    ----------
    id, key : str
        Its identity and its condensation's (`fesim.sharing`).
    case : str
        The case as JSON.
    """

    id: str
    key: str
    case: str


@dataclass(frozen=True)
class Outcome:
    """What became of a case.

    Attributes
    ----------
    id : str
        Of the case.
    status : str
        ``"done"``, or ``"failed"`` if running it again would fail again, or ``"broken"`` if it
        might not: out of memory, a lost worker.
    reason : str
        One line; empty if it is done.
    seconds, setup_seconds : float
        For the march with all around it, and for the condensation (0 if it was at hand), s.
    figures : dict
        See `fesim.batch.summary`.
    response : xarray.Dataset or None
        What the case did.
    encoded : bytes
        The response as a NetCDF file.
    """

    id: str
    status: Literal["done", "failed", "broken"]
    reason: str = ""
    seconds: float = 0.0
    setup_seconds: float = 0.0
    figures: Figures = field(default_factory=dict)
    response: xr.Dataset | None = None
    encoded: bytes = b""


@dataclass(frozen=True)
class _Shared:
    """A case that stands for all that share its condensation: compared by the key alone."""

    key: str
    case: Case = field(compare=False)


def run(task: Task) -> Outcome:
    """Run one case; what may go wrong with a case comes back as its outcome."""
    begun = perf_counter()
    ready = begun
    try:
        with _ONE_AT_A_TIME, np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            case = Case.model_validate_json(task.case)
            setup = with_laws(_condensed(_Shared(task.key, case)), case)
            ready = perf_counter()
            response = simulate(case, setup=setup).response
    except LASTING as error:
        return Outcome(task.id, "failed", _line(error), perf_counter() - ready, ready - begun)
    except PASSING as error:
        return Outcome(task.id, "broken", _line(error), perf_counter() - ready, ready - begun)
    encoded = _encode(response)
    return Outcome(
        id=task.id,
        status="done",
        seconds=perf_counter() - ready,
        setup_seconds=ready - begun,
        figures=figures_of(response),
        response=response,
        encoded=encoded,
    )


@lru_cache(maxsize=KEPT)
def _condensed(shared: _Shared) -> Setup:
    """The one place where a batch condenses; a Setup never changes, so it may be kept."""
    return set_up(shared.case)


def _line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    expected = isinstance(error, InputError | ConvergenceError)
    return text if expected else f"{type(error).__name__}: {text}"


def _encode(response: xr.Dataset) -> bytes:
    """Encode here, so that the main process only has to write the bytes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "response.nc"
        write_response(response, path)
        return path.read_bytes()
