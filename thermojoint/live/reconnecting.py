"""Delays between attempts to connect again, for every protocol."""

from __future__ import annotations

#: Delay before the second attempt to connect, doubled for each further one up to the longest, s.
FIRST_S, LONGEST_S = 0.5, 30.0


def next_delay(delay: float) -> float:
    """Return how long to wait before the next attempt, s."""
    return min(2.0 * delay, LONGEST_S)
