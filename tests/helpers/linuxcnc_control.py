"""A simulated LinuxCNC without a screen: it runs a program, and records what it commands."""

import contextlib
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from live_parts import PATIENCE_S

needs_linuxcnc = pytest.mark.skipif(
    not Path("/usr/bin/linuxcnc").exists(), reason="needs linuxcnc-uspace: .ci/packages"
)
#: A control has the programs of its system, not those of these tests.
ENVIRONMENT = {"PATH": "/usr/bin:/bin"}
_NOBODY = 65534
_AXIS = "MAX_VELOCITY = 50\nMAX_ACCELERATION = 500\n"
INI = f"""\
[EMC]
VERSION = 1.1
[DISPLAY]
DISPLAY = ./play.py
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = sim.var
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
[EMCMOT]
EMCMOT = motmod
SERVO_PERIOD = 1000000
[HAL]
HALFILE = LIB:basic_sim.tcl
[TRAJ]
COORDINATES = XYZ
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
[KINS]
JOINTS = 3
KINEMATICS = trivkins coordinates=XYZ
[AXIS_X]
{_AXIS}[AXIS_Y]
{_AXIS}[AXIS_Z]
OFFSET_AV_RATIO = 0.1
{_AXIS}""" + "".join(f"[JOINT_{k}]\nTYPE = LINEAR\nHOME_SEQUENCE = 0\n{_AXIS}" for k in range(3))
PROGRAM = """\
G21 G90 G0 Z0
o100 while [1]
  G1 X10 F2000
  G1 X0
o100 endwhile
M2
"""
#: Plays the operator: homes, starts the program, writes down what is commanded every 10 ms.
OPERATOR = """\
#!/usr/bin/python3
import os, time
import hal, linuxcnc
recorder = hal.component("recorder")
recorder.ready()
command, status = linuxcnc.command(), linuxcnc.stat()
def start():
    while not hal.get_value("motion.motion-enabled"):
        command.state(linuxcnc.STATE_ESTOP_RESET)
        command.wait_complete()
        command.state(linuxcnc.STATE_ON)
        command.wait_complete()
        time.sleep(0.2)
    if not hal.get_value("motion.is-all-homed"):
        command.mode(linuxcnc.MODE_MANUAL)
        command.wait_complete()
        command.home(-1)
    while not hal.get_value("motion.is-all-homed"):
        time.sleep(0.1)
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    command.program_open(os.path.abspath("program.ngc"))
    command.auto(linuxcnc.AUTO_RUN, 0)
time.sleep(1.0)
start()
with open("record.csv", "w", buffering=1) as record:
    while not os.path.exists("stop"):
        if os.path.exists("off"):
            command.state(linuxcnc.STATE_OFF)
            command.wait_complete()
            os.remove("off")
            start()
        before = time.monotonic()
        x, z = (1e3 * hal.get_value(f"joint.{k}.pos-cmd") for k in (0, 2))
        offset = 1e3 * hal.get_value("axis.z.eoffset")
        asked = 0.1 * hal.get_value("axis.z.eoffset-counts")
        times = f"{before:.4f},{time.monotonic():.4f}"
        record.write(f"{times},{x:.4f},{z:.4f},{offset:.4f},{asked:.4f}\\n")
        time.sleep(0.01)
"""


class Control:
    """A control in a folder of its own, and the user that it runs as."""

    def __init__(self, folder):
        self.folder, self.process = folder, None
        self.user = {"user": _NOBODY, "group": _NOBODY} if os.geteuid() == 0 else {}

    def start(self):
        """With the files in its folder."""
        for path in (self.folder, *self.folder.glob("*.*")):
            if self.user:
                os.chown(path, _NOBODY, _NOBODY)
        self.process = self.run(["linuxcnc", "-r", "mill.ini"])

    def run(self, words):
        """Run a program as the control's user."""
        log = (self.folder / "log.txt").open("a")
        environment = ENVIRONMENT | {"HOME": str(self.folder)}
        return subprocess.Popen(
            words, cwd=self.folder, env=environment, stdout=log, stderr=log, **self.user
        )

    def pin(self, name):
        """Value of a pin that is a whole number."""
        got = subprocess.run(
            ["/usr/bin/halcmd", "getp", name], capture_output=True, text=True,
            env=ENVIRONMENT, **self.user,
        )  # fmt: skip
        return int(got.stdout)

    def record(self):
        """Times before and after in s; X, Z, the offset of Z, and that asked for, in um."""
        path = self.folder / "record.csv"
        text = path.read_text() if path.exists() else ""
        rows = [line.split(",") for line in text.rpartition("\n")[0].splitlines()]
        return np.array(rows, dtype=float).reshape(-1, 6)

    def offset(self):
        """The newest one, um; NaN before the first."""
        record = self.record()
        return record[-1, 4] if len(record) else np.nan

    def until(self, condition, patience=PATIENCE_S):
        """Wait until something holds."""
        end = time.monotonic() + patience
        while time.monotonic() < end:
            if condition():
                return
            if self.process.poll() is not None:
                break
            time.sleep(0.05)
        raise AssertionError((self.folder / "log.txt").read_text()[-2000:])

    def stop(self):
        """Let the operator leave."""
        (self.folder / "stop").touch()
        self.process.wait(PATIENCE_S)


@contextlib.contextmanager
def control():
    """A control that is not started yet; its folder is one that its user can enter."""
    folder = Path(tempfile.mkdtemp(prefix="linuxcnc-", dir="/tmp"))
    folder.chmod(0o755)
    (folder / "mill.ini").write_text(INI)
    (folder / "program.ngc").write_text(PROGRAM)
    (folder / "play.py").write_text(OPERATOR)
    (folder / "play.py").chmod(0o755)
    made = Control(folder)
    try:
        yield made
    finally:
        if made.process is not None:
            made.stop()
        shutil.rmtree(folder)
