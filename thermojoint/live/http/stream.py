"""Server-sent events with the newest sample of every changed machine.

For each reader only the names of changed machines are stored. A slow reader gets fewer events, with
the newest values; nothing is queued.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any

from starlette.responses import StreamingResponse

from thermojoint.live.http.bodies import encoded
from thermojoint.live.publication import Publication
from thermojoint.live.publisher import Publisher

#: Interval of empty events when nothing changes, s: longer silence means a broken connection.
BEAT_S = 3.0
#: A stream ends after this time, s; the browser opens it again and is authenticated again.
LONGEST_S = 3600.0
#: Number of publications encoded before other tasks get the event loop.
AT_ONCE = 64


@dataclass(frozen=True)
class Subscriber:
    """Reader of a stream."""

    #: Requested machines.
    machines: frozenset[str]
    #: Shortest time between two events, s.
    every: float
    #: Returns None once the reader's session or token has ended.
    check: Callable[[], object]


async def stream(
    publisher: Publisher, subscriber: Subscriber, body: Callable[[Publication], bytes]
) -> AsyncIterator[bytes]:
    """Yield events until `LONGEST_S`: first the newest of each machine, then changed ones."""
    begun = time.monotonic()
    yield b"retry: 2000\n\n"
    with publisher.subscribe() as subscription:
        while time.monotonic() - begun < LONGEST_S and subscriber.check() is not None:
            try:
                async with asyncio.timeout(BEAT_S):
                    changed = await subscription.wait()
            except TimeoutError:
                changed = set()
            messages = []
            for name in sorted(changed & subscriber.machines):
                messages.append(body(publisher.newest[name]))
                if len(messages) % AT_ONCE == 0:
                    await asyncio.sleep(0)
            if messages or not changed:
                now = encoded(time.time())
                yield b'event: news\ndata: {"now_s":%b,"publications":[%b]}\n\n' % (
                    now,
                    b",".join(messages),
                )
            await asyncio.sleep(subscriber.every)


class CountedStream(StreamingResponse):
    """A stream that reports its end, however it ends."""

    def __init__(self, content: Any, on_close: Callable[[], None]) -> None:  # noqa: ANN401
        super().__init__(content, media_type="text/event-stream")
        self._on_close = on_close

    async def __call__(self, *given: Any) -> None:  # noqa: ANN401
        """Send until the reader disconnects."""
        try:
            await super().__call__(*given)
        finally:
            self._on_close()
