"""Event log, one key=value line per event, rate-limited by kind."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable
from dataclasses import dataclass, field

from thermojoint.live.publication import iso_time
from thermojoint.live.rate_limit import LineLimit
from thermojoint.live.store import Event

LOGGER = logging.getLogger("thermojoint.live")
_PLAIN = re.compile(r"[^\s=\"]+")
_LONGEST = 500


@dataclass(eq=False)
class EventLog:
    """Events on their way to the log and the store."""

    #: Events not stored yet.
    pending: list[Event] = field(default_factory=list)
    #: Limit by machine and kind.
    limit: LineLimit = field(default_factory=LineLimit)

    def say(self, time: float, kind: str, text: str, machine: str | None = None) -> None:
        """Log an event at a time (s since 1970), unless too many of its kind were logged before."""
        before = self.limit.left_out((machine, kind), time)
        if before is not None:
            text = one_line(text, before)
            LOGGER.info("%s", line_of(kind, text, machine))
            self.pending.append(Event(time, machine, kind, text))

    def take_pending(self) -> list[Event]:
        """Return the events to be stored, and clear them."""
        lines, self.pending = self.pending, []
        return lines


def one_line(text: str, left_out: int) -> str:
    """Return a text as one line of bounded length, with the number of omitted earlier lines."""
    more = f" (and {left_out} more like it)" if left_out else ""
    return " ".join(text.split())[: _LONGEST - len(more)] + more


def line_of(kind: str, text: str, machine: str | None = None) -> str:
    """Return an event as key=value."""
    pairs = [("event", kind), *([("machine", machine)] if machine else []), ("text", text)]
    return " ".join(f"{key}={_quoted(value)}" for key, value in pairs)


def _quoted(value: str) -> str:
    if _PLAIN.fullmatch(value):
        return value
    printable = "".join(character if character.isprintable() else "?" for character in value)
    return json.dumps(printable, ensure_ascii=False)


def log_to_stderr() -> None:
    """Write the lines to standard error, each with its time (UTC) and level.

    Errors of libraries are one line each, without a traceback, and limited like events.
    """
    handler = logging.StreamHandler()
    handler.setFormatter(_Line())
    handler.addFilter(limited(LineLimit()))
    LOGGER.setLevel(logging.INFO)
    LOGGER.addHandler(handler)
    LOGGER.propagate = False
    root = logging.getLogger()
    root.setLevel(logging.ERROR)
    root.addHandler(handler)


def limited(limit: LineLimit) -> Callable[[logging.LogRecord], bool]:
    """Return a filter that limits the log lines of libraries by their place in the source."""

    def passes(record: logging.LogRecord) -> bool:
        if record.name == LOGGER.name:
            return True
        before = limit.left_out((record.pathname, record.lineno), record.created)
        if before is None:
            return False
        text = one_line(f"{record.name}: {record.getMessage()}", before)
        record.msg, record.args = line_of("library", text), ()
        return True

    return passes


class _Line(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        """Return one record as one line."""
        level = record.levelname.lower()
        return f"time={iso_time(record.created)} level={level} {record.getMessage()}"
