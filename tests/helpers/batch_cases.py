"""Studies of the coarse reference machine, short and with few probes, for the tests of batches."""

import json
import re
from collections import Counter
from importlib.resources import files

from fesim.batch.study import read_study

PROBES = "".join(
    f'[probes.{name}]\nposition_mm = {place}\nbody = "column"\n'
    for name, place in (("T1", [625.0, 450.0, 87.5]), ("T2", [625.0, 700.0, 87.5]))
)


def case_text(minutes):
    """The coarse machine for some minutes, as TOML."""
    text = files("thermojoint").joinpath("cases/equal_heights.toml").read_text("utf-8")
    text = re.sub(r"joint_element_size_mm.*", "", text).replace("size_mm = 50.0", "size_mm = 100.0")
    text = text.replace("duration_min = 35.0", f'duration_min = {minutes}\nthermal = "full"')
    return text[: text.index("# The sensors a, b")] + PROBES


def write_study(folder, varied, minutes=2.0):
    """Write the machine and a study of it; give the study's path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.toml").write_text(case_text(minutes))
    path = folder / "study.toml"
    path.write_text(f'case = "machine.toml"\n{varied}')
    return path


def grid(path, *values):
    return f'[[grid]]\npath = "{path}"\nvalues = {json.dumps(values)}\n'


def levels(count):
    """So many heat inputs: cases that share one condensation."""
    return grid("heat_input.level", *(0.5 + 0.25 * number for number in range(count)))


def study_in(folder, varied, minutes=2.0):
    return read_study(write_study(folder, varied, minutes))


def tally(folder):
    """How often each case was started, done, lost, ... by the journal."""
    events = {}
    for line in (folder / "journal.jsonl").read_text().splitlines():
        entry = json.loads(line)
        events.setdefault(entry["event"], Counter())[entry["case"]] += 1
    return events
