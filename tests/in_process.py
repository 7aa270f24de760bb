"""The command line within the process of the tests."""

import signal
import sys
from contextlib import contextmanager


@contextmanager
def undisturbed():
    """Give back, after the block, what the command line takes of the process."""
    taken = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    handlers = {number: signal.getsignal(number) for number in taken}
    hooks = sys.excepthook, sys.unraisablehook
    try:
        yield
    finally:
        sys.excepthook, sys.unraisablehook = hooks
        for number, handler in handlers.items():
            signal.signal(number, handler)
