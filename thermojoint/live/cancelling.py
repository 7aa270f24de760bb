"""The end of tasks that are cancelled.

Before Python 3.12 `asyncio.wait_for` loses a cancellation that comes at the same moment as what it
waits for, and the libraries of some doors use it: a task that is cancelled once may then go on for
ever, and with it the service that waits for its end.
"""

from __future__ import annotations

import asyncio
from typing import Any

#: A task that has not ended after this time, s, is cancelled again. Longer than a farewell takes.
AGAIN_S = 5.0


async def cancelled(*tasks: asyncio.Task[Any], again: float = AGAIN_S) -> list[Any]:
    """Cancel tasks until they have ended; what they return or raise, as `asyncio.gather` has it."""
    going = set(tasks)
    while going:
        for task in going:
            task.cancel()
        going = (await asyncio.wait(going, timeout=again))[1]
    return await asyncio.gather(*tasks, return_exceptions=True)
