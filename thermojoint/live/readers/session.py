"""A persistent connection shared with its reader."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from thermojoint.live.cancelling import cancelled


@asynccontextmanager
async def beside(
    staying: Coroutine[Any, Any, None], came: asyncio.Event
) -> AsyncIterator[Callable[[], Awaitable[None]]]:
    """Run a session in the background; give a function that waits for the next arrival.

    Parameters
    ----------
    staying : coroutine
        Keeps the connection and ends only by an error, which the function raises; cancelled at the
        end of the context.
    came : Event
        Set when something has arrived.
    """
    session = asyncio.create_task(staying)
    session.add_done_callback(lambda _: came.set())

    async def heard() -> None:
        await came.wait()
        came.clear()
        if session.done():
            session.result()

    try:
        yield heard
    finally:
        await cancelled(session)
