"""A service that runs: its machines as the store has them, and the thread that keeps them."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from thermojoint.live import floor as floors
from thermojoint.live.archive import Archive
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.floor import Floor, Place
from thermojoint.live.hub import Hub
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine import restored, shown
from thermojoint.live.metrics import Metrics, fresh_metrics
from thermojoint.live.served import Served, single
from thermojoint.live.settings import Service
from thermojoint.live.store import Batch, commit, cut_log, era_of, kept_of, open_store

#: Blocks of arrivals that may wait; then readers wait, too.
_MOST_BLOCKS = 2_000

Result = TypeVar("Result")


@dataclass(eq=False)
class Running:
    """A service that runs.

    Attributes
    ----------
    service : Service
        Its file.
    floor : Floor
        Its machines.
    hub : Hub
        What is published.
    archive : Archive
        What was.
    metrics : Metrics
        Figures.
    store : Connection
        Used in `keeper` alone.
    keeper : ThreadPoolExecutor
        One thread: what is kept is kept in order.
    arrivals : asyncio.Queue
        From the readers.
    stop : asyncio.Event
        Set when the service is to end.
    journal_end : int
        Last entry of the store's journal.
    round, round_from, share
        Of the checkpoints: machines that still wait for theirs, the journal's end when this round
        began, and the part of a machine whose turn it is.
    behind : int
        Last entry of the journal that every machine has a checkpoint behind.
    """

    service: Service
    floor: Floor
    hub: Hub
    archive: Archive
    metrics: Metrics
    store: sqlite3.Connection
    keeper: ThreadPoolExecutor
    arrivals: asyncio.Queue[list[Arrival | Note]]
    stop: asyncio.Event
    journal_end: int = 0
    round: list[Place] = field(default_factory=list)
    round_from: int = 0
    share: float = 0.0
    behind: int = 0

    async def kept(self, work: Callable[..., Result], *arguments: object) -> Result:
        """Run something on the store, after all that was given before."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self.keeper, work, self.store, *arguments)


@asynccontextmanager
async def opened(
    service: Service, models: dict[str, Served], stop: asyncio.Event
) -> AsyncIterator[Running]:
    """Give a service with its machines where the store has them; the store is closed at the end."""
    service.folder.mkdir(parents=True, exist_ok=True)
    path = service.folder / "history.sqlite"
    keeper = ThreadPoolExecutor(1, "keeper")
    store = open_store(path, service.given.store.durable)
    try:
        metrics, log = fresh_metrics(), EventLog()
        places = _places(service, models, store, Archive(path), log)
        floor = Floor(places, log, metrics, service.given.ahead_s, service.given.watchdog)
        running = Running(
            service,
            floor,
            Hub(),
            Archive(path),
            metrics,
            store,
            keeper,
            asyncio.Queue(_MOST_BLOCKS),
            stop,
        )
        now = time.time()
        log.say(now, "start", f"store {path}")
        running.hub.publish([shown(place.machine) for place in places.values()])
        running.hub.publish(floors.watch(floor, now, time.monotonic()))
        yield running
        log.say(time.time(), "stop", "all that was read is kept")
        await running.kept(commit, Batch(events=log.fetched()))
        await running.kept(cut_log)
    finally:
        keeper.shutdown(wait=True)
        store.close()


def _places(
    service: Service,
    models: dict[str, Served],
    store: sqlite3.Connection,
    archive: Archive,
    log: EventLog,
) -> dict[str, Place]:
    now, clock = time.time(), time.monotonic()
    of = single(models, service)
    store.execute("BEGIN IMMEDIATE")
    eras = {name: era_of(store, name, one.digest, one.layout, now) for name, one in of.items()}
    store.execute("COMMIT")
    kept = kept_of(store, eras.values())
    found = {}
    for name, model in of.items():
        last = archive.checkpointed(name, eras[name])
        machine, position = restored(name, model, kept[eras[name]], last, now)
        heard = floors.since_heard(machine.usable, now, clock)
        rows = [(np.frombuffer(one.row), one.status) for one in kept[eras[name]].later]
        found[name] = Place(model, eras[name], machine, position, heard, rows=rows)
        if machine.said.number:
            log.say(now, "restored", f"{machine.said.number} samples, {len(rows)} again", name)
    return found
