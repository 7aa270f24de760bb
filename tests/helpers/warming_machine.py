"""A service whose machine warms up line by line, as a process that can be killed."""

import contextlib
import threading

from own_process import OwnProcess

from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly

#: Largest rate of the offsets, um/s.
RATE = 8.0
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
[sources.mill]
kind = "csv"
path = "mill.csv"
[machines.mill]
model = "m"
source = "mill"
"""


def prepare(place, model, further):
    """Its files in a folder; `further` are sections of its file, first keys of the machine."""
    write_assembly(assemble(model, 1.0, 7200.0), place / "model.json")
    (place / "offsets.toml").write_text(OFFSETS)
    (place / "service.toml").write_text(SERVICE + further)
    (place / "mill.csv").write_text("time_s,a_degC,b_degC,T1_degC,T2_degC,ambient_degC\n")


def started(place):
    """The service as a process of its own."""
    with (place / "service.log").open("a") as log:
        return OwnProcess("serve", place / "service.toml", stdout=log, stderr=log)


@contextlib.contextmanager
def warming_up(place, begins=0):
    """The machine is on, from a sample on."""
    ended = threading.Event()
    machine = threading.Thread(target=_warm_up, args=(place, ended, begins))
    machine.start()
    try:
        yield
    finally:
        ended.set()
        machine.join()


def _warm_up(place, ended, begins):
    for k in range(begins, begins + 10_000):
        with (place / "mill.csv").open("a") as file:
            file.write(f"{1.7e9 + k},{20 + 0.02 * k},20,20.5,21,20\n")
        if ended.wait(0.1):
            return
