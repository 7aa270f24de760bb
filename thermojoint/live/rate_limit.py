"""Rate limit of log lines: a few of each kind at once, then one a minute with a count."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

#: Number of lines of a kind written at once; time until the next one, s.
AT_ONCE, AGAIN_S = 5, 60.0
#: Number of remembered kinds; all further ones share the last.
_MOST = 20_000


@dataclass(eq=False)
class LineLimit:
    """Counts of lines by kind."""

    #: Kind to lines written in a row, time of the last one, lines omitted since.
    seen: dict[Hashable, list[float]] = field(default_factory=dict)

    def left_out(self, kind: Hashable, time: float) -> int | None:
        """Return the number of omitted lines of a kind before this one; None: omit it as well.

        The time, s, is by any clock.
        """
        seen = self._seen(kind)
        # After the clock was set back, counting starts anew.
        if not 0.0 <= time - seen[1] < AGAIN_S:
            seen[0] = 0.0
        elif seen[0] >= AT_ONCE:
            seen[2] += 1.0
            return None
        before = int(seen[2])
        seen[:] = [seen[0] + 1.0, time, 0.0]
        return before

    def leave_out(self, kind: Hashable, count: int) -> None:
        """Count lines of a kind as omitted, because they could not be written."""
        self._seen(kind)[2] += count

    def _seen(self, kind: Hashable) -> list[float]:
        if kind not in self.seen and len(self.seen) >= _MOST:
            kind = None
        return self.seen.setdefault(kind, [0.0, -AGAIN_S, 0.0])
