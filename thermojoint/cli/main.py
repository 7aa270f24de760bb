"""The way into the command line: what may end a run, and the one line that says so.

Nothing else is imported before the signals are taken, so Ctrl-C ends in one line from the first
import on.
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
#: A signal that came where nothing can be raised (in a finaliser) comes again after this time, s.
AGAIN_S = 0.01


class Stopped(BaseException):
    """A signal asks the program to end; no library takes it for one of its own exceptions."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def main() -> None:
    """Run the command line; it ends in a result or in one line on standard error.

    Exit code 2 for errors that a user can mend; 128 and the signal's number after Ctrl-C (130) and
    SIGTERM (143).
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        # Ignored in the background of a shell script, and by nohup.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    sys.excepthook, sys.unraisablehook = _excepthook, _unraisablehook
    try:
        _run()
    except Stopped as stop:
        _say(_line(stop))
        raise SystemExit(128 + stop.number) from None
    finally:
        # All is done, or cleared up: what remains is the interpreter's own end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run() -> None:
    from artefacts.errors import ThermojointError
    from thermojoint.cli.app import app

    try:
        app()
    except ThermojointError as error:
        _fail(str(error))
    except MemoryError as error:
        _fail(f"not enough memory ({error}); take larger elements or a shorter run")
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}; choose another place")


def _stop(number: int, frame: FrameType | None) -> None:
    """End with everything cleared up; a second signal does not disturb that."""
    if not _holds_stop(sys.exc_info()[1]):
        raise Stopped(number)


def _holds_stop(error: BaseException | None) -> bool:
    """Say whether an exception, or one that it came in the course of, is a stop."""
    while error is not None:
        if isinstance(error, Stopped):
            return True
        error = error.__context__
    return False


def _excepthook(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """End where a library written in C would print a stop and go on: within its import."""
    if not isinstance(error, Stopped):
        sys.__excepthook__(kind, error, trace)
        return
    _say(_line(error))
    os._exit(128 + error.number)


def _unraisablehook(found: UnraisableHookArgs) -> None:
    """Let a stop that came within a finaliser come again: there it is lost."""
    if not isinstance(found.exc_value, Stopped):
        sys.__unraisablehook__(found)
        return
    number = found.exc_value.number
    signal.signal(signal.SIGALRM, lambda alarm, frame: _stop(number, frame))
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)


def _line(stop: Stopped) -> str:
    how = "interrupted" if stop.number == signal.SIGINT else "stopped by a signal"
    return f"{how}; no unfinished file is left"


def _fail(message: str) -> NoReturn:
    _say(message)
    raise SystemExit(BAD_INPUT)


def _say(message: str) -> None:
    print("thermojoint: " + " ".join(message.split()), file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
