"""Recovery of a store that is damaged, replaced or deleted while a service runs, in a new file.

The estimators and the values received last by the controls are in memory; the rest of the file is
set aside. A file that was only deleted or replaced is still complete behind its open handle, and is
copied.
"""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.live import processing
from thermojoint.live.disk_reserve import preallocate
from thermojoint.live.running import Running
from thermojoint.live.store import Batch, commit, identity_of, layout_text, open_store

#: Error codes of an unusable file; all others (no space, a lock) are temporary.
_DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)
#: An era as a row of the store: number, machine, model, layout, begin.
Era = tuple[int, str, str, str, float]


def is_damage(error: sqlite3.Error) -> bool:
    """Return whether an error of the store persists until the file is replaced."""
    closed = isinstance(error, sqlite3.ProgrammingError)
    return closed or getattr(error, "sqlite_errorcode", 0) & 0xFF in _DAMAGE


async def recover_if_replaced(running: Running) -> None:
    """Continue in a copy if the store was deleted or replaced.

    Raises
    ------
    sqlite3.OperationalError
        There is no space for the copy; another call tries again.
    """
    present = identity_of(running.archive.path)
    running.identity = running.identity or present
    if present != running.identity:
        why = "was deleted or replaced; its content is in a new one"
        await asyncio.shield(_replace_store(running, running.store, why, running.store))


async def recover(running: Running, failed: sqlite3.Connection, error: sqlite3.Error) -> None:
    """Continue in a new store after one has failed; its history is in the file set aside.

    Raises
    ------
    sqlite3.OperationalError
        There is no space for the new store; another call tries again.
    """
    why = f"is damaged ({error}); a new one begins with the states of now"
    await asyncio.shield(_replace_store(running, failed, why, None))


async def _replace_store(
    running: Running, failed: sqlite3.Connection, why: str, source: sqlite3.Connection | None
) -> None:
    """Continue in a new store; shielded, so that it is completed if the service ends meanwhile."""
    async with running.recovery_lock:
        if running.store is not failed:
            return
        machines, path, now = running.fleet.machines.values(), running.archive.path, time.time()
        rows = [machine.rows for machine in machines]
        batch = Batch(
            checkpoints=[processing.checkpoint_of(one, source is None) for one in machines],
            received=processing.received_offsets(running.fleet, running.fleet.machines, now),
        )
        eras: list[Era] = [
            (machine.era, name, machine.model.digest, layout_text(machine.model.layout), now)
            for name, machine in running.fleet.machines.items()
        ]
        aside = path.with_name(f"{path.stem}.{round(now)}{path.suffix}")
        running.fleet.log.say(now, "store-recovered", f"{path} {why}; what is left of it: {aside}")
        try:
            # In one call: a commit between the two steps would be in neither store.
            await running.run_on_store(
                lambda store: _swap(store, _write(path, source, eras, batch), path, aside)
            )
            running.store = open_store(path, running.service.given.store.durable)
            preallocate(running.store, path)
        except (sqlite3.Error, OSError, InputError) as error:
            for machine, earlier in zip(machines, rows, strict=True):
                machine.rows = earlier + machine.rows
            raise sqlite3.OperationalError(f"no new store: {error}") from error
        running.identity = identity_of(path)
        running.journal_end = running.round_start = running.checkpointed_until = 0
        running.pending = []


def _write(
    path: Path, source: sqlite3.Connection | None, eras: Sequence[Era], batch: Batch
) -> Path:
    """Write a new store beside the existing one."""
    new_path = path.with_name(f"{path.name}.new")
    for suffix in ("", "-wal", "-shm"):
        new_path.with_name(new_path.name + suffix).unlink(missing_ok=True)
    if source is not None:
        with closing(sqlite3.connect(new_path)) as target:
            source.backup(target)
    with closing(open_store(new_path)) as target:
        target.executemany("INSERT OR IGNORE INTO eras VALUES (?, ?, ?, ?, ?)", eras)
        commit(target, batch)
    return new_path


def _swap(store: sqlite3.Connection, new_path: Path, path: Path, aside: Path) -> None:
    """Set a store aside and put the new one in its place."""
    # Closing deletes the log by its name, so it must come before the new store has that name.
    with suppress(sqlite3.Error):
        store.close()
    for suffix in ("", "-wal", "-shm"):
        file = path.with_name(path.name + suffix)
        if file.exists():
            file.replace(aside.with_name(aside.name + suffix))
    new_path.replace(path)
