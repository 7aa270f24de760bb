"""Arguments of the command line: files, standard streams, LEVEL=FILE pairs."""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import whole_file
from thermojoint.artefacts.folders import check_place, check_replaceable
from thermojoint.cli.file_kinds import Kind

if TYPE_CHECKING:
    from estimator import kind as estimators

#: Options for the workers of a batch.
Workers = Annotated[
    int | None, typer.Option(help="Processes on this machine; default: one for each core.")
]
Scheduler = Annotated[
    str | None, typer.Option(help="Use this Dask cluster instead, e.g. tcp://10.0.0.1:8786.")
]
#: The common option for results as JSON.
Json = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Results as JSON; '-' prints them, and nothing else, on standard output.",
        allow_dash=True,
    ),
]


def shown(path: Path) -> str:
    """Return the name of an input for an error message."""
    return "standard input" if str(path) == "-" else str(path)


def check_outputs(
    outputs: Mapping[str, tuple[Path | None, Kind]], inputs: Iterable[Path | None] = ()
) -> None:
    """Refuse, before any work, an output that cannot be written or would destroy another file.

    Parameters
    ----------
    outputs : mapping
        Option to the file, None or ``-`` for no file, and its kind.
    inputs : iterable of Path or None
        Files that the command reads, including those named in its case.

    Raises
    ------
    InputError
        An output is a folder or cannot be written, is an input (by whatever name or link) or
        another output, exists and is of another kind, or has the suffix of another kind.
    """
    taken = [("an input", path) for path in inputs if path is not None and str(path) != "-"]
    for option, (path, kind) in outputs.items():
        if path is None or (str(path) == "-" and (option == "--json" or kind.printed)):
            continue
        if str(path) == "-":
            raise InputError(f"{option} -: {kind.name} is not printed; give a file name")
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give a file name")
        check_place(path, path.absolute().parent)
        for what, other in taken:
            if _same(path, other):
                raise InputError(f"{option} {path}: is {what} of this command; give another name")
        taken.append(("another output", path))
        if path.exists() and not (
            path.is_file() and (path.stat().st_size == 0 or kind.holds(path))
        ):
            raise InputError(
                f"{option} {path}: exists and is not {kind.name}; give another name, or remove it"
            )
        if kind.suffix and path.suffix and path.suffix.lower() != kind.suffix:
            better = path.with_suffix(kind.suffix).name
            raise InputError(f"{option} {path}: {kind.name} is written; name it {better}")


def check_whole_folder(path: Path) -> None:
    """Refuse, before any work, a folder that cannot or must not be replaced as a whole."""
    check_replaceable(path)
    check_place(path, path.resolve().parent)


def _same(path: Path, other: Path) -> bool:
    """Whether two names are, or would be, the same file, also by links."""
    if path.exists() and other.exists():
        return path.samefile(other)
    return path.resolve() == other.resolve()


def positive(option: str, value: float) -> float:
    """Return the value of an option that must be a positive finite number."""
    if not 0.0 < value < math.inf:
        raise InputError(f"{option} {value:g}: give a positive number")
    return value


def level_and_file(text: str) -> tuple[float, Path]:
    """Split ``0.5=r05.nc`` into the heat input, finite, and the file."""
    level, _, name = text.partition("=")
    if name:
        with suppress(ValueError):
            if math.isfinite(float(level)):
                return float(level), Path(name)
    raise InputError(f"--input {text}: write LEVEL=RESPONSE, e.g. 0.5=step-0.5.nc")


def distances(text: str) -> list[list[float]]:
    """Split ``r11,r12,r21,r22`` (mm) into r_ij, m: row i from source i, column j to sensor T_j."""
    with suppress(ValueError):
        values = [1e-3 * float(part) for part in text.split(",")]
        count = math.isqrt(len(values))
        if len(values) == count**2 and all(0.0 < value < math.inf for value in values):
            return [values[count * i : count * (i + 1)] for i in range(count)]
    raise InputError(
        f"--distances-mm {text}: give n x n positive numbers for n sources, r11,r12,r21,r22 for "
        "two: from source i to sensor Tj"
    )


@contextmanager
def opened(path: Path) -> Iterator[Iterable[str] | None]:
    """Open a table, or standard input for ``-``; None for a response."""
    from thermojoint.artefacts.tables.source import OR_CP1252, encoding_of, lines_of

    if str(path) == "-":
        if isinstance(sys.stdin, io.TextIOWrapper):
            peek = getattr(sys.stdin.buffer, "peek", None)
            encoding = encoding_of(peek(4)[:4]) if peek else "utf-8-sig"
            sys.stdin.reconfigure(encoding=encoding, errors=OR_CP1252)
        yield sys.stdin
    elif path.suffix == ".nc":
        yield None
    else:
        with lines_of(path, "table of temperatures, or a response (.nc),") as lines:
            yield lines


@contextmanager
def at_work(task: str, *streams: Path) -> Iterator[None]:
    """Show progress during the block, unless it reads or writes a standard stream."""
    from thermojoint import console

    with nullcontext() if any(str(path) == "-" for path in streams) else console.working(task):
        yield


@contextmanager
def output(path: Path) -> Iterator[TextIO]:
    """Write a file whole or not at all, or to standard output for ``-``."""
    if str(path) == "-":
        try:
            yield sys.stdout
            sys.stdout.flush()
        except OSError as error:
            error.filename = error.filename or "standard output"
            raise
        return
    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        yield file


def write_json(path: Path | None, content: object) -> None:
    """Write the results of --json to a file, or to standard output for ``-``; nothing for None."""
    if path is not None:
        with output(path) as file:
            file.write(json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def only_for(what: str, given: Mapping[str, object]) -> None:
    """Refuse given options (neither None nor False), which only apply to `what`."""
    for option, value in given.items():
        if value is not None and value is not False:
            raise InputError(f"{option}: goes with {what}; leave it out")


def check_taken(what: str, given: Mapping[str, tuple[object, bool]]) -> None:
    """Refuse given options, (value, whether it applies), that do not apply to a kind of model."""
    for option, (value, taken) in given.items():
        if value is not None and value is not False and not taken:
            raise InputError(f"{option}: not for {what}; leave it out")


def check_pace(
    kind: estimators.Kind[Any, Any],
    model: Any,  # noqa: ANN401
    given: Mapping[str, object],
) -> None:
    """Refuse options of the assembly for a model that is already assembled or never needs to be."""
    assembled = kind.assembled(model)
    what = "an assembled estimator" if assembled else kind.name
    taken = {
        "--interval-s": kind.paced and not assembled,
        "--run-length-min": kind.assembled_for is not None and not assembled,
    }
    check_taken(what, {option: (value, taken[option]) for option, value in given.items()})


def check_same_pace(
    kind: estimators.Kind[Any, Any],
    estimator: estimators.OpenedEstimator,
    interval: float | None,
    run_length: float | None,
) -> None:
    """Refuse an interval (s) or a run length (min) other than those of the continued run."""
    if kind.assembled_for is None:
        return
    own_interval, own_length = kind.assembled_for(estimator)
    for option, given, own in (
        ("--interval-s", interval, own_interval),
        ("--run-length-min", run_length, own_length / 60.0),
    ):
        if given is not None and not math.isclose(given, own):
            raise InputError(f"{option} {given:g}: the run was begun with {own:g}; leave it out")


def reading_noise(given_um: float | None, readings: Path | None) -> float | None:
    """Return the standard deviation of a displacement reading, m; None if it was not given.

    Raises
    ------
    InputError
        The value is not positive, or there are no readings.
    """
    if given_um is None:
        return None
    if readings is None:
        raise InputError("--reading-noise-um: goes with --readings; leave it out")
    return 1e-6 * positive("--reading-noise-um", given_um)
