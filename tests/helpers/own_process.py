"""The command line in a process of its own, forked from one that has loaded the libraries.

For what a command does, leaves behind and makes of signals. Where its start is what is tested, an
interpreter of its own runs it.
"""

import os
import sys
from functools import cache
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest


class Forked(ForkServerContext):
    """Processes forked from a server that has loaded the libraries; there is one, begun at need."""

    def Process(self, *arguments, **options):
        _begin_server()
        return super().Process(*arguments, **options)


FORKED = Forked()


@cache
def _begin_server():
    FORKED.set_forkserver_preload(["loaded_libraries"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)
        forkserver.ensure_running()


class OwnProcess:
    """`thermojoint` with these arguments, much like `subprocess.Popen` of it.

    What it says goes to files that are open; without them, where the tests say theirs.
    """

    def __init__(self, *arguments, stdin=0, stdout=1, stderr=2, cwd="."):
        streams = [
            Connection(os.dup(one if isinstance(one, int) else one.fileno()), writable=k > 0)
            for k, one in enumerate((stdin, stdout, stderr))
        ]
        words = [str(one) for one in arguments]
        told = (words, str(Path(cwd).absolute()), dict(os.environ), streams)
        self._process = FORKED.Process(target=_run, args=told)
        self._process.start()
        for one in streams:
            one.close()
        self.pid, self.kill = self._process.pid, self._process.kill

    def poll(self):
        return self._process.exitcode

    def wait(self, timeout=None):
        self._process.join(timeout)
        return self.poll()

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)


def _run(arguments, folder, variables, streams):
    from thermojoint.cli.main import main

    for number, one in enumerate(streams):
        os.dup2(one.fileno(), number)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    sys.stdin, sys.stdout, sys.stderr = open(0), open(1, "w"), open(2, "w", buffering=1)  # noqa: SIM115
    sys.argv = ["thermojoint", *arguments]
    main()
