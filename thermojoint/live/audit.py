"""Audit log: who did what from where, and whether it was accepted; one JSON object per line.

Lines are only ever appended. Refused attempts and values that a control writes in every cycle are
limited like log lines, with the number of those left out, so that nobody can write the log full.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from thermojoint.live.publication import iso_time
from thermojoint.live.rate_limit import LineLimit
from thermojoint.live.secret import create_private

#: Its name in the folder of a service.
NAME = "audit.jsonl"
_LONGEST = 200


@dataclass(eq=False)
class Audit:
    """The audit log of a service.

    Attributes
    ----------
    path : Path
        The file that is written now; earlier ones beside it carry the time of their end.
    largest : int
        The next file begins when this one is so large, bytes.
    keep : float
        Earlier files are deleted after this time, s.
    """

    path: Path
    largest: int = 10_000_000
    keep: float = 365.0 * 86400.0
    _limit: LineLimit = field(default_factory=LineLimit)

    def accepted(self, who: str, origin: str, what: str, machine: str | None = None) -> None:
        """Write what somebody has done.

        Parameters
        ----------
        who : str
            Name of the user or the token; ``service`` or ``command`` for what nobody asked for by
            an interface.
        origin : str
            Interface and address, e.g. ``http 192.0.2.7``.
        what : str
            What it was.
        machine : str, optional

        Raises
        ------
        OSError
            The line cannot be written; the caller refuses what cannot be audited.
        """
        self._write(who, origin, what, machine, _outcome("accepted", 0))

    def written(self, who: str, origin: str, what: str, machine: str | None) -> None:
        """Write that somebody has written a value; as `accepted`, but limited."""
        left_out = self._limit.left_out((who, what), time.monotonic())
        if left_out is not None:
            self._write(who, origin, what, machine, _outcome("accepted", left_out))

    def refused(
        self, who: str, origin: str, what: str, why: str, machine: str | None = None
    ) -> None:
        """Write what somebody tried; parameters as of `accepted`, and why it was refused."""
        left_out = self._limit.left_out((origin, what), time.monotonic())
        if left_out is not None:
            outcome = _outcome("refused", left_out) | {"why": why}
            with suppress(OSError):
                self._write(who, origin, what, machine, outcome)

    def _write(
        self, who: str, origin: str, what: str, machine: str | None, outcome: dict[str, str | int]
    ) -> None:
        entry = {"time": iso_time(time.time()), "who": who[:_LONGEST], "from": origin, "what": what}
        line = json.dumps(entry | ({"machine": machine} if machine else {}) | outcome) + "\n"
        if self.path.exists() and self.path.stat().st_size + len(line) > self.largest:
            self._rotate()
        create_private(self.path)
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        try:
            os.write(handle, line.encode())
        finally:
            os.close(handle)

    def _rotate(self) -> None:
        """Begin a new file, and delete those that are too old."""
        stem = self.path.stem
        self.path.replace(
            self.path.with_name(f"{stem}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z.jsonl")
        )
        for path in self.path.parent.glob(f"{stem}-*.jsonl"):
            if time.time() - path.stat().st_mtime > self.keep:
                path.unlink(missing_ok=True)


def _outcome(word: str, left_out: int) -> dict[str, str | int]:
    return {"outcome": word} | ({"left_out_before": left_out} if left_out else {})
