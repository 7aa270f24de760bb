"""Results folder of a batch: lock, records of finished cases, summary tables.

docs/batch.md lists its content. Only the main process writes, every file atomically. The record of
a case is written last, so that its existence means that everything else is there. The lock of a
killed process is released.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

import pandas as pd

from fesim.batch.study import Study, plain
from fesim.batch.summary import COUNTS
from fesim.batch.worker import Outcome
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import whole_file, write_text
from thermojoint.artefacts.unfinished import cleared_at_stop

Record = dict[str, Any]

#: Temporary names of a killed process (`thermojoint.artefacts.files.whole_file`, and Zarr's). The
#: folder itself may contain files of others.
_UNFINISHED = (
    ".summary.????????.csv",
    ".summary.????????.parquet",
    "responses/.*.????????.nc",
    "records/.*.????????.json",
    "dataset.zarr/*.partial",
    "dataset.zarr/*/*.partial",
)
#: A dataset that had not replaced the one of another study, or the one that was replaced.
_UNFINISHED_DATASETS = (".dataset.zarr.new", ".dataset.zarr.new.old")

#: Files that a batch rewrites. The lock is created before any of them.
_REPLACED = ("dataset.zarr", "summary.csv", "summary.parquet")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder against other batches; it is created if missing.

    Raises
    ------
    InputError
        Another process has locked it, it is not a folder, or it contains tables that are not from
        a batch.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; give a folder")
    if not (folder / "lock").exists():
        for name in _REPLACED:
            if (folder / name).exists():
                raise InputError(f"{folder}: has a {name} of another origin; give a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("a+", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            raise InputError(
                f"{folder}: another batch writes here ({file.read().strip()}); wait for it, or "
                "give another folder"
            ) from error
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()
        _remove_unfinished(folder)
        with cleared_at_stop(partial(_remove_unfinished, folder)):
            yield


def _remove_unfinished(folder: Path) -> None:
    for pattern in _UNFINISHED:
        for left in folder.glob(pattern):
            left.unlink()
    for name in _UNFINISHED_DATASETS:
        rmtree(folder / name, ignore_errors=True)


def response_path(folder: Path, case: str) -> Path:
    """Return the path of the response of a case."""
    return folder / "responses" / f"{case}.nc"


def write_record(folder: Path, outcome: Outcome) -> Record:
    """Write and return the record of a case, whose response must already be written."""
    record = {
        "id": outcome.id,
        "status": outcome.status,
        "reason": outcome.reason,
        **outcome.figures,
        "seconds": outcome.seconds,
        "setup_seconds": outcome.setup_seconds,
    }
    write_text(folder / "records" / f"{outcome.id}.json", json.dumps(record) + "\n")
    return record


def read_records(folder: Path, study: Study) -> dict[str, Record]:
    """Return the records of the study's cases that need not run again, by case id.

    Cases that stopped for a temporary reason and damaged records are left out.
    """
    records = {}
    for case in study.cases:
        path = folder / "records" / f"{case.id}.json"
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
            status, _ = record["status"], record["reason"]
        except (OSError, ValueError, TypeError, LookupError):
            continue
        kept = study.keep == "displacement" or response_path(folder, case.id).is_file()
        finished = status == "done" and kept
        if finished or status == "failed":
            records[case.id] = record
    return records


def write_response_bytes(folder: Path, outcome: Outcome) -> None:
    """Write a finished case's response, completely or not at all."""
    with whole_file(response_path(folder, outcome.id)) as part:
        part.write_bytes(outcome.encoded)


def note(folder: Path, event: str, case: str, worker: str, detail: str = "") -> None:
    """Add a line to the journal: ``started``, ``done``, ``failed``, ``broken`` or ``lost``."""
    line = {
        "time": datetime.now(UTC).isoformat(),
        "event": event,
        "case": case,
        "worker": worker,
        **({"detail": detail} if detail else {}),
    }
    with (folder / "journal.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def summary(study: Study, records: Mapping[str, Record]) -> pd.DataFrame:
    """Return a row for each case of the study: varied values, outcome, figures."""
    rows, numbers = [], [*study.columns, "seconds", "setup_seconds"]
    for case in study.cases:
        record = records.get(case.id, {"status": "pending", "reason": ""})
        values = {path: plain(case.values[path]) for path in study.paths}
        outcome = {"id": case.id, "status": record["status"], "reason": record["reason"]}
        rows.append(outcome | values | {name: record.get(name) for name in numbers})
    table = pd.DataFrame(rows)
    for path in study.paths:
        kinds = {type(value) for value in table[path]}
        if len(kinds) > 1 and not kinds <= {int, float}:
            table[path] = table[path].map(str)
    table[numbers] = table[numbers].astype(float)
    return table.astype(dict.fromkeys(COUNTS, "Int64"))


def write_summary(folder: Path, table: pd.DataFrame) -> None:
    """Write the summary as CSV and as Parquet, each completely or not at all."""
    with whole_file(folder / "summary.csv") as part:
        table.to_csv(part, index=False)
    with whole_file(folder / "summary.parquet") as part:
        table.to_parquet(part, index=False)
