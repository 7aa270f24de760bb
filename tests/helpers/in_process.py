"""The command line within the process of the tests."""

import signal
from contextlib import contextmanager

from thermojoint.cli.main import ENDING


@contextmanager
def undisturbed():
    """Give back, after the block, what the command line takes of the process."""
    handlers = {number: signal.getsignal(number) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
