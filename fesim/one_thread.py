"""Restriction of linear algebra to one thread for small problems."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


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
