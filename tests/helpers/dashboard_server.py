"""A server of the dashboard in a thread, for tests that knock at it from outside."""

import asyncio
import dataclasses
import json
import math
import threading
import time
from contextlib import contextmanager

import numpy as np
from live_parts import free_port
from prometheus_client import CollectorRegistry, Gauge

from estimator.interface import Channel
from estimator.quality import Quality, quality_of
from estimator.registry import kind_of
from thermojoint.live.access_store import digest_of, open_access
from thermojoint.live.accounts import Accounts
from thermojoint.live.archive import Archive
from thermojoint.live.audit import Audit
from thermojoint.live.http.backend import Backend, MachineInfo
from thermojoint.live.http.server import open_http, serve_http
from thermojoint.live.publication import Layout, Publication, as_row
from thermojoint.live.publisher import Publisher
from thermojoint.live.rights import Principal
from thermojoint.live.settings import HttpServer
from thermojoint.live.store import Batch, Checkpoint, Event, commit, era_of, open_store

TOKEN = "a-token-for-tests-alone-0123456789abcdef"
READER = Principal("http.token", credential=digest_of(TOKEN))


LAYOUT = Layout(("x", "y"), ("X",), (Channel("heat_spindle", "W"),), ("T1_degC", "T2_degC"))
ABOUT = MachineInfo(LAYOUT, "joint-aware", "mill.h5", 1.7e9)
BEARER = {"authorization": f"Bearer {TOKEN}"}


def publication(number, moment, machine="mill-1", **changed):
    return Publication(
        **{
            "machine": machine,
            "number": number,
            "time": moment,
            "published": moment,
            "quality": Quality.GOOD,
            "layout": LAYOUT,
            "displacement": np.array([1e-6 * number, -2e-6]),
            "band": np.array([1e-7, math.nan]),
            "offsets": np.array([-1e-6 * number]),
            "details": np.array([250.0]),
            "readings": np.array([30.0 + number, math.nan]),
            "status": "reading-missing:T2_degC",
        }
        | changed
    )


def layout_of(estimator, controls=()):
    """Names of what is published of an estimator in tests."""
    thermal = [one for one in estimator.channels if one.unit == "K"]
    return Layout(
        axes=tuple(estimator.axes),
        controls=tuple(controls),
        details=estimator.details,
        readings=tuple(f"{one.name}_{one.unit}" for one in thermal),
    )


def published(name, layout, estimates, samples, start):
    """Publications of a run whose last sample is at `start` + its time."""
    return [
        Publication(
            machine=name,
            number=number,
            time=start + one.time,
            published=start + one.time,
            quality=quality_of(one.words, one.displacement),
            layout=layout,
            displacement=one.displacement,
            band=one.band,
            offsets=np.round(-one.displacement[: len(layout.controls)], 7),
            details=one.details,
            readings=np.array(sample[1:]),
            status=one.words,
        )
        for number, (one, sample) in enumerate(zip(estimates, samples, strict=True), 1)
    ]


def keep(path, runs, events=()):
    """A store with the histories of machines."""
    store = open_store(path)
    found = []
    for run in runs:
        last = run[-1]
        era = era_of(store, last.machine, "a model", last.layout, run[0].time)
        rows = np.array([as_row(one) for one in run])
        words = tuple(one.status for one in run)
        found.append(Checkpoint(era, last.number, b"", "{}", rows, words))
    commit(store, Batch(checkpoints=found, events=events))
    store.close()
    return Archive(path)


def about(estimator, layout, since):
    """What stays of a machine."""
    return MachineInfo(
        layout, estimator.kind, "model.h5", since, kind_of(estimator).ranges(estimator.model)
    )


class Running:
    """A server that runs; `publish` is what the service would do."""

    def __init__(self, opened, loop, stop, publisher, machines):
        self.url, self.publisher, self.token = opened.url, publisher, TOKEN
        #: Name to its constant data, which a test may change.
        self.machines = machines
        # The access control is the outermost of what the application consists of.
        self.server = opened.server
        app = opened.server.config.app
        given = [one.kwargs for one in app.user_middleware]
        self.access = next(one["access"] for one in given if "access" in one)
        self.accounts = self.access.accounts
        self._loop, self._stop = loop, stop

    def audit(self):
        """Lines of the audit log."""
        return [json.loads(line) for line in self.accounts.audit.path.read_text().splitlines()]

    def publish(self, *publications):
        self._loop.call_soon_threadsafe(self.publisher.publish, publications)

    def forget_failures(self):
        """Nobody has shown a wrong token."""
        self.access.failures.levels.clear()

    def drop_connections(self):
        """Whoever is connected is so no more."""

        def drop():
            for one in list(self.server.server_state.connections):
                one.transport.abort()

        self._loop.call_soon_threadsafe(drop)

    def stop(self):
        self._loop.call_soon_threadsafe(self._stop.set)


@contextmanager
def serving(
    folder, archive, machines, newest, scenes=None, residuals=None, security="none", **settings
):
    """Run a server until the block ends."""
    handshakes = settings.pop("handshakes", {})
    publisher, registry = Publisher(), CollectorRegistry()
    publisher.publish(newest)
    Gauge("machines", "Machines served", registry=registry).set(len(machines))
    given = {"port": free_port(), "security": security}
    section = HttpServer.model_validate(given | settings, context=folder)
    accounts = Accounts(
        open_access(folder),
        Audit(folder / "audit.jsonl"),
        folder / "users",
        {digest_of(TOKEN): READER},
    )
    backend = Backend(
        publisher, archive, machines, registry, scenes or {}, residuals or {}, handshakes
    )
    opened = open_http(section, backend, accounts, folder)
    ready, found = threading.Event(), []

    async def run():
        stop = asyncio.Event()
        found.append(Running(opened, asyncio.get_running_loop(), stop, publisher, machines))
        task = asyncio.create_task(serve_http(opened, stop))
        while not opened.server.started and not task.done():
            await asyncio.sleep(0.01)
        ready.set()
        await task

    thread = threading.Thread(target=lambda: asyncio.run(run()), daemon=True)
    thread.start()
    assert ready.wait(10.0)
    try:
        yield found[0]
    finally:
        found[0].stop()
        thread.join(10.0)
        assert not thread.is_alive()


def again(publication, **changed):
    """The same, said later."""
    moment = time.time()
    return dataclasses.replace(
        publication,
        **{"time": moment, "published": moment, "number": publication.number + 1} | changed,
    )


def event(machine, kind, text):
    """One that happened now."""
    return Event(time.time(), machine, kind, text)
