"""Reliable cancellation of tasks.

Before Python 3.12 `asyncio.wait_for` loses a cancellation that coincides with the result that it
waits for, and the libraries of some interfaces use it: a task that is cancelled once may then run
for ever, and the service that waits for its end as well.
"""

from __future__ import annotations

import asyncio
from typing import Any

#: A task that has not ended after this time, s, is cancelled again; an orderly end takes less.
AGAIN_S = 5.0


async def cancelled(*tasks: asyncio.Task[Any], again: float = AGAIN_S) -> list[Any]:
    """Cancel tasks until they have ended; return their results or errors as `asyncio.gather`."""
    going = set(tasks)
    while going:
        for task in going:
            task.cancel()
        going = (await asyncio.wait(going, timeout=again))[1]
    return await asyncio.gather(*tasks, return_exceptions=True)
