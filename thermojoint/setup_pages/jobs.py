"""Commands of the program, run one after the other in the background, with recorded output.

The record is a text file in the folder: the command lines as a person would type them, their
output, and the exit code at the end. The record of an interrupted step has no exit code.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from os import environ
from pathlib import Path
from typing import IO

from thermojoint.artefacts.errors import InputError

#: Time after SIGTERM until a command is killed, s.
PATIENCE_S = 5.0
#: Largest number of displayed characters of a record.
MOST_SHOWN = 20_000
_WRITTEN = re.compile(r"--(?:out|figure|json|draft|case|faces)=(.*)")
_READ = re.compile(r"--(?:mapping|settings|offsets|names)=(.*)|([^-].*)")
_END = re.compile(r"^exit code (-?\d+)$")

Command = Sequence[str]


@dataclass(frozen=True)
class Record:
    """Record of a step."""

    #: Commands without ``thermojoint``.
    commands: tuple[list[str], ...] = ()
    #: Command lines and their output, without the exit code.
    output: str = ""
    #: Exit code; None while the step runs, or if it was interrupted.
    code: int | None = None
    #: Time when the record was last written, s since 1970.
    ended: float = 0.0
    #: Start of its commands; in records of earlier versions their end, since only that is known.
    begun: float = 0.0

    @property
    def written(self) -> list[str]:
        """Names of the files that the commands write."""
        return _matched(self.commands, _WRITTEN)

    @property
    def read(self) -> list[str]:
        """Names of the files that the commands read and did not write themselves."""
        return [name for name in _matched(self.commands, _READ) if name not in self.written]


def _matched(commands: Sequence[Command], pattern: re.Pattern[str]) -> list[str]:
    found = [pattern.fullmatch(word) for words in commands for word in words[1:]]
    return list(dict.fromkeys(match[match.lastindex or 0] for match in found if match))


@dataclass(eq=False)
class _Run:
    """Running commands."""

    step: str
    thread: threading.Thread | None = None
    process: subprocess.Popen[bytes] | None = None
    cancelled: bool = False
    begun: float = field(default_factory=time.monotonic)


class Jobs:
    """Commands of the steps, one step at a time."""

    def __init__(self, folder: Path) -> None:
        #: Folder in which the commands run, and folder of their records.
        self.folder, self.records = folder, folder / ".thermojoint-setup"
        self._lock = threading.Lock()
        self._run: _Run | None = None
        self._begun: dict[str, float] = {}
        #: The command that continues when the pages end.
        self.detached: subprocess.Popen[bytes] | None = None

    @property
    def running(self) -> tuple[str, float] | None:
        """The running step, and the time since its start, s."""
        run = self._run
        return (run.step, time.monotonic() - run.begun) if run else None

    def check_free(self) -> None:
        """Refuse actions that need a command while a step runs; raises InputError."""
        if (run := self._run) is not None:
            raise InputError(f"{run.step}: still runs; wait for it, or cancel it")

    def start(self, step: str, *commands: Command) -> None:
        """Run commands until one fails.

        Raises
        ------
        InputError
            Another step runs.
        """
        with self._lock:
            self.check_free()
            self.records.mkdir(exist_ok=True)
            self._begun[step] = time.time()
            record = (self.records / f"{step}.log").open("wb", buffering=0)
            run = self._run = _Run(step)
            run.thread = threading.Thread(target=self._work, args=(run, record, commands))
            run.thread.start()

    def record(self, step: str) -> Record:
        """Return the record of a step; empty before its first run."""
        path = self.records / f"{step}.log"
        try:
            text, ended = path.read_text("utf-8", "replace"), path.stat().st_mtime
        except OSError:
            return Record()
        lines = text.splitlines()
        end = _END.match(lines[-1]) if lines else None
        output = "\n".join(lines[:-1] if end else lines)
        if len(output) > MOST_SHOWN:
            output = f"...\n{output[-MOST_SHOWN:]}"
        commands = tuple(
            shlex.split(line)[2:] for line in lines if line.startswith("$ thermojoint ")
        )
        begun = self._begun.get(step, ended)
        return Record(commands, output, int(end[1]) if end else None, ended, begun)

    def all_records(self) -> list[Record]:
        """Return the records of all steps."""
        return [self.record(path.stem) for path in self.records.glob("*.log")]

    def detach(self, name: str, words: Command) -> None:
        """Start a command that continues when the pages end; its output is appended to a record."""
        self.records.mkdir(exist_ok=True)
        with (self.records / f"{name}.log").open("ab", buffering=0) as output:
            self.detached = started(words, self.folder, output)

    def detached_output(self, name: str) -> str:
        """Return the last output lines of a detached command."""
        try:
            with (self.records / f"{name}.log").open("rb") as file:
                file.seek(max(0, file.seek(0, 2) - MOST_SHOWN))
                return file.read().decode("utf-8", "replace")
        except OSError:
            return ""

    def cancel(self) -> None:
        """Stop the running step; its commands leave no unfinished file."""
        with self._lock:
            run = self._run
            if run is None:
                return
            run.cancelled, process = True, run.process
            if process is not None:
                process.terminate()
                killer = threading.Timer(PATIENCE_S, _kill, [process])
                killer.daemon = True
                killer.start()

    def close(self) -> None:
        """Stop the running step, and wait for its end."""
        run = self._run
        self.cancel()
        if run is not None and run.thread is not None:
            run.thread.join()

    def _work(self, run: _Run, record: IO[bytes], commands: Sequence[Command]) -> None:
        code = 0
        try:
            with record:
                for words in commands:
                    record.write(f"$ {shlex.join(['thermojoint', *words])}\n".encode())
                    with self._lock:
                        if run.cancelled:
                            break
                        run.process = started(words, self.folder, record)
                    code = run.process.wait()
                    if code:
                        break
                said = "cancelled\n" if run.cancelled else ""
                record.write(f"{said}exit code {code or int(run.cancelled)}\n".encode())
        finally:
            # Even if the disk is full: the record then has no exit code.
            self._run = None


def started(words: Command, folder: Path, output: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start a command of the program in a folder.

    Ctrl-C in the terminal of the pages does not reach the command.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "thermojoint", *words],
        cwd=folder,
        env=environ | {"PYTHONUNBUFFERED": "1"},
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        with suppress(ProcessLookupError):
            process.kill()
