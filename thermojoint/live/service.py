"""The service as tasks of one event loop: readers, processing, store, writers."""

from __future__ import annotations

import asyncio
import gc
import math
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime

from thermojoint.live import processing
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.cancelling import cancelled
from thermojoint.live.certificates import expiry_warnings
from thermojoint.live.changed_settings import record_settings
from thermojoint.live.consistency import contradictions
from thermojoint.live.former_models import pinned, record_deployments
from thermojoint.live.loaded_models import LoadedModel, load_models, machine_models
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import Times, with_held_offsets
from thermojoint.live.notify import notify_systemd
from thermojoint.live.outputs import open_outputs
from thermojoint.live.processing import Machine
from thermojoint.live.publication import Publication
from thermojoint.live.readers.reader import Reader, readers_of
from thermojoint.live.recovery import is_damage, recover, recover_if_replaced
from thermojoint.live.running import Running, opened
from thermojoint.live.settings import Service
from thermojoint.live.store import Batch, checkpoint_wal, commit, new_era, prune

#: Number of arrivals that are processed at once; others wait.
_AT_ONCE = 32
#: Time in which arrivals are gathered for the next commit, s: commits of one sample are costly.
_GATHER_S = 0.01
#: Interval of checks for silence and of checkpoints, s.
_MONITOR_S = 1.0
#: Interval at which the store's write-ahead log is moved into its file, s.
_LOG_CHECKPOINT_S = 10.0
#: Interval at which the expiry of the certificates is checked, s.
_CERTIFICATE_CHECK_S = 86400.0
#: Delay before the store is tried again, s.
_RETRY_S = 1.0
#: Unacknowledged messages that a broker sends by default.
_USUAL_IN_FLIGHT = 20


async def run(
    service: Service,
    stop: asyncio.Event,
    ready: Callable[[Running], None] = lambda running: None,
    reload: Callable[[], None] = lambda: None,
) -> None:
    """Serve until `stop` is set, from outside, or until every source has ended.

    `ready` is called when all interfaces are open; `reload` is called when a user has made a change
    that needs a restart to take effect.

    Raises
    ------
    InputError
        Something in the file is unusable: a model, a certificate, an address in use.
    """
    log = EventLog()
    service, models = usable_part(pinned(service), log)
    readers = readers_of(service, machine_models(models, service))
    # The models stay in memory: the garbage collector need not examine them.
    gc.collect()
    gc.freeze()
    async with opened(service, models, stop, log) as running:
        running.reload = reload
        audit_changes(running)
        failed: list[BaseException] = []
        outputs = [asyncio.create_task(one) for one in await open_outputs(running)]
        fleet = running.fleet
        sources = [asyncio.create_task(_queue_arrivals(running, reader)) for reader in readers]
        work = asyncio.create_task(_process(running))
        watch = asyncio.create_task(_monitor(running))
        ended = asyncio.create_task(_stop_after_sources(running, sources, failed))
        tasks = [*outputs, work, watch]
        for task in tasks:
            task.add_done_callback(lambda ended: _note_failure(ended, failed, stop))
        fleet.log.say(time.time(), "ready", f"{len(fleet.machines)} machines")
        ready(running)
        notify_systemd("READY=1")
        try:
            await stop.wait()
        finally:
            notify_systemd("STOPPING=1")
            await cancelled(*sources, ended, watch, *outputs)
            # Earlier arrivals are still processed; an empty block ends the queue.
            if not work.done():
                await running.arrivals.put([])
            await asyncio.gather(work, return_exceptions=True)
            async with _store_maintenance(running):
                await recover_if_replaced(running)
            await _checkpoint(running, list(fleet.machines.values()))
        if failed:
            raise failed[0]


def audit_changes(running: Running) -> None:
    """Write changed settings and models into the audit log."""
    audit, now = running.accounts.audit, time.time()
    try:
        for change in record_settings(running.service):
            audit.accepted("service", "start", change)
        for machine, change in record_deployments(running.service, now):
            audit.accepted("service", "start", change, machine)
    except OSError as error:
        # The service goes on: a full disk must not stop any machine.
        running.fleet.log.say(now, "audit", f"changes cannot be written down: {error}")


def announce_certificates(running: Running) -> None:
    """Log the certificates that expire soon."""
    now = time.time()
    service = running.service
    for line in expiry_warnings(service.given, service.folder, datetime.fromtimestamp(now, UTC)):
        running.fleet.log.say(now, "certificate", line)


def usable_part(service: Service, log: EventLog) -> tuple[Service, dict[str, LoadedModel]]:
    """Return a service without the machines whose model cannot be opened, and the other models.

    Raises
    ------
    InputError, ConvergenceError
        No model can be opened.
    """
    models, refused = load_models(service)
    if not models:
        raise next(iter(refused.values()))
    for name, error in refused.items():
        log.say(time.time(), "model-refused", f"models.{name}: {error}")
    machines = {name: one for name, one in service.machines.items() if one.model in models}
    for warning in contradictions(service.given, models):
        log.say(time.time(), "settings", warning)
    return Service(service.given, machines), models


async def _queue_arrivals(running: Running, reader: Reader) -> None:
    """Queue the arrivals of a reader until it ends."""
    positions = {name: running.fleet.machines[name].position for name in reader.machines}
    try:
        async for block in reader.read(positions):
            if block:
                await running.arrivals.put(block)
    except Exception as error:
        # The other machines go on.
        text = f"{', '.join(reader.machines)[:100]}: read no more: {error}"
        running.fleet.log.say(time.time(), "source-failed", text)
        raise


async def _stop_after_sources(
    running: Running, sources: Sequence[asyncio.Task[None]], failed: list[BaseException]
) -> None:
    """End the service when every source has ended; it fails if one of them has failed."""
    results = await asyncio.gather(*sources, return_exceptions=True)
    failed += [one for one in results if isinstance(one, Exception)]
    await running.arrivals.join()
    running.stop.set()


def _note_failure(
    task: asyncio.Task[None], failed: list[BaseException], stop: asyncio.Event
) -> None:
    if not task.cancelled() and (error := task.exception()):
        failed.append(error)
        stop.set()


async def _process(running: Running) -> None:
    """Process arrivals, store the results, then publish them; an empty block ends the task."""
    fleet, queue = running.fleet, running.arrivals
    while True:
        blocks = [await queue.get()]
        size = len(blocks[0])
        while size < _AT_ONCE and not queue.empty():
            blocks.append(queue.get_nowait())
            size += len(blocks[-1])
        now = time.time()
        for item in (item for block in blocks for item in block if isinstance(item, Note)):
            fleet.log.say(now, item.kind, item.text, item.machine)
            running.metrics.events.labels(item.kind).inc()
        arrivals = [
            arrival for block in blocks for arrival in block if isinstance(arrival, Arrival)
        ]
        results = processing.process(fleet, arrivals, now, time.monotonic())
        events = fleet.log.take_pending()
        if results.samples or events:
            received = processing.received_offsets(fleet, results.publications, now)
            batch = Batch(results.samples, (), events, results.gaps, received)
            with running.metrics.commit.time():
                await _commit(running, batch)
        running.publisher.publish(list(results.publications.values()))
        for call in results.acknowledgements:
            call()
        for machine in processing.set_back_machines(fleet, Times(time.time(), time.monotonic())):
            await _begin_anew(running, machine)
        now = time.time()
        for received_at in results.receipt_times:
            running.metrics.latency.observe(max(0.0, now - received_at))
        running.metrics.waiting.set(queue.qsize())
        for _ in blocks:
            queue.task_done()
        if not all(blocks):
            return
        await asyncio.sleep(_GATHER_S if queue.empty() else 0.0)


async def _begin_anew(running: Running, machine: Machine) -> None:
    """Begin a new era of a machine whose last sample is ahead of a clock that was set back."""
    async with _store_maintenance(running):
        await _checkpoint(running, [machine])
        name, model, now = machine.state.name, machine.model, time.time()
        era = await running.run_on_store(new_era, name, model.digest, model.layout, now)
        processing.begin_anew(running.fleet, machine, era, now)
        await _commit(running, Batch(checkpoints=[processing.checkpoint_of(machine)]))


async def _monitor(running: Running) -> None:
    """Check for silence, store states at intervals, and prune the store."""
    settings = running.service.given.store
    log_checkpointed, announced = time.monotonic(), -math.inf
    while True:
        await asyncio.sleep(_MONITOR_S)
        notify_systemd("WATCHDOG=1")
        now, clock = time.time(), time.monotonic()
        await publish_changes(running, processing.check_silence(running.fleet, now, clock))
        running.publisher.heartbeat += 1
        processing.count_qualities(running.fleet)
        processing.count_modes(running.fleet, _MONITOR_S)
        await _acknowledge_stalled(running, processing.stalled_machines(running.fleet, clock))
        async with _store_maintenance(running):
            await recover_if_replaced(running)
            await running.maintain_reserve()
            await _checkpoint_some(running, settings.checkpoint_s)
        if clock - announced >= _CERTIFICATE_CHECK_S:
            announced = clock
            announce_certificates(running)
        if clock - log_checkpointed >= _LOG_CHECKPOINT_S:
            log_checkpointed = clock
            await checkpoint_store_log(running)


async def checkpoint_store_log(running: Running) -> None:
    """Move the store's write-ahead log into its file, and update the metric of its size."""
    path = running.archive.path
    log = path.with_name(path.name + "-wal")
    async with _store_maintenance(running):
        await asyncio.to_thread(checkpoint_wal, path)
    running.metrics.log_size.set(log.stat().st_size if log.exists() else 0)


@asynccontextmanager
async def _store_maintenance(running: Running) -> AsyncIterator[None]:
    """Context for deferrable work on the store; a damaged store is replaced."""
    store = running.store
    try:
        yield
    except sqlite3.DatabaseError as error:
        if is_damage(error):
            with suppress(sqlite3.DatabaseError):
                await recover(running, store, error)


async def publish_changes(running: Running, changed: list[Publication]) -> None:
    """Publish changes caused by silence, after storing the offsets that the controls receive."""
    names = [publication.machine for publication in changed]
    received = processing.received_offsets(running.fleet, names, time.time())
    if received:
        await _commit(running, Batch(received=received))
    running.publisher.publish(changed)


async def _acknowledge_stalled(running: Running, machines: Sequence[Machine]) -> None:
    """Store arrivals that wait for a sample unassembled, and acknowledge them."""
    if not machines:
        return
    # Counted for all machines: a busy computer may have read some less than `STALLED_S` ago.
    waiting = sum(len(machine.acknowledgements) for machine in running.fleet.machines.values())
    calls = [call for machine in machines for call in machine.acknowledgements]
    for machine in machines:
        machine.acknowledgements = []
    if waiting >= _USUAL_IN_FLIGHT:
        running.fleet.log.say(
            time.time(),
            "in-flight",
            f"{waiting} messages waited for others; a broker that sends no more than so many at "
            "a time needs a higher limit (Mosquitto: max_inflight_messages 0)",
        )
    await _commit(running, Batch(checkpoints=[processing.checkpoint_of(one) for one in machines]))
    for call in calls:
        call()


async def _checkpoint_some(running: Running, every: float) -> None:
    """Store the states of some machines, so that each is stored once within a time (s)."""
    if not running.pending:
        running.checkpointed_until, running.round_start = running.round_start, running.journal_end
        running.pending = list(running.fleet.machines.values())
    running.due += len(running.fleet.machines) * _MONITOR_S / every
    count = int(running.due)
    running.due -= count
    due, running.pending = running.pending[:count], running.pending[count:]
    await _checkpoint(running, due)
    oldest = 86400.0 * running.service.given.store.keep_days
    eras = [machine.era for machine in due]
    await running.run_on_store(prune, running.checkpointed_until, eras, oldest, time.time())


async def _checkpoint(running: Running, machines: Sequence[Machine]) -> None:
    checkpoints = [processing.checkpoint_of(machine) for machine in machines if machine.rows]
    events = running.fleet.log.take_pending()
    if checkpoints or events:
        await _commit(running, Batch(checkpoints=checkpoints, events=events))


async def _commit(running: Running, batch: Batch) -> None:
    """Store a batch; wait while the store's reserve is used up or another program locks the file.

    Meanwhile nothing new is published, and the controls hold the values received last.
    """
    while True:
        store = running.store
        try:
            running.journal_end = await running.run_on_store(commit, batch)
        except sqlite3.DatabaseError as error:
            log, newest = running.fleet.log, running.publisher.newest
            if is_damage(error):
                with suppress(sqlite3.DatabaseError):
                    await recover(running, store, error)
                    # The new store already contains the present states.
                    batch = replace(batch, checkpoints=())
                    continue
            log.say(time.time(), "store-waits", f"{running.archive.path}: {error}")
            running.publisher.publish([with_held_offsets(one) for one in newest.values()])
            if running.stop.is_set():
                return
            await asyncio.sleep(_RETRY_S)
            # `_monitor` itself may be waiting here.
            with suppress(sqlite3.DatabaseError):
                await running.maintain_reserve()
        else:
            return
