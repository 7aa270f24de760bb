"""Audit log: user, origin, action, and whether it was accepted; one JSON object per line.

Lines are only appended. Refused attempts and values that a control writes in every cycle are
limited like log lines, with the number of omitted lines, so that nobody can flood the log.

While the disk is full, accepted actions are written into a preallocated file and moved to the log
later; values written by a control are counted as omitted. The service is not interrupted.
"""

from __future__ import annotations

import errno
import json
import os
import time
from collections.abc import Hashable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from thermojoint.live.publication import iso_time
from thermojoint.live.rate_limit import LineLimit
from thermojoint.live.secret import create_private

#: Name of the file in the folder of a service.
NAME = "audit.jsonl"
_LONGEST = 200
#: Size of the preallocated file, bytes: some five thousand lines.
_SPARE = 1 << 20


@dataclass(eq=False)
class Audit:
    """The audit log of a service."""

    #: The present file; the names of earlier ones beside it contain the time of their end.
    path: Path
    #: Size at which the next file begins, bytes.
    largest: int = 10_000_000
    #: Earlier files are deleted after this time, s.
    keep: float = 365.0 * 86400.0
    _limit: LineLimit = field(default_factory=LineLimit)

    def accepted(self, who: str, origin: str, what: str, machine: str | None = None) -> None:
        """Write an accepted action.

        `who` is the name of a user or a token; ``service`` or ``command`` for actions not requested
        by an interface. `origin` is the interface and the address, e.g. ``http 192.0.2.7``.

        Raises
        ------
        OSError
            The line cannot be written at all; the caller refuses actions that cannot be audited.
        """
        line = _line(who, origin, what, machine, {"outcome": "accepted"})
        try:
            self._append(line)
        except OSError:
            self._write_spare(line)

    def written(
        self, who: str, origin: str, what: str, machine: str | None, value: str = ""
    ) -> None:
        """Write an accepted write of a value; as `accepted`, but rate-limited for any value."""
        entry = who, origin, f"{what}{value}", machine
        self._write((who, what), entry, {"outcome": "accepted"})

    def refused(
        self, who: str, origin: str, what: str, why: str, machine: str | None = None
    ) -> None:
        """Write a refused action and its reason `why`; other parameters as for `accepted`."""
        self._write(
            (origin, what), (who, origin, what, machine), {"outcome": "refused", "why": why}
        )

    def _write(
        self, kind: Hashable, entry: tuple[str, str, str, str | None], outcome: dict[str, str]
    ) -> None:
        """Write a line, rate-limited by its kind."""
        left_out = self._limit.left_out(kind, time.monotonic())
        if left_out is None:
            return
        try:
            self._append(_line(*entry, outcome, left_out))
        except OSError:
            self._limit.leave_out(kind, left_out + 1)

    def _append(self, line: bytes) -> None:
        """Append a line, after those in the preallocated file."""
        earlier = self._spare_lines()
        lines = earlier + line
        if self.path.exists() and self.path.stat().st_size + len(lines) > self.largest:
            self._rotate()
        create_private(self.path)
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        try:
            size = os.fstat(handle).st_size
            if os.write(handle, lines) < len(lines):
                os.ftruncate(handle, size)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        finally:
            os.close(handle)
        with suppress(OSError):
            create_private(self._spare)
            if earlier or self._spare.stat().st_size < _SPARE:
                # In place: space given up by a shorter file could be lost on a disk that fills.
                with self._spare.open("r+b") as file:
                    file.write(bytes(_SPARE))

    @property
    def _spare(self) -> Path:
        """The preallocated file."""
        return self.path.with_suffix(".spare")

    def _spare_lines(self) -> bytes:
        """Return the lines in the preallocated file."""
        return self._spare.read_bytes().rstrip(b"\0") if self._spare.exists() else b""

    def _write_spare(self, line: bytes) -> None:
        """Write a line into the free part of the preallocated file."""
        with self._spare.open("r+b") as file:
            used, size = len(self._spare_lines()), file.seek(0, os.SEEK_END)
            if used + len(line) > size:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            file.seek(used)
            file.write(line)

    def _rotate(self) -> None:
        """Begin a new file, and delete those that are too old."""
        stem = self.path.stem
        self.path.replace(
            self.path.with_name(f"{stem}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z.jsonl")
        )
        for path in self.path.parent.glob(f"{stem}-*.jsonl"):
            if time.time() - path.stat().st_mtime > self.keep:
                path.unlink(missing_ok=True)


def _line(
    who: str,
    origin: str,
    what: str,
    machine: str | None,
    outcome: dict[str, str],
    left_out: int = 0,
) -> bytes:
    entry = {"time": iso_time(time.time()), "who": who[:_LONGEST], "from": origin, "what": what}
    more = ({"machine": machine} if machine else {}) | outcome
    before = {"left_out_before": left_out} if left_out else {}
    return (json.dumps(entry | more | before) + "\n").encode()
