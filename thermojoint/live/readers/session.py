"""A persistent connection shared with its reader."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from thermojoint.live.cancelling import cancelled


@asynccontextmanager
async def background_session(
    connection: Coroutine[Any, Any, None], received: asyncio.Event
) -> AsyncIterator[Callable[[], Awaitable[None]]]:
    """Run a session in the background; give a function that waits for the next arrival.

    The connection ends only by an error, which that function raises; it is cancelled at the end of
    the context. `received` is set when something has arrived.
    """
    session = asyncio.create_task(connection)
    session.add_done_callback(lambda _: received.set())

    async def next_arrival() -> None:
        await received.wait()
        received.clear()
        if session.done():
            session.result()

    try:
        yield next_arrival
    finally:
        await cancelled(session)
