"""Assignment of cases to workers, preferably with a condensation that the worker already has."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from fesim.batch.worker import KEPT, Outcome, Task


class Queue:
    """Cases still to be assigned, by condensation key.

    A worker stays with its condensation. When its cases are exhausted, it takes the unassigned
    condensation with the most cases; if all are assigned, it joins the one with the most cases
    left, unless its present workers would finish before the newcomer is set up.
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
        """Put the case of a lost worker back to the front of its queue."""
        self._waiting.setdefault(task.key, deque()).appendleft(task)

    def keep(self, workers: Iterable[str]) -> None:
        """Remove all other workers and their set-ups."""
        here = set(workers)
        self._at = {worker: keys for worker, keys in self._at.items() if worker in here}

    def learn(self, task: Task, outcome: Outcome) -> None:
        """Record the durations of a case and its condensation."""
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
