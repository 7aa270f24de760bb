"""Descriptors: connections leave some for the files of the service."""

from __future__ import annotations

import resource

#: What no connection takes: store, readers, certificates, answers from the history.
RESERVE = 64


def raise_limit() -> None:
    """Let the process have as many descriptors as it may."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def is_spare(descriptor: int) -> bool:
    """Say whether a new connection leaves the reserve; the lowest free number is taken first."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return soft == resource.RLIM_INFINITY or descriptor < soft - RESERVE
