"""What every study needs: shipped cases, options, results as JSON, the service as a process."""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from thermojoint.artefacts.files import write_text

ROOT = Path(__file__).parents[1]
#: A log of a machine that was measured.
MEASURED_LOG = ROOT / "examples" / "measured_machine" / "learned.csv"


def case_file(name: str) -> Path:
    """Return the file of a shipped case."""
    return ROOT / "thermojoint" / "cases" / f"{name}.toml"


def case_data(name: str) -> dict[str, Any]:
    """Return the content of a shipped case, to be changed."""
    return tomllib.loads(case_file(name).read_text("utf-8"))


def coarse_machine_data(size: float = 100.0) -> dict[str, Any]:
    """Return the equal-heights machine with elements of one size, mm, and one thermometer."""
    data = case_data("equal_heights")
    data["structure"] = {"kind": "box_milling_machine", "element_size_mm": size}
    data["candidates"] = []
    data["probes"] = {"T1": {"position_mm": [625.0, 450.0, 87.5], "body": "column"}}
    return data


def options_of(doc: str | None, out: str | None = None) -> argparse.ArgumentParser:
    """Return a parser that is described by a module's first line; `out` is where JSON goes."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    if out is not None:
        parser.add_argument("--out", type=Path, default=Path(out), help="JSON to write")
    return parser


def write_json(path: Path, content: Any) -> None:
    """Write what a study found."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def write_rows(rows: Iterable[dict[str, Any]], out: Path) -> list[dict[str, Any]]:
    """Print rows as they come, and return them; the file has all of them after each."""
    found: list[dict[str, Any]] = []
    for row in rows:
        print(json.dumps(row), flush=True)
        found.append(row)
        write_json(out, found)
    return found


def free_port() -> int:
    """Return a free port of the loopback interface."""
    with socket.create_server(("127.0.0.1", 0)) as one:
        return int(one.getsockname()[1])


def command(*words: str | Path) -> list[str]:
    """Return the line of a command of the program."""
    return [sys.executable, "-m", "thermojoint", *map(str, words)]


def learn(model: Path, *displacements: str) -> None:
    """Learn a model of the measured machine."""
    wanted = [word for name in displacements for word in ("--displacement", name)]
    line = command("learn", MEASURED_LOG, *wanted, "--out", model)
    subprocess.run(line, check=True, capture_output=True)


def service(settings: Path, log: Path, before: tuple[str, ...] = ()) -> subprocess.Popen[bytes]:
    """Start a service in a process of its own; its log is appended to a file."""
    line = [*before, *command("serve", settings)]
    with log.open("ab") as errors:
        return subprocess.Popen(line, stderr=errors, env=os.environ | {"PYTHONPATH": str(ROOT)})


def wait_for(event: str, process: subprocess.Popen[bytes], log: Path, count: int = 1) -> None:
    """Wait until a service's log has an event so often; end if the service has, or takes long."""
    end = time.monotonic() + 300.0
    while log.read_bytes().count(f"event={event}".encode()) < count:
        if process.poll() is not None or time.monotonic() > end:
            sys.exit(log.read_text()[-2000:])
        time.sleep(0.1)
