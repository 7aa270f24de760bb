"""The service as tasks of one event loop: readers, floor, store, writers."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable, Sequence

from thermojoint.live import floor as floors
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.doors import open_doors
from thermojoint.live.floor import Place
from thermojoint.live.notify import tell_systemd
from thermojoint.live.publication import Publication
from thermojoint.live.readers.reading import Reader, readers_of
from thermojoint.live.running import Running, opened
from thermojoint.live.served import served_models, single
from thermojoint.live.settings import Service
from thermojoint.live.store import Batch, commit, cut_log, forget, move_log

#: Arrivals that are run through at once: what comes meanwhile waits so long.
_AT_ONCE = 32
#: After a commit what comes is gathered for the next one, s: commits of one sample cost the most.
_GATHER_S = 0.01
#: Between two looks at silences and checkpoints, s.
_WATCH_S = 1.0
#: Between two moves of the store's write-ahead log into its file, s.
_SHORTEN_S = 10.0
#: A longer one is cut, bytes.
_LONGEST_LOG = 64_000_000


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
        doors = [asyncio.create_task(door) for door in await open_doors(running)]
        floor = running.floor
        sources = [asyncio.create_task(_read(running, reader)) for reader in readers]
        work = asyncio.create_task(_process(running))
        watch = asyncio.create_task(_watch(running))
        ended = asyncio.create_task(_ended(running, sources))
        tasks = [*doors, *sources, work, watch]
        for task in tasks:
            task.add_done_callback(lambda ended: _note_failure(ended, failed, stop))
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


async def _read(running: Running, reader: Reader) -> None:
    """Hand on what a reader finds, until it ends."""
    positions = {name: running.floor.places[name].position for name in reader.machines}
    async for block in reader.read(positions):
        if block:
            await running.arrivals.put(block)


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
        for item in (item for block in blocks for item in block if isinstance(item, Note)):
            floor.log.say(now, item.kind, item.text, item.machine)
            running.metrics.events.labels(item.kind).inc()
        arrivals = [
            arrival for block in blocks for arrival in block if isinstance(arrival, Arrival)
        ]
        outcome = floors.absorb(floor, arrivals, now, time.monotonic())
        events = floor.log.fetched()
        if outcome.taken or events:
            received = floors.received(floor, outcome.publications, now)
            batch = Batch(outcome.taken, (), events, outcome.holes, received)
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
        await asyncio.sleep(_GATHER_S if queue.empty() else 0.0)


async def _watch(running: Running) -> None:
    """Look at silences, keep states now and then, and cut what the store has no use for."""
    settings = running.service.given.store
    shortened = time.monotonic()
    while True:
        await asyncio.sleep(_WATCH_S)
        tell_systemd("WATCHDOG=1")
        now, clock = time.time(), time.monotonic()
        await published(running, floors.watch(running.floor, now, clock))
        floors.count_qualities(running.floor)
        await _checkpoint_some(running, settings.checkpoint_s)
        if clock - shortened >= _SHORTEN_S:
            shortened = clock
            path = running.archive.path
            log = path.with_name(path.name + "-wal")
            # Commits wait for a cut, not for a move; after it little is left to cut.
            await asyncio.to_thread(move_log, path)
            size = log.stat().st_size if log.exists() else 0
            if size > _LONGEST_LOG:
                await running.kept(cut_log)
            running.metrics.log_size.set(size)


async def published(running: Running, changed: list[Publication]) -> None:
    """Publish what silence has changed, after the offsets are kept that the controls receive."""
    names = [publication.machine for publication in changed]
    received = floors.received(running.floor, names, time.time())
    if received:
        await running.kept(commit, Batch(received=received))
    running.hub.publish(changed)


async def _checkpoint_some(running: Running, every: float) -> None:
    """Keep the states of some machines, so that all have their turn in a time (s)."""
    if not running.round:
        running.behind, running.round_from = running.round_from, running.journal_end
        running.round = list(running.floor.places.values())
    running.share += len(running.floor.places) * _WATCH_S / every
    count = int(running.share)
    running.share -= count
    due, running.round = running.round[:count], running.round[count:]
    await _checkpoint(running, due)
    oldest = 86400.0 * running.service.given.store.keep_days
    eras = [place.era for place in due]
    await running.kept(forget, running.behind, eras, oldest, time.time())


async def _checkpoint(running: Running, places: Sequence[Place]) -> None:
    checkpoints = [floors.checkpoint_of(place) for place in floors.unwritten(places)]
    events = running.floor.log.fetched()
    if checkpoints or events:
        await running.kept(commit, Batch(checkpoints=checkpoints, events=events))
