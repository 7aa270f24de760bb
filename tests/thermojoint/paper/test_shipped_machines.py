"""Every shipped machine with a source and a joint calibrates, whatever its size and its sensors."""

import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from repository import ROOT
from short_runs import FEW_PAIRS

from calibrate import chain
from estimator.fchs.judging import validate
from fesim.case.schema import parse_case
from fesim.setup.machine import set_up
from fesim.setup.structure import build_structure
from thermojoint.models.sensors import roles_in
from thermojoint.paper.candidates import with_candidates
from thermojoint.paper.inputs import StepInput, simulate_inputs

pytestmark = pytest.mark.long

CASES = Path(str(files("thermojoint").joinpath("cases")))
FLANGE = ROOT / "examples" / "bolted_flange" / "case.toml"
#: Nothing is calibrated on a machine that moves so far.
SOURCED = [
    path
    for path in sorted(CASES.glob("*.toml"))
    if "[sources." in (text := path.read_text("utf-8")) and "[axes." not in text
]


def coarse(path):
    """A machine on a coarse mesh, driven by its heat input alone, in steps of half a minute."""
    text = path.read_text("utf-8")
    for pattern, new in (
        (r"joint_element_size_mm.*", ""),
        (r"element_size_mm = .*", "element_size_mm = 125.0"),
        (r"step_s = .*", "step_s = 30.0"),
        (r"duration_min = .*", "duration_min = 60.0"),
        (r"\nheat_input = .*", ""),
        (r"\[ambient\]\nfile = .*", ""),
        (r"(?s)\[heat_input\]\n.*?\n\n", ""),
        (r"(?s)\[\[candidates\]\].*?\n\n|\[\[candidates\]\].*", ""),
    ):
        text = re.sub(pattern, new, text)
    text = text.replace("[march]", '[heat_input]\nkind = "step"\nlevel = 1.0\n\n[march]')
    return parse_case(text, path.name, path.parent)


def machine(path):
    return coarse(path).model_dump_json(include={"structure", "sources", "joints"})


#: One case of each machine: what heats it in time and where it is read are replaced or no matter.
#: That of the paper is calibrated in `test_study`.
MACHINES = {machine(path): path for path in [*SOURCED, FLANGE]}
del MACHINES[machine(CASES / "reference.toml")]


@pytest.mark.parametrize("path", MACHINES.values(), ids=lambda path: path.parent.name + path.stem)
def test_a_shipped_machine_calibrates_with_sensors_of_its_own(path, few_starts):
    case = coarse(path)
    case = with_candidates(case, build_structure(case))
    heats = {level: StepInput(kind="step", level=level) for level in (0.5, 1.0, 1.5, 2.0)}
    responses = simulate_inputs(case, heats, setup=set_up(case))
    unseen, reference = responses.pop(1.5), responses.pop(1.0)
    model = chain.calibrate_responses(reference, responses, rule=FEW_PAIRS).model
    judged = validate(unseen, model, roles=roles_in(unseen, model)).rows
    error = {(row["estimator"], row["axis"]): row["max_abs_error_um"] for row in judged}
    largest = np.max([error["none", axis] for axis in model.linear.deformation])
    for axis in model.linear.deformation:
        assert error["fchs", axis] < max(error["linear", axis], 0.02 * largest)
