"""The service as a whole: readers, the floor, the store, writers, each a task of one event loop."""

from __future__ import annotations

import asyncio
import gc
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from artefacts.arrays import Array
from estimator.joint_aware.estimator import JointAware
from live import floor as floors
from live.archive import Archive
from live.arrivals import Arrival, Note
from live.floor import Floor, Place
from live.hub import Hub
from live.log_lines import EventLog
from live.machine import restored, shown
from live.metrics import Metrics, fresh_metrics
from live.notify import tell_systemd
from live.readers.reading import Reader, readers_of
from live.residuals import residuals_of
from live.served import Served, served_models, single
from live.settings import HttpServer, OpcuaServer, Service
from live.store import Batch, commit, era_of, forget, kept_of, open_store, shorten_log

if TYPE_CHECKING:
    from live.scene import Scene

#: Arrivals that are run through at once: what comes meanwhile waits so long.
_AT_ONCE = 32
#: Blocks of arrivals that may wait; then readers wait, too.
_MOST_BLOCKS = 2_000
#: Between two looks at silences and checkpoints, s.
_WATCH_S = 1.0
#: Between two cuts of the store's write-ahead log, s.
_SHORTEN_S = 30.0

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

    async def kept(self, work: Callable[..., Result], *arguments: object) -> Result:
        """Run something on the store, after all that was given before."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self.keeper, work, self.store, *arguments)


async def run(
    service: Service, stop: asyncio.Event, ready: Callable[[Running], None] = lambda running: None
) -> None:
    """Serve until `stop` is set, or until every source has come to its end.

    Parameters
    ----------
    service : Service
    stop : asyncio.Event
        Set from outside, e.g. by a signal.
    ready : callable
        Called when all doors are open.

    Raises
    ------
    InputError
        Something in the file does not work: a model, a certificate, an address that is taken.
    """
    models = served_models(service)
    readers = readers_of(service, single(models, service))
    # What was loaded stays: a collection need not look at it again and again.
    gc.collect()
    gc.freeze()
    async with opened(service, models, stop) as running:
        failed: list[BaseException] = []
        doors = [asyncio.create_task(one) for one in await _writers(running)]
        floor = running.floor
        sources = [asyncio.create_task(_read(running, one)) for one in readers]
        work = asyncio.create_task(_process(running))
        watch = asyncio.create_task(_watch(running))
        ended = asyncio.create_task(_ended(running, sources))
        tasks = [*doors, *sources, work, watch]
        for task in tasks:
            task.add_done_callback(lambda one: _note_failure(one, failed, stop))
        floor.log.say(time.time(), "ready", f"{len(floor.places)} machines")
        ready(running)
        tell_systemd("READY=1")
        try:
            await stop.wait()
        finally:
            tell_systemd("STOPPING=1")
            for task in (*sources, ended, watch, *doors):
                task.cancel()
            await asyncio.gather(*sources, ended, watch, *doors, return_exceptions=True)
            # What has arrived is still taken; the queue ends with nothing.
            if not work.done():
                await running.arrivals.put([])
            await asyncio.gather(work, return_exceptions=True)
            await _checkpoint(running, list(floor.places.values()))
        if failed:
            raise failed[0]


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
        await running.kept(shorten_log)
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


async def _writers(running: Running) -> list[Coroutine[Any, Any, None]]:
    """Open the doors that estimates go out by; what is returned is to be run."""
    service, found = running.service, []
    if service.given.mqtt is not None:
        from live.mqtt_session import address_of
        from live.writers.mqtt import write_topics

        out = service.given.mqtt
        address = address_of(out, service.base, "mqtt")
        log = running.floor.log
        found.append(write_topics(running.hub, address, out.topic, out.status_topic, log))
    if service.given.opcua is not None:
        found.append(await _opcua_server(running, service.given.opcua))
    if service.given.http is not None:
        found.append(_http_server(running, service.given.http))
    return found


def _http_server(running: Running, section: HttpServer) -> Coroutine[Any, Any, None]:
    from live.http.server import open_http, serve_http
    from live.http.sources import About, Sources
    from live.validity import ranges_of

    machines = {
        name: About(
            layout=place.served.layout,
            kind=place.served.estimator.kind,
            model=place.served.file,
            since=running.archive.model(name).begun,
            valid=ranges_of(place.served.estimator),
        )
        for name, place in running.floor.places.items()
    }
    sources = Sources(
        running.hub,
        running.archive,
        machines,
        running.metrics.registry,
        _scenes(running),
        {
            name: partial(_residuals_of, place)
            for name, place in running.floor.places.items()
            if isinstance(place.served.estimator, JointAware)
        },
    )
    opened = open_http(section, sources, running.service.base, running.service.folder)
    running.floor.log.say(time.time(), "listening", opened.url)
    return serve_http(opened, running.stop)


def _scenes(running: Running) -> dict[str, Scene]:
    """The machines whose models have a scene."""
    from live.scene import scene_of

    service, found = running.service, {}
    for name, section in service.machines.items():
        file = service.given.models[section.model].scene
        if file is not None:
            place = running.floor.places[name]
            state = partial(_state_of, place)
            found[name] = scene_of(service.path(file), place.served.estimator, state)
    return found


def _residuals_of(place: Place) -> dict[str, float | None] | None:
    return residuals_of(place.served, place.machine)


def _state_of(place: Place) -> Array:
    return place.machine.state


async def _opcua_server(running: Running, section: OpcuaServer) -> Coroutine[Any, Any, None]:
    from live.writers.opcua import open_server, serve_nodes

    def given(arrival: Arrival) -> None:
        """A value that nobody waits for; when all is full it is refused like one too many."""
        with suppress(asyncio.QueueFull):
            running.arrivals.put_nowait([arrival])

    machines = {
        name: (place.served.layout, place.served.rule.wanted)
        for name, place in running.floor.places.items()
    }
    service, log = running.service, running.floor.log
    server, nodes = await open_server(
        section, service.base, service.folder, running.hub, machines, given, log
    )
    return serve_nodes(server, nodes, running.hub)


async def _read(running: Running, reader: Reader) -> None:
    """Hand on what a reader finds, until it ends."""
    positions = {name: running.floor.places[name].position for name in reader.machines}
    async for found in reader.read(positions):
        if found:
            await running.arrivals.put(found)


async def _ended(running: Running, sources: Sequence[asyncio.Task[None]]) -> None:
    """End the service when no source has anything more."""
    await asyncio.gather(*sources)
    await running.arrivals.join()
    running.stop.set()


def _note_failure(
    task: asyncio.Task[None], failed: list[BaseException], stop: asyncio.Event
) -> None:
    if not task.cancelled() and (error := task.exception()):
        failed.append(error)
        stop.set()


async def _process(running: Running) -> None:
    """Take what arrives, keep it, then publish it; an empty block is the end."""
    floor, queue = running.floor, running.arrivals
    while True:
        blocks = [await queue.get()]
        size = len(blocks[0])
        while size < _AT_ONCE and not queue.empty():
            blocks.append(queue.get_nowait())
            size += len(blocks[-1])
        now = time.time()
        for one in (one for block in blocks for one in block if isinstance(one, Note)):
            floor.log.say(now, one.kind, one.text, one.machine)
            running.metrics.events.labels(one.kind).inc()
        arrivals = [one for block in blocks for one in block if isinstance(one, Arrival)]
        outcome = floors.absorb(floor, arrivals, now, time.monotonic())
        events = floor.log.fetched()
        if outcome.taken or events:
            batch = Batch(outcome.taken, (), events, outcome.holes)
            with running.metrics.commit.time():
                running.journal_end = await running.kept(commit, batch)
        running.hub.publish(list(outcome.publications.values()))
        for call in outcome.kept:
            call()
        now = time.time()
        for came in outcome.came:
            running.metrics.latency.observe(max(0.0, now - came))
        running.metrics.waiting.set(queue.qsize())
        for _ in blocks:
            queue.task_done()
        if not all(blocks):
            return
        await asyncio.sleep(0)


async def _watch(running: Running) -> None:
    """Look at silences, keep states now and then, and cut what the store has no use for."""
    settings = running.service.given.store
    shortened = time.monotonic()
    while True:
        await asyncio.sleep(_WATCH_S)
        tell_systemd("WATCHDOG=1")
        now, clock = time.time(), time.monotonic()
        running.hub.publish(floors.watch(running.floor, now, clock))
        floors.count_qualities(running.floor)
        await _checkpoint_some(running, settings.checkpoint_s)
        if clock - shortened >= _SHORTEN_S:
            shortened = clock
            path = running.archive.path
            await running.kept(shorten_log)
            log = path.with_name(path.name + "-wal")
            running.metrics.log_size.set(log.stat().st_size if log.exists() else 0)


async def _checkpoint_some(running: Running, every: float) -> None:
    """Keep the states of some machines, so that all have their turn in a time (s)."""
    if not running.round:
        if running.round_from:
            eras = [place.era for place in running.floor.places.values()]
            oldest = 86400.0 * running.service.given.store.keep_days
            await running.kept(forget, running.round_from, eras, oldest, time.time())
        running.round_from = running.journal_end
        running.round = list(running.floor.places.values())
    running.share += len(running.floor.places) * _WATCH_S / every
    count = int(running.share)
    running.share -= count
    due, running.round = running.round[:count], running.round[count:]
    await _checkpoint(running, due)


async def _checkpoint(running: Running, places: Sequence[Place]) -> None:
    found = [floors.checkpoint_of(place) for place in floors.unwritten(places)]
    events = running.floor.log.fetched()
    if found or events:
        await running.kept(commit, Batch(checkpoints=found, events=events))
