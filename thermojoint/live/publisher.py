"""Newest publication of every machine, and subscriptions to new ones.

A slow subscriber does not fill any queue: it gets the names of changed machines, not every
publication.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from thermojoint.live.publication import Publication


@dataclass(eq=False)
class Subscription:
    """A subscription to new publications."""

    #: Machines with an unfetched publication.
    changed: set[str] = field(default_factory=set)
    _published: asyncio.Event = field(default_factory=asyncio.Event)

    async def wait(self) -> set[str]:
        """Wait for, and return, the machines that have changed since the last call."""
        await self._published.wait()
        self._published.clear()
        changed, self.changed = self.changed, set()
        return changed

    def notify(self, machines: Sequence[str]) -> None:
        """Note that machines have changed."""
        self.changed.update(machines)
        self._published.set()


@dataclass(eq=False)
class Publisher:
    """Newest publications, shared; used only from the service's event loop."""

    #: Newest publication of each machine; to be changed by `publish` only.
    newest: dict[str, Publication] = field(default_factory=dict)
    #: Heartbeat, incremented while the service monitors its machines.
    heartbeat: int = 0
    _subscriptions: set[Subscription] = field(default_factory=set)

    def publish(self, publications: Sequence[Publication]) -> None:
        """Replace the newest publications of some machines, and notify the subscribers."""
        self.newest.update((publication.machine, publication) for publication in publications)
        machines = [publication.machine for publication in publications]
        for subscription in self._subscriptions:
            subscription.notify(machines)

    @contextmanager
    def subscribe(self) -> Iterator[Subscription]:
        """Give a new subscription; existing publications count as changed."""
        subscription = Subscription()
        if self.newest:
            subscription.notify(list(self.newest))
        self._subscriptions.add(subscription)
        try:
            yield subscription
        finally:
            self._subscriptions.discard(subscription)
