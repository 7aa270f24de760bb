"""Machine code that several processes of the tests need is made by one of them.

Numba looks into its folder before it compiles, and writes there afterwards. Of processes that begin
at the same time all would compile the same; here the others wait, and read what the first has made.
"""

import fcntl
import os
from pathlib import Path

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from repository import TOP

_compile = Dispatcher.compile


def compile_once():
    """Let no two processes of a run compile the same function at the same time."""
    # Tests may take the folder elsewhere or away.
    folder = Path(os.environ["THERMOJOINT_CACHE"])
    begun = set()

    def alone(dispatcher, signature):
        function = dispatcher.py_func
        name = f"{function.__module__}.{function.__qualname__}"
        if name in begun or name.partition(".")[0] not in TOP or not folder.is_dir():
            return _compile(dispatcher, signature)
        # Numba's own lock first, in every thread: otherwise two of them could wait for each other.
        with global_compiler_lock, (folder / f"{name}.lock").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            begun.add(name)
            try:
                return _compile(dispatcher, signature)
            finally:
                begun.remove(name)

    Dispatcher.compile = alone
