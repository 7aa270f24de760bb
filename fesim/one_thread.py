"""Restriction of linear algebra to one thread for small problems."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache

from threadpoolctl import ThreadpoolController

#: From so many contact elements on, the matrices of a march do not fit into a processor's cache,
#: and its products wait for the memory; with fewer, a second thread gains nothing.
MANY = 1_000


def threads_of_march(contacts: int) -> AbstractContextManager[None]:
    """Let a march use one thread, or all of them if it has many contact elements."""
    return one_thread() if contacts < MANY else nullcontext()


def threads_beside_solver(contacts: int) -> AbstractContextManager[None]:
    """Let OpenBLAS use one thread beside a sparse solver, or all if there are `MANY` elements."""
    return one_dense_thread() if contacts < MANY else nullcontext()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let the libraries of linear algebra use one thread, for a march of small dense products."""
    with _controller().limit(limits=1):
        yield


@contextmanager
def one_dense_thread() -> Iterator[None]:
    """Let OpenBLAS, NumPy's library, use one thread; a sparse solver's threads are unchanged.

    Its threads wait actively between two products, and compete with the sparse solver's.
    """
    with _controller().select(internal_api="openblas").limit(limits=1):
        yield


@cache
def _controller() -> ThreadpoolController:
    """The loaded libraries are looked up once, which takes as long as a short march."""
    return ThreadpoolController()
