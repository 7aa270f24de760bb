"""The way into the command line: what may end a run, and the one line that says so.

A signal clears up and ends the process where it is, without an exception: a finaliser, or a library
written in C while it is imported, would lose one. So the handlers are installed before anything
else is imported, and nothing has to arrive anywhere.
"""

from __future__ import annotations

import os
import signal
import sys

from thermojoint.artefacts.unfinished import clear_all

#: Exit code of everything the user can mend.
BAD_INPUT = 2
#: What ends a run: Ctrl-C, `kill`, a terminal that is closed.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> None:
    """Run the command line; it ends in a result or in one line on standard error.

    Exit code 2 for errors that a user can mend; 128 and the signal's number after Ctrl-C (130),
    SIGTERM (143) and SIGHUP (129).
    """
    for number in ENDING:
        # Ignored in the background of a shell script, and by nohup.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    try:
        from thermojoint.cli.app import app

        app(prog_name="thermojoint")
    except Exception as error:
        if lines := _mendable(error):
            print("".join(map(_line, lines)), end="", file=sys.stderr, flush=True)
            raise SystemExit(BAD_INPUT) from None
        raise
    finally:
        # All is done: what remains is the interpreter's own end.
        _ignore()


def _mendable(error: Exception) -> list[str]:
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


def _stop(number: int, _: object) -> None:
    """Clear up and end at once."""
    _ignore()
    clear_all()
    how = "interrupted" if number == signal.SIGINT else "stopped by a signal"
    try:
        # Not by sys.stderr, which may be at work on another line.
        os.write(2, _line(f"{how}; no unfinished file is left").encode())
    finally:
        os._exit(128 + number)


def _ignore() -> None:
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def _line(message: str) -> str:
    return f"thermojoint: {' '.join(message.split())}\n"


if __name__ == "__main__":
    main()
