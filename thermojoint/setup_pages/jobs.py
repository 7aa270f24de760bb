"""Commands of the program run one after the other in the background, with their output on record.

The record is a text in the folder: the command lines as a person would type them, what they said,
and the exit code at the end. A step that was interrupted has none.
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

#: A command that does not end this long after SIGTERM is killed, s.
PATIENCE_S = 5.0
#: Most characters of a record that are shown.
MOST_SHOWN = 20_000
_WRITTEN = re.compile(r"--(?:out|figure|json|draft|case|faces)=(.*)")
_READ = re.compile(r"--(?:mapping|settings|offsets|names)=(.*)|([^-].*)")
_END = re.compile(r"^exit code (-?\d+)$")

Command = Sequence[str]


@dataclass(frozen=True)
class Record:
    """What is on record of a step."""

    #: Without ``thermojoint``.
    commands: tuple[list[str], ...] = ()
    #: Command lines and what they said, without the exit code.
    output: str = ""
    #: Exit code; None while it runs, or where it was interrupted.
    code: int | None = None
    #: When the record was last written, s since 1970.
    ended: float = 0.0
    #: When its commands began; of earlier pages the end, which is known alone.
    begun: float = 0.0

    @property
    def written(self) -> list[str]:
        """Names of the files that the commands write."""
        return _matched(self.commands, _WRITTEN)

    @property
    def read(self) -> list[str]:
        """Names of the files that they read, and did not write themselves."""
        return [name for name in _matched(self.commands, _READ) if name not in self.written]


def _matched(commands: Sequence[Command], pattern: re.Pattern[str]) -> list[str]:
    found = [pattern.fullmatch(word) for words in commands for word in words[1:]]
    return list(dict.fromkeys(match[match.lastindex or 0] for match in found if match))


@dataclass(eq=False)
class _Run:
    """Commands that run."""

    step: str
    thread: threading.Thread | None = None
    process: subprocess.Popen[bytes] | None = None
    cancelled: bool = False
    begun: float = field(default_factory=time.monotonic)


class Jobs:
    """Commands of the steps, one step at a time."""

    def __init__(self, folder: Path) -> None:
        #: Where the commands run, and where their records are.
        self.folder, self.records = folder, folder / ".thermojoint-setup"
        self._lock = threading.Lock()
        self._run: _Run | None = None
        self._begun: dict[str, float] = {}
        #: The command that goes on when the pages end.
        self.detached: subprocess.Popen[bytes] | None = None

    @property
    def running(self) -> tuple[str, float] | None:
        """The step that runs, and for how long, s."""
        run = self._run
        return (run.step, time.monotonic() - run.begun) if run else None

    def check_free(self) -> None:
        """Refuse to begin what needs a command while a step runs; raises InputError."""
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
        """Return what is on record of a step; empty before its first run."""
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
        """Return what is on record of every step."""
        return [self.record(path.stem) for path in self.records.glob("*.log")]

    def detach(self, name: str, words: Command) -> None:
        """Start a command that goes on when the pages end; what it says is appended to a record."""
        self.records.mkdir(exist_ok=True)
        with (self.records / f"{name}.log").open("ab", buffering=0) as output:
            self.detached = started(words, self.folder, output)

    def detached_output(self, name: str) -> str:
        """Return the last lines that a detached command has said."""
        try:
            with (self.records / f"{name}.log").open("rb") as file:
                file.seek(max(0, file.seek(0, 2) - MOST_SHOWN))
                return file.read().decode("utf-8", "replace")
        except OSError:
            return ""

    def cancel(self) -> None:
        """Stop what runs; its commands leave no unfinished file."""
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
        """Stop what runs, and wait for its end."""
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
            # Also where the disk is full: the record then has no exit code.
            self._run = None


def started(words: Command, folder: Path, output: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start a command of the program in a folder.

    A Ctrl-C in the terminal of the pages does not reach it.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "thermojoint.cli", *words],
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
