"""Clean-up after an interruption: temporary files and folders, child processes.

The command line ends at a signal without raising an exception (`thermojoint.cli.main`), because a
finaliser or a library written in C may lose one. No `finally` runs then; the functions registered
here do. Nothing is imported, so that the command line can load this module first.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

#: Registered functions, the oldest first; they belong to the process, as its signals do.
_open: list[Callable[[], object]] = []


class cleared_at_stop:
    """Register a function that cleans up if a signal ends the process within the block.

    Register it before there is anything to clean up: a signal may arrive at any time.

    Parameters
    ----------
    clear : callable
        Must be harmless if there is nothing to clean up.
    """

    def __init__(self, clear: Callable[[], object]) -> None:
        self._clear = clear

    def __enter__(self) -> None:
        _open.append(self._clear)

    def __exit__(self, *_: object) -> None:
        _open.remove(self._clear)


def clear_all() -> None:
    """Call the registered functions, the latest first, even if one fails."""
    while _open:
        try:
            _open.pop()()
        except Exception:  # the process ends, so nothing could handle it
            continue
