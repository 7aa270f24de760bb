"""Event log, one key=value line per event, rate-limited by kind."""

from __future__ import annotations

import logging
import re
import sys
from dataclasses import dataclass, field
from typing import TextIO

from thermojoint.live.publication import iso_time
from thermojoint.live.store import Event

LOGGER = logging.getLogger("thermojoint.live")
#: After so many of a kind from a machine the next is told when this time has passed, s.
AT_ONCE, AGAIN_S = 5, 60.0
#: Kinds and machines that are remembered; whoever invents more is told of as one.
_MOST = 20_000
_PLAIN = re.compile(r"[^\s=\"]+")
_LONGEST = 500


@dataclass(eq=False)
class EventLog:
    """Events on their way to log and store.

    Attributes
    ----------
    pending : list of Event
        Not stored yet.
    """

    pending: list[Event] = field(default_factory=list)
    _seen: dict[tuple[str | None, str], list[float]] = field(default_factory=dict)

    def say(self, time: float, kind: str, text: str, machine: str | None = None) -> bool:
        """Tell an event, unless as many of its kind were told just now; return whether it was.

        Parameters
        ----------
        time : float
            s since 1970.
        kind, text : str
            What happened.
        machine : str, optional
            To whom.
        """
        key = (machine, kind) if len(self._seen) < _MOST else (None, kind)
        # Number told at once, time of the last, number that was left out since.
        seen = self._seen.setdefault(key, [0.0, -AGAIN_S, 0.0])
        if time - seen[1] >= AGAIN_S:
            seen[0] = 0.0
        elif seen[0] >= AT_ONCE:
            seen[2] += 1.0
            return False
        if seen[2]:
            text = f"{text} (and {seen[2]:.0f} more like it)"
        seen[:] = [seen[0] + 1.0, time, 0.0]
        text = " ".join(text.split())[:_LONGEST]
        LOGGER.info("%s", line_of(kind, text, machine))
        self.pending.append(Event(time, machine, kind, text))
        return True

    def fetched(self) -> list[Event]:
        """Return what is to be stored, and forget it."""
        lines, self.pending = self.pending, []
        return lines


def line_of(kind: str, text: str, machine: str | None = None) -> str:
    """Return an event as key=value."""
    pairs = [("event", kind), *([("machine", machine)] if machine else []), ("text", text)]
    return " ".join(f"{key}={_quoted(value)}" for key, value in pairs)


def _quoted(value: str) -> str:
    if _PLAIN.fullmatch(value):
        return value
    printable = "".join(character if character.isprintable() else "?" for character in value)
    escaped = printable.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def log_to(stream: TextIO = sys.stderr) -> None:
    """Send the lines to a stream, each with its time (UTC) and level.

    Libraries are heard when something is wrong, and in one line: a trace is no event.
    """
    handler = logging.StreamHandler(stream)
    handler.setFormatter(_Line())
    LOGGER.setLevel(logging.INFO)
    LOGGER.addHandler(handler)
    LOGGER.propagate = False
    root = logging.getLogger()
    root.setLevel(logging.ERROR)
    root.addHandler(handler)


class _Line(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        """Return one record as one line."""
        said = record.getMessage()
        if record.name != LOGGER.name:
            said = line_of("library", f"{record.name}: {' '.join(said.split())[:_LONGEST]}")
        return f"time={iso_time(record.created)} level={record.levelname.lower()} {said}"
