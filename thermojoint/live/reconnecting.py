"""Lost connections: attempts with growing delays, and errors as text, for every protocol."""

from __future__ import annotations

import asyncio

#: Delay before the second attempt to connect, doubled for each further one up to the longest, s.
FIRST_S, LONGEST_S = 0.5, 30.0


class Attempts:
    """Endless attempts to connect, with a delay between them, as an asynchronous iterator."""

    def __init__(self) -> None:
        self._delay = 0.0

    def __aiter__(self) -> Attempts:
        return self

    async def __anext__(self) -> Attempts:
        await asyncio.sleep(self._delay)
        self._delay = min(max(2.0 * self._delay, FIRST_S), LONGEST_S)
        return self

    def succeeded(self) -> None:
        """Note that this attempt has connected: after it the first delay applies again."""
        self._delay = FIRST_S


def shown(error: BaseException) -> str:
    """Return the error that ended a connection as text for the log."""
    return f"{type(error).__name__} {error}".strip()[:200]
