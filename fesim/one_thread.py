"""Restriction of linear algebra to one thread for small problems."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """Let the libraries of linear algebra use one thread: a march is many small dense products."""
    with _controller().limit(limits=1):
        yield


@contextmanager
def one_dense_thread() -> Iterator[None]:
    """Let NumPy's own library, OpenBLAS, use one thread, and leave a sparse solver's as they are.

    Its threads wait busily, and take the processor from the sparse factors between two products.
    """
    with _controller().select(internal_api="openblas").limit(limits=1):
        yield


@cache
def _controller() -> ThreadpoolController:
    """The loaded libraries are looked up once, which takes as long as a short march."""
    return ThreadpoolController()
