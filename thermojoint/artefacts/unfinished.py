"""Clean-up after an interruption: temporary files and folders, child processes.

The command line ends at a signal without raising an exception (`thermojoint.cli.main`), because a
finaliser or a library written in C may lose one. No `finally` runs then; what is registered here
does. Nothing is imported, so that the command line has it before its first import.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

#: What is still to be cleared, the oldest first; it belongs to the process, as its signals do.
_open: list[Callable[[], object]] = []


class cleared_at_stop:
    """Register what clears up after the block if a signal ends the process within it.

    Register it before there is anything to clear: a signal may come between any two instructions.

    Parameters
    ----------
    clear : callable
        It must do no harm where there is nothing to clear.
    """

    def __init__(self, clear: Callable[[], object]) -> None:
        self._clear = clear

    def __enter__(self) -> None:
        _open.append(self._clear)

    def __exit__(self, *_: object) -> None:
        _open.remove(self._clear)


def clear_all() -> None:
    """Clear up, the latest first; what fails keeps nothing else from being cleared."""
    while _open:
        try:
            _open.pop()()
        except Exception:  # the process ends: there is nobody to hand it to
            continue
