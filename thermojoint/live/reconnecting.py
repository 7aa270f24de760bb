"""Lost connections: description of the error, and delays between attempts, for every protocol."""

from __future__ import annotations

#: Delay before the second attempt to connect, doubled for each further one up to the longest, s.
FIRST_S, LONGEST_S = 0.5, 30.0


def shown(error: BaseException) -> str:
    """Return the error that ended a connection as text for the log."""
    return f"{type(error).__name__} {error}".strip()[:200]


def next_delay(delay: float) -> float:
    """Return the delay before the next attempt, s."""
    return min(2.0 * delay, LONGEST_S)
