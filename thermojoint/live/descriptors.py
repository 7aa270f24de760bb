"""File descriptors: connections leave some for the files of the service."""

from __future__ import annotations

import resource

#: Descriptors not used by connections: store, readers, certificates, queries of the history.
RESERVE = 64


def raise_limit() -> None:
    """Raise the process's limit of descriptors to its maximum."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def leaves_reserve(descriptor: int) -> bool:
    """Return whether a new connection leaves the reserve; the lowest free number is used first."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return soft == resource.RLIM_INFINITY or descriptor < soft - RESERVE
