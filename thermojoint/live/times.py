"""Times from sources: s since 1970, or ISO 8601, in UTC unless a zone is given."""

from __future__ import annotations

from datetime import UTC, datetime


def seconds_of(text: str) -> float:
    """Return a time in ISO 8601 as s since 1970.

    Raises
    ------
    ValueError
        The text is not a time.
    """
    return since_1970(datetime.fromisoformat(text))


def since_1970(moment: datetime) -> float:
    """Return a moment, in UTC unless a zone is given, as s since 1970."""
    return moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()
