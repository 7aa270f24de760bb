"""The page of the service does what it says: its file is the example, its commands run."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from live_parts import PATIENCE_S, free_port
from repository import ROOT

from thermojoint.live.archive import Archive

PAGE = ROOT / "docs" / "guide-service.md"
BLOCKS = re.findall(r"^```(\w+)([^\n]*)\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)


def test_the_file_of_the_page_is_the_examples():
    shown = {rest.strip(): content for _, rest, content in BLOCKS if "." in rest}
    assert shown == {
        "service.toml": (ROOT / "examples" / "live" / "service.toml").read_text("utf-8")
    }


@pytest.mark.long
@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
def test_every_command_of_the_page_works_and_a_kill_changes_nothing(tmp_path):
    for name in ("live", "measured_machine"):
        shutil.copytree(ROOT / "examples" / name, tmp_path / "examples" / name)
    port = free_port()
    folder = tmp_path / "examples" / "live"
    file = folder / "service.toml"
    file.write_text(file.read_text("utf-8").replace("8080", str(port)))
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }

    def shell(command, **options):
        command = command.replace("8080", str(port))
        # The program of these tests, wherever another one is installed.
        command = re.sub(r"^thermojoint ", "python -m thermojoint ", command)
        return subprocess.Popen(
            f"exec {command}" if options else command, shell=True, cwd=folder, env=environment,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip

    archive = Archive(folder / "state" / "history.sqlite")
    background = []
    try:
        for language, rest, content in BLOCKS:
            for command in content.strip().splitlines() if language == "sh" else ():
                if command.startswith("cd "):
                    continue
                if rest.strip() == "live":
                    background.append(shell(command, background=True))
                    continue
                if "curl" in command:
                    _await(lambda: _number(archive) > 50)
                done = shell(command)
                said = done.communicate(timeout=PATIENCE_S)[0]
                assert done.returncode == 0, command
        latest = json.loads(said)
        assert latest["machine"] == "mill"
        assert set(latest["displacement_um"]) == {"disp1", "disp3"}
        assert set(latest["offsets_um"]) == {"Z"}
        for one in background:
            os.kill(one.pid, signal.SIGKILL)
            one.wait()
        background += [shell("python machine.py", background=True)]
        background += [shell("thermojoint serve service.toml", background=True)]
        _await(lambda: _number(archive) > 1080 and _starts(archive) == 2)
        assert abs(time.time() - archive.latest("mill").time) < 60.0
        _await(lambda: _left(archive) < 2e-6)
        background[-1].send_signal(signal.SIGTERM)
        assert background[-1].wait(PATIENCE_S) == 0
    finally:
        for one in background:
            one.kill()
            one.wait()
    history = archive.history("mill", 0.0, 1e11, 10_000)
    np.testing.assert_array_equal(history.numbers, np.arange(1, len(history.numbers) + 1))
    assert not history.gaps
    assert float(np.abs(history.columns.displacement[:, 1]).max()) > 30e-6


def _number(archive):
    try:
        last = archive.latest("mill")
    except Exception:
        return 0
    return last.number if last else 0


def _left(archive):
    """What the offset leaves of the displacement, m; without it some 40 um."""
    last = archive.latest("mill")
    return abs(last.displacement[1] + last.offsets[0])


def _starts(archive):
    return sum(one.kind == "ready" for one in archive.events(None, 0.0, 1e11, 1000))


def _await(condition):
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("did not come about in time")
