"""The way into the command line: what may end a run, and the one line that says so.

Nothing else is imported before the signals are taken, so Ctrl-C ends in one line from the first
import on. A signal raises `Stopped` wherever the program is. Some places lose an exception: a
finaliser, a library written in C while it is imported. So it is raised again and again until it has
arrived; never while the program clears up because of it.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

#: Exit code of everything the user can mend.
BAD_INPUT = 2
#: A stop that has not arrived is raised again after this time, s.
AGAIN_S = 0.02

#: The signals that came: they are the process's, like their handlers.
_came: list[int] = []


class Stopped(BaseException):
    """A signal asks the program to end; no library takes it for one of its own exceptions."""


def main() -> None:
    """Run the command line; it ends in a result or in one line on standard error.

    Exit code 2 for errors that a user can mend; 128 and the signal's number after Ctrl-C (130) and
    SIGTERM (143).
    """
    _came.clear()
    signal.signal(signal.SIGALRM, _raise_stop)
    for number in (signal.SIGINT, signal.SIGTERM):
        # Ignored in the background of a shell script, and by nohup.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    sys.excepthook, sys.unraisablehook = _excepthook, _unraisablehook
    try:
        from thermojoint.cli.app import app

        app()
    except SystemExit:
        raise
    except BaseException as error:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if _came:
            # Or what a library made of the stop.
            _end(128 + _came[0], _stopped())
        if lines := _mendable(error):
            _end(BAD_INPUT, *lines)
        raise
    finally:
        # All is done, or cleared up: what remains is the interpreter's own end.
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _mendable(error: BaseException) -> list[str]:
    """Return a line for each thing the user can mend; none if it is the program that is wrong."""
    from thermojoint.artefacts.errors import InputErrors, ThermojointError

    if isinstance(error, InputErrors):
        return str(error).splitlines()
    if isinstance(error, ThermojointError):
        return [str(error)]
    if isinstance(error, MemoryError):
        return [f"not enough memory ({error}); take larger elements or a shorter run"]
    if isinstance(error, OSError):
        return [f"{error.filename or 'file'}: {error.strerror or error}; choose another place"]
    return []


def _stop(number: int, frame: FrameType | None) -> None:
    """End with everything cleared up."""
    _came.append(number)
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
    _raise_stop(number, frame)


def _raise_stop(number: int, frame: FrameType | None) -> None:
    """Raise the stop, but not in the course of itself."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, Stopped):
            return
        error = error.__context__
    raise Stopped


def _excepthook(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """End where a library written in C would print a stop and go on: within its import."""
    if not isinstance(error, Stopped):
        sys.__excepthook__(kind, error, trace)
        return
    _say(_stopped())
    os._exit(128 + _came[0])


def _unraisablehook(found: UnraisableHookArgs) -> None:
    """Print no stop that came within a finaliser: it comes again."""
    if not isinstance(found.exc_value, Stopped):
        sys.__unraisablehook__(found)


def _stopped() -> str:
    how = "interrupted" if _came[0] == signal.SIGINT else "stopped by a signal"
    return f"{how}; no unfinished file is left"


def _end(code: int, *lines: str) -> NoReturn:
    for line in lines:
        _say(line)
    raise SystemExit(code) from None


def _say(message: str) -> None:
    print("thermojoint: " + " ".join(message.split()), file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
