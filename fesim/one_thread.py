"""Restriction of linear algebra to one thread for small problems."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache

from threadpoolctl import ThreadpoolController

#: Number of contact elements from which on the matrices of a march exceed a processor's cache and
#: its products are limited by memory; with fewer, a second thread gains nothing.
MANY = 1_000


def threads_of_march(contacts: int) -> AbstractContextManager[None]:
    """Limit a march to one thread, unless it has many contact elements."""
    return one_thread() if contacts < MANY else nullcontext()


def threads_beside_solver(contacts: int) -> AbstractContextManager[None]:
    """Limit OpenBLAS to one thread beside a sparse solver, unless there are `MANY` elements."""
    return one_dense_thread() if contacts < MANY else nullcontext()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit the linear algebra libraries to one thread, for a march of small dense products."""
    with _controller().limit(limits=1):
        yield


@contextmanager
def one_dense_thread() -> Iterator[None]:
    """Limit OpenBLAS, NumPy's library, to one thread; a sparse solver's threads are unchanged.

    Its threads busy-wait between two products, and compete with those of the sparse solver.
    """
    with _controller().select(internal_api="openblas").limit(limits=1):
        yield


@cache
def _controller() -> ThreadpoolController:
    """Cached, as searching for the loaded libraries takes as long as a short march."""
    return ThreadpoolController()
