"""Entry point of the command line: errors and signals end in one line on standard error.

A signal cleans up and ends the process at once, without an exception, which could be lost in a
finaliser or a library written in C. The handlers are therefore installed before anything else is
imported.
"""

from __future__ import annotations

import os
import signal
import sys
import warnings

from thermojoint.artefacts.unfinished import clear_all

#: Exit code for errors that the user can correct.
BAD_INPUT = 2
#: Signals that end a run: Ctrl-C, `kill`, a closed terminal.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> None:
    """Run the command line.

    Exit code 2 for errors that the user can correct; 128 plus the signal's number after Ctrl-C
    (130), SIGTERM (143) and SIGHUP (129).
    """
    for number in ENDING:
        # Ignored in the background of a shell script, and by nohup.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    try:
        from thermojoint.artefacts.process_start import prepare_process
        from thermojoint.cli.app import app

        prepare_process()
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: _warn(message)
            app(prog_name="thermojoint")
    except Exception as error:
        if lines := _correctable(error):
            print("".join(map(_line, lines)), end="", file=sys.stderr, flush=True)
            raise SystemExit(BAD_INPUT) from None
        raise
    finally:
        # Only the interpreter's own shutdown remains.
        _ignore()


def _warn(message: Warning | str) -> None:
    """Print a warning as the commands do."""
    print(f"warning: {message}", file=sys.stderr, flush=True)


def _correctable(error: Exception) -> list[str]:
    """Return a line for each mistake that the user can correct; none for a program error."""
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
    """Clean up and end the process."""
    _ignore()
    clear_all()
    how = "interrupted" if number == signal.SIGINT else "stopped by a signal"
    try:
        # Not sys.stderr, which may be writing another line.
        os.write(2, _line(f"{how}; no unfinished file is left").encode())
    finally:
        os._exit(128 + number)


def _ignore() -> None:
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def _line(message: str) -> str:
    return f"thermojoint: {' '.join(message.split())}\n"
