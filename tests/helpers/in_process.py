"""The command line within the process of the tests."""

import signal
import sys
from contextlib import contextmanager
from functools import partial

import pytest

from thermojoint import console
from thermojoint.cli import main as cli
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


def run(*arguments):
    """The exit code of `thermojoint` with these arguments."""
    with pytest.MonkeyPatch.context() as patch, undisturbed():
        patch.setattr(sys, "argv", ["thermojoint", *map(str, arguments)])
        # What a command prints must not depend on how busy the machine is.
        patch.setattr(console, "progress_lines", partial(console.progress_lines, first_s=3600.0))
        with pytest.raises(SystemExit) as stop:
            cli.main()
    return int(stop.value.code or 0)
