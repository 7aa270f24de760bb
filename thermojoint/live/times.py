"""Times from sources: s since 1970, or ISO 8601, which is UTC if it has no zone."""

from __future__ import annotations

from datetime import UTC, datetime


def seconds_of(text: str) -> float:
    """Return a time in ISO 8601 as s since 1970.

    Raises
    ------
    ValueError
        It is no time.
    """
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return moment.timestamp()
