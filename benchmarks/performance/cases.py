"""The cases that are measured, and what several groups of rows need of them."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import xarray as xr

from benchmarks.study import case_file
from calibrate import chain
from calibrate.placement.fchs import with_roles
from fesim.cache import VARIABLE
from fesim.case.schema import Case, parse_case, read_case
from fesim.case.thermal_sections import StepInput
from thermojoint.artefacts.errors import InputError
from thermojoint.paper import inputs

REFERENCE = "step-1.0"


def reference_machine() -> Case:
    """Return the equal-heights machine with all its possible sensors."""
    return read_case(case_file("equal_heights"))


def reference_case(level: float = 3.0) -> Case:
    """Return the equal-heights machine with two sensors instead of its 238 candidates."""
    return with_two_sensors(reference_machine(), level)


def with_two_sensors(case: Case, level: float) -> Case:
    """Return a case with two sensors instead of its candidates, and a step of heat."""
    probes = {
        f"T{i}": {"position_mm": [625.0, height, 87.5], "body": "column"}
        for i, height in ((1, 450.0), (2, 700.0))
    }
    plain = case.model_dump() | {"candidates": [], "probes": probes}
    return Case.model_validate(plain | {"heat_input": StepInput(kind="step", level=level)})


def coarse_text() -> str:
    """Return the case file of the equal-heights machine on elements of 100 mm."""
    text = re.sub(r"joint_element_size_mm.*", "", case_file("equal_heights").read_text("utf-8"))
    return text.replace("size_mm = 50.0", "size_mm = 100.0")


def coarse_case() -> Case:
    """Return the equal-heights machine on elements of 100 mm, with two sensors."""
    return with_two_sensors(parse_case(coarse_text(), "coarse.toml", Path()), 3.0)


def with_elements(case: Case, size: float, joint_size: float | None) -> Case:
    """Return a case on other elements, mm; `joint_size` in and next to the joint."""
    sizes = {"element_size_mm": size, "joint_element_size_mm": joint_size}
    return case.model_copy(update={"structure": case.structure.model_copy(update=sizes)})


def with_contacts(case: Case, along: int, across: int) -> Case:
    """Return a case with other numbers of contact elements."""
    joints = {
        name: joint.model_copy(update={"along": along, "across": across})
        for name, joint in case.joints.items()
    }
    return case.model_copy(update={"joints": joints})


@contextmanager
def condensations(place: str) -> Iterator[None]:
    """Let set-ups keep their condensations in a folder, or nowhere if `place` is "off"."""
    with patch.dict(os.environ, {VARIABLE: place}):
        yield


@contextmanager
def fresh_condensations() -> Iterator[None]:
    """Let set-ups keep their condensations in a folder that is empty at first."""
    with TemporaryDirectory() as name, condensations(name):
        yield


@cache
def calibration_responses() -> dict[str, xr.Dataset]:
    """Return the responses that `thermojoint reproduce` calibrates with."""
    return inputs.simulate_inputs(reference_machine(), inputs.CALIBRATION)


def others(responses: dict[str, xr.Dataset]) -> dict[float, xr.Dataset]:
    """Return all but the reference, by heat input, as calibration takes them."""
    return {
        float(response["heat_input"][-1]): response
        for name, response in responses.items()
        if name != REFERENCE
    }


@cache
def calibrated() -> tuple[chain.Calibrated, dict[str, xr.Dataset]]:
    """Return the calibrated equal-heights machine, and the responses with their sensors named."""
    responses = calibration_responses()
    found = chain.calibrate_responses(responses[REFERENCE], others(responses))
    if found.placement is None:
        raise InputError("benchmarks: the equal-heights machine names its sensors; remove [probes]")
    roles = found.placement.roles
    return found, {name: with_roles(response, roles) for name, response in responses.items()}
