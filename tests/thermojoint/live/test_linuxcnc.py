"""LinuxCNC drives its axes by the offsets of the service: a real control, kills on each side."""

import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from linuxcnc_control import control, needs_linuxcnc
from live_parts import free_port
from repository import ROOT

from thermojoint.live.archive import Archive
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly

RATE = 8.0
#: What a late loop of the component makes up for, and one step.
BURST_S, STEP_UM = 0.2, 0.11
OFFSETS = f"""
rate_um_s = {RATE}
oldest_s = 1e6
recover_s = 0.0
freeze_s = 1.0
unusable = []
[axes.Z]
follows = "x"
"""
SERVICE = """
folder = "state"
behind_s = 1e12
[models.m]
file = "model.json"
offsets = "offsets.toml"
[machines.mill]
model = "m"
source = "mill"
[sources.mill]
kind = "csv"
path = "mill.csv"
[http]
port = {port}
security = "none"
"""


PAGE = (ROOT / "docs" / "guide-linuxcnc.md").read_text("utf-8")
BLOCKS = dict(re.findall(r"^```(\w+)[^\n]*\n(.*?)^```", PAGE, re.M | re.S))
COMMANDS = re.findall(r"^thermojoint (.*)$", PAGE, re.M)


@pytest.fixture
def cnc(hand_made_model):
    """A control, and in its folder the files of the service."""
    with control() as made:
        place = made.folder
        write_assembly(assemble(hand_made_model, 1.0, 7200.0), place / "model.json")
        (place / "offsets.toml").write_text(OFFSETS)
        text = SERVICE.format(port=free_port()) + BLOCKS["toml"]
        (place / "service.toml").write_text(text)
        (place / "mill.csv").write_text("time_s,a_degC,b_degC,T1_degC,T2_degC,ambient_degC\n")
        yield made


def warm_up(place, ended):
    for k in range(10_000):
        with (place / "mill.csv").open("a") as file:
            file.write(f"{1.7e9 + k},{20 + 0.02 * k},20,20.5,21,20\n")
        if ended.wait(0.1):
            return


def started(place):
    return subprocess.Popen(
        [sys.executable, "-m", "thermojoint.cli", "serve", str(place / "service.toml")],
        cwd=ROOT, stdout=(place / "service.log").open("a"), stderr=subprocess.STDOUT,
    )  # fmt: skip


def follow_the_page(place, command):
    for line in COMMANDS:
        words, _, kept = line.partition(" > ")
        code, told, said = command(*shlex.split(words))
        assert code == 0, said
        if kept:
            (place / kept).write_text(told)
        if "--token" in words and "--write" not in words:
            assert "would write" in told
            assert not (place / "thermojoint.hal").exists()


@needs_linuxcnc
def test_a_control_follows_returns_when_the_service_is_killed_and_follows_again(
    cnc, command, monkeypatch
):
    place, ended = cnc.folder, threading.Event()
    monkeypatch.chdir(place)
    follow_the_page(place, command)
    archive = Archive(place / "state" / "history.sqlite")
    machine = threading.Thread(target=warm_up, args=(place, ended))
    machine.start()
    service = started(place)
    try:
        cnc.start()

        def asked():
            """The offset that the service has told last, um."""
            return 1e6 * archive.latest("mill").offsets[0]

        def follows():
            return abs(cnc.offset()) > 10.0 and abs(cnc.offset() - asked()) < 2.0

        cnc.until(follows)
        os.kill(service.pid, signal.SIGKILL)
        cnc.until(lambda: abs(cnc.offset()) < 0.05)
        service = started(place)
        cnc.until(follows)
        line = (cnc.folder / "thermojoint.hal").read_text().splitlines()[1]
        os.kill(cnc.pid("thermojoint"), signal.SIGKILL)
        time.sleep(0.3)
        held = cnc.offset()
        time.sleep(0.5)
        assert cnc.offset() == pytest.approx(held, abs=0.01)
        cnc.run(line.split()[3:])
        cnc.until(follows)
        record = cnc.record()
        # A control that is switched off forgets the offset, and is asked for it anew.
        (cnc.folder / "off").touch()
        cnc.until(lambda: not (cnc.folder / "off").exists())
        cnc.until(lambda: abs(cnc.offset()) < 1.0)
        cnc.until(follows)
    finally:
        service.kill()
        service.wait()
        ended.set()
        machine.join()
    before, after, x, z, offset = record.T
    # The program moves X all the time, and Z only by what is asked.
    assert min(np.ptp(part) for part in np.array_split(x, 5)) > 5000.0
    np.testing.assert_allclose(z, offset, atol=2.0)
    for lag_s in (0.0, 0.5, 2.0):
        later = np.searchsorted(before, before + lag_s, side="right").clip(max=len(z) - 1)
        most = RATE * (after[later] - before + BURST_S) + STEP_UM
        assert (np.abs(z[later] - z) <= most).all()
