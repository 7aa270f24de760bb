"""Linear algebra by one thread: a step of a march is many small dense products."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """Let the libraries of linear algebra use one thread: more would only wait for each other."""
    with _controller().limit(limits=1):
        yield


@cache
def _controller() -> ThreadpoolController:
    """What is loaded is looked up once, which takes as long as a short march."""
    return ThreadpoolController()
