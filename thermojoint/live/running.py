"""Running service: its machines restored from the store, and the storing thread."""

from __future__ import annotations

import asyncio
import json
import math
import sqlite3
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.live import processing
from thermojoint.live.access_store import NAME as ACCESS
from thermojoint.live.accounts import Accounts, accounts_of
from thermojoint.live.archive import Archive
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.disk_reserve import OVERHEAD, DiskSpace, adjust_reserve, close, preallocate
from thermojoint.live.loaded_models import LoadedModel, machine_models
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import (
    MachineState,
    Times,
    publication_of,
    rest_of,
    restore_state,
    state_bytes,
)
from thermojoint.live.metrics import Metrics, fresh_metrics
from thermojoint.live.processing import Fleet, Machine
from thermojoint.live.publication import Publication
from thermojoint.live.publisher import Publisher
from thermojoint.live.quality import REFUSED
from thermojoint.live.settings import Service
from thermojoint.live.store import (
    Batch,
    Checkpoint,
    StoredEra,
    commit,
    era_before,
    era_of,
    identity_of,
    last_received,
    locked,
    new_era,
    open_store,
    stored_eras,
)

#: Largest number of queued blocks of arrivals; beyond it the readers wait.
_MOST_BLOCKS = 2_000
#: Name of the store in a service's folder.
_STORE = "history.sqlite"
#: Number of samples searched for the last one with a reading.
_LOOKED_AT = 5_000

Result = TypeVar("Result")


@dataclass(eq=False)
class Running:
    """A running service."""

    #: The service as defined by its file.
    service: Service
    fleet: Fleet
    publisher: Publisher
    archive: Archive
    metrics: Metrics
    accounts: Accounts
    #: Used in `store_thread` only.
    store: sqlite3.Connection
    #: One thread, so that batches are stored in order.
    store_thread: ThreadPoolExecutor
    #: Queue of arrivals from the readers.
    arrivals: asyncio.Queue[list[Arrival | Note]]
    #: Set when the service is to end.
    stop: asyncio.Event
    #: Last entry of the store's journal.
    journal_end: int = 0
    #: Round of checkpoints: machines without one yet, the journal's end when the round began,
    #: and the fraction of a machine that is due.
    pending: list[Machine] = field(default_factory=list)
    round_start: int = 0
    due: float = 0.0
    #: Last entry of the journal that is covered by a checkpoint of every machine.
    checkpointed_until: int = 0
    #: Makes the service read its file again.
    reload: Callable[[], None] = lambda: None
    #: Identifies the store's file among others of its name.
    identity: tuple[int, ...] | None = None
    #: Held while a store is replaced.
    recovery_lock: asyncio.Lock = field(default_factory=asyncio.Lock)
    #: Space for the store, at the last check.
    disk_space: DiskSpace = field(default_factory=DiskSpace)

    async def run_on_store(self, work: Callable[..., Result], *arguments: object) -> Result:
        """Run a function on the store, after all earlier ones."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self.store_thread, work, self.store, *arguments)

    @property
    def reserve_h(self) -> float:
        """Time for which the store's reserve lasts, h."""
        return self.disk_space.reserve / self._per_hour

    @property
    def _per_hour(self) -> float:
        """Growth of the machines' store in an hour, bytes."""
        machines = self.fleet.machines.values()
        rows = sum(8.0 * one.model.layout.width / one.model.rule.interval for one in machines)
        return 3600.0 * OVERHEAD * rows

    async def maintain_reserve(self) -> None:
        """Adjust the store's reserve, and log when the disk becomes full or has room again.

        Raises
        ------
        sqlite3.DatabaseError
            The reserve is used up, or the store is damaged.
        """
        before, wanted = self.disk_space, self._per_hour * self.service.given.store.reserve_h
        self.disk_space = await self.run_on_store(adjust_reserve, self.archive.path, wanted)
        self.metrics.disk_full.set(self.disk_space.full)
        self.metrics.reserve.set(3600.0 * self.reserve_h)
        if self.disk_space.full != before.full:
            what = "is full" if self.disk_space.full else "has room again"
            text = f"{what}; the store's reserve lasts for {self.reserve_h:.1f} h"
            self.fleet.log.say(time.time(), "disk", text)


@asynccontextmanager
async def opened(
    service: Service, models: dict[str, LoadedModel], stop: asyncio.Event, log: EventLog
) -> AsyncIterator[Running]:
    """Give a service with its machines restored from the store, which is closed at the end."""
    service.folder.mkdir(parents=True, exist_ok=True)
    path = service.folder / _STORE
    with locked(service.folder), ExitStack() as ends:
        accounts = accounts_of(service)
        ends.callback(close, accounts.store, service.folder / ACCESS)
        store_thread = ThreadPoolExecutor(1, "store")
        store = open_store(path, service.given.store.durable)
        ends.callback(store.close)
        ends.callback(store_thread.shutdown, wait=True)
        preallocate(store, path)
        metrics = fresh_metrics()
        times = Times(time.time(), time.monotonic())
        fleet, newest = restored_fleet(service, models, store, log, metrics, times)
        running = Running(
            service,
            fleet,
            Publisher(),
            Archive(path),
            metrics,
            accounts,
            store,
            store_thread,
            asyncio.Queue(_MOST_BLOCKS),
            stop,
            identity=identity_of(path),
        )
        ends.callback(lambda: close(running.store, path))
        log.say(times.now, "start", f"store {path}")
        running.publisher.publish(newest)
        yield running
        log.say(time.time(), "stop", "all that was read is kept")
        with suppress(sqlite3.DatabaseError):
            await running.run_on_store(commit, Batch(events=log.take_pending()))


def restored_fleet(
    service: Service,
    models: dict[str, LoadedModel],
    store: sqlite3.Connection,
    log: EventLog,
    metrics: Metrics,
    times: Times,
) -> tuple[Fleet, list[Publication]]:
    """Return the machines restored from the store, and their first publications."""
    given = service.given
    machines = _restored_machines(service, models, store, log, times)
    fleet = Fleet(machines, log, metrics, given.ahead_s, given.behind_s, given.watchdog)
    # Silence is evaluated first, so that no control receives an offset from before it.
    silent = {one.machine: one for one in processing.check_silence(fleet, *times)}
    commit(store, Batch(received=processing.received_offsets(fleet, machines, times.now)))
    return fleet, [silent.get(name) or publication_of(one.state) for name, one in machines.items()]


def _restored_machines(
    service: Service,
    models: dict[str, LoadedModel],
    store: sqlite3.Connection,
    log: EventLog,
    times: Times,
) -> dict[str, Machine]:
    now, archive = times.now, Archive(service.folder / _STORE)
    of, received = machine_models(models, service), last_received(store)
    store.execute("BEGIN IMMEDIATE")
    eras = {
        name: era_of(store, name, model.digest, model.layout, now) for name, model in of.items()
    }
    store.execute("COMMIT")
    before = {name: era_before(store, era) for name, era in eras.items()}
    every = stored_eras(store, [*eras.values(), *(era for era, _ in before.values() if era)])
    by_name: dict[str, Machine] = {}
    moved: list[Checkpoint] = []
    for name, model in of.items():
        (earlier, continues), stored = before[name], every[eras[name]]
        last = archive.checkpointed(name, stored.era)
        fresh = stored.state is None and not stored.later
        if last is None and earlier is not None and continues:
            last = archive.checkpointed(name, earlier)
            if fresh:
                stored = every[earlier]
        elif fresh and earlier is not None:
            # Another model: its estimator starts anew, and the source is read from its position.
            stored = replace(stored, rest=_read_on(every[earlier], model))
        try:
            state, position = restore_state(name, model, stored, last, received.get(name), times)
        except InputError as error:
            # Its estimator starts anew, its offsets continue. A new era begins, because in the old
            # one a state with fewer samples would not replace the refused one.
            log.say(now, "state-refused", str(error), name)
            if stored.era == eras[name]:
                eras[name] = new_era(store, name, model.digest, model.layout, now)
            stored, last = StoredEra(eras[name], model.layout, 0, None, "{}", ()), None
            every[eras[name]] = stored
            state, position = restore_state(name, model, stored, last, received.get(name), times)
        if stored.era != eras[name]:
            moved += _moved(model, state, position, stored, eras[name])
            log.say(now, "moved", "other axes of the control; the estimator continues", name)
        last_usable = processing.last_usable_clock(
            _last_usable_sample(archive, model, state), model.rule, service.given.behind_s, times
        )
        # Samples of another layout stay in their era.
        rows = [(np.frombuffer(taken.row), taken.status) for taken in every[eras[name]].later]
        last_usable_time = times.now - (times.clock - last_usable)
        latest = state.latest if state.latest.number else archive.latest(name)
        by_name[name] = Machine(
            model,
            eras[name],
            state,
            position,
            last_usable,
            last_usable_time,
            latest.time if latest else math.nan,
            rows=rows,
        )
        if state.latest.number:
            log.say(now, "restored", f"{state.latest.number} samples, {len(rows)} again", name)
    if moved:
        commit(store, Batch(checkpoints=moved))
    return by_name


def _last_usable_sample(archive: Archive, model: LoadedModel, state: MachineState) -> Publication:
    """Return the last usable sample with a reading, or the oldest of many without one."""
    last = state.usable
    if last.number == 0 or processing.has_reading(model, last.readings.tolist()):
        return last
    before = archive.samples(state.name, (-math.inf, last.time), _LOOKED_AT, True)
    for last in before:
        if last.status != REFUSED and processing.has_reading(model, last.readings.tolist()):
            break
    return last


def _read_on(stored: StoredEra, model: LoadedModel) -> str:
    """Return the position of a source, and waiting readings if the model has the same readings."""
    if stored.layout.readings == model.layout.readings:
        return stored.newest
    return json.dumps({"at": json.loads(stored.newest).get("at")})


def _moved(
    model: LoadedModel, state: MachineState, position: object, stored: StoredEra, now: int
) -> tuple[Checkpoint, Checkpoint]:
    """Return the last checkpoint of an era, and the first of the era that continues it."""
    number, content = state.latest.number, state_bytes(model, state)
    rest = rest_of(state, position)
    rows = np.array([np.frombuffer(taken.row) for taken in stored.later])
    words = tuple(taken.status for taken in stored.later)
    none = np.empty((0, model.layout.width))
    return (
        Checkpoint(stored.era, number, content, rest, rows.reshape(-1, stored.layout.width), words),
        Checkpoint(now, number, content, rest, none, ()),
    )
