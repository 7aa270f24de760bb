"""Which case a worker gets next: one that shares its condensation, as long as that pays."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from fesim.batch.worker import KEPT, Outcome, Task


class Queue:
    """Cases still to be handed out, by condensation key.

    A worker stays with its condensation. When that one's cases are out it takes the condensation
    with the most cases that nobody works on; if all have somebody, it joins the one with the most
    left, unless those at it would be through sooner than the newcomer is set up.
    """

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._waiting: dict[str, deque[Task]] = {}
        self._at: dict[str, list[str]] = {}
        self._seconds: dict[str, float] = {}
        self._setup_seconds: dict[str, float] = {}
        for task in tasks:
            self._waiting.setdefault(task.key, deque()).append(task)

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def next_for(self, worker: str) -> Task | None:
        """Take the next case for a worker, or None if there is none for it now."""
        kept = self._at.setdefault(worker, [])
        for key in reversed(kept):
            if self._waiting.get(key):
                return self._take(worker, key)
        held = {key for keys in self._at.values() for key in keys[-1:]}
        left = sorted(
            (key for key, tasks in self._waiting.items() if tasks),
            key=lambda key: len(self._waiting[key]),
            reverse=True,
        )
        for key in [key for key in left if key not in held] or left:
            if key not in held or self._worth_joining(key):
                return self._take(worker, key)
        return None

    def give_back(self, task: Task) -> None:
        """Put a case back, first in its row: its worker is lost."""
        self._waiting.setdefault(task.key, deque()).appendleft(task)

    def keep(self, workers: Iterable[str]) -> None:
        """Forget every other worker and what it had in memory."""
        here = set(workers)
        self._at = {worker: keys for worker, keys in self._at.items() if worker in here}

    def learn(self, task: Task, outcome: Outcome) -> None:
        """Remember how long a case and its condensation took."""
        self._seconds[task.key] = outcome.seconds
        if outcome.setup_seconds:
            before = self._setup_seconds.get(task.key, 0.0)
            self._setup_seconds[task.key] = max(before, outcome.setup_seconds)

    def _take(self, worker: str, key: str) -> Task:
        kept = self._at[worker]
        if key in kept:
            kept.remove(key)
        kept.append(key)
        del kept[:-KEPT]
        return self._waiting[key].popleft()

    def _worth_joining(self, key: str) -> bool:
        if key not in self._setup_seconds:
            return True
        at_it = sum(keys[-1:] == [key] for keys in self._at.values())
        alone = len(self._waiting[key]) * self._seconds[key] / max(at_it, 1)
        return alone > self._setup_seconds[key]
