"""What a calibration takes: cases to simulate and responses, refused before any long work.

Every check ends in one line that says what is wrong, where, and what to do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from artefacts.errors import InputError, unknown_name
from calibrate import steps
from calibrate.fictitious import check_steps
from calibrate.linear import JOINT_SENSORS
from calibrate.source_thermal import make_geometry
from fesim.case import CandidatesSection, Case, step_count
from fesim.history import read_history
from fesim.loads import held_history
from fesim.simulate import case_in

if TYPE_CHECKING:
    import xarray as xr

ROLES = ("a", "b", *JOINT_SENSORS)
#: An axis along which nothing moves by more than this part of the largest displacement is left out.
STILL = 1e-3
#: What errors call the responses.
WHERE = "calibration responses"


def check_drivable(case: Case) -> None:
    """Refuse a case whose response to a heat input would not be that of the heat input alone.

    The deviation from proportionality, T(Q) - Q T(1), of whatever else warms the structure is
    (1 - Q) times its effect: it would be taken for the joint's.

    Raises
    ------
    InputError
        There is no source, a source has a heat input of its own, or the ambient or a held
        temperature is not that of the start.
    """
    if not case.sources:
        raise InputError("sources: nothing follows the heat input; add [sources.NAME]")
    for name, source in case.sources.items():
        if source.heat_input is not None:
            raise InputError(
                f"sources.{name}.heat_input: calibration drives all sources alike; leave it out"
            )
    times = case.march.step_s * np.arange(step_count(case.march) + 1, dtype=float)
    if case.ambient is not None:
        ambient = read_history(case.ambient.file, "ambient_degC")(times)
        if np.ptp(ambient) > 0.0:
            raise InputError("ambient: calibration needs a steady ambient; leave [ambient] out")
    for name, section in case.held_temperatures.items():
        if held_history(section)(times).any():
            raise InputError(
                f"held_temperatures.{name}: calibration needs the surface at the initial ambient; "
                "set rise_K = 0"
            )


def check_placeable(case: Case) -> None:
    """Refuse a case whose responses could not be calibrated.

    Raises
    ------
    InputError
        There is no joint, or neither are the sensors named nor are there candidates to choose from.
    """
    if not case.joints:
        raise InputError("joints: without a joint nothing is nonlinear; add [joints.NAME]")
    if not set(case.probes) >= set(ROLES):
        _two_boxes(case)


def _two_boxes(case: Case) -> tuple[CandidatesSection, CandidatesSection]:
    if len(case.candidates) != 2:
        raise InputError(
            f"candidates: the placement rule needs two boxes, the first around the source, the "
            f"second at the joint; the case has {len(case.candidates)}"
        )
    first, second = case.candidates
    return first, second


def candidates_in(response: xr.Dataset) -> tuple[list[str], list[str]]:
    """Return the probes in the case's two candidate boxes: around the source, and at the joint.

    Raises
    ------
    InputError
        The response carries no case, or its case has not two boxes.
    """
    missing = ", ".join(sorted(set(ROLES) - set(probes_of(response))))
    otherwise = f"and no probe {missing}; name the sensors a, b, T1 and T2"
    first, second = _two_boxes(case_in(response, f"{WHERE}, reference", otherwise))
    return _inside(response, first), _inside(response, second)


def _inside(response: xr.Dataset, box: CandidatesSection) -> list[str]:
    position = 1e3 * response["probe_position"].to_numpy()
    low, high = np.array(box.low_mm) - 1e-6, np.array(box.high_mm) + 1e-6
    holds = ((position >= low) & (position <= high)).all(axis=1)
    return [str(name) for name in response["probe"].to_numpy()[holds]]


def check_responses(reference: xr.Dataset, others: Mapping[float, xr.Dataset]) -> None:
    """Refuse responses that cannot be calibrated together, wherever the sensors are.

    Raises
    ------
    InputError
        They are no steps, are not sampled alike and evenly, are too few, or the reference says
        neither where its probes are nor how large its heat is.
    """
    check_steps(reference, others, WHERE)
    steps.even_interval(steps.times(reference), f"{WHERE}, reference")
    if len(others) < len(JOINT_SENSORS):
        raise InputError(
            f"{WHERE}: {len(others)} beside the reference for {len(JOINT_SENSORS)} fictitious "
            "sources; give as many heat inputs as sources, or more"
        )
    if "probe_position" not in reference:
        raise InputError(
            f"{WHERE}, reference: variable 'probe_position' is missing; give the place of each "
            "probe in m"
        )
    reference_power(reference)


def check_probes(others: Mapping[float, xr.Dataset], needed: Sequence[str]) -> None:
    """Refuse responses that lack a probe of the reference that is needed."""
    for level, response in others.items():
        known = probes_of(response)
        for probe in needed:
            if probe not in known:
                raise unknown_name("probe", probe, known, f"{WHERE}, input {level:g}")


def probes_of(response: xr.Dataset) -> list[str]:
    """Return the names of the probes of a response."""
    return [str(name) for name in response["probe"].to_numpy()]


def reference_power(response: xr.Dataset) -> float:
    """Return the heat at heat input 1 that a response states, W.

    Raises
    ------
    InputError
        It states none.
    """
    try:
        power = float(response.attrs["reference_power_W"])
    except (KeyError, ValueError, TypeError):
        power = math.nan
    if not 0.0 < power < math.inf:
        raise InputError(
            f"{WHERE}, reference: attribute 'reference_power_W' is missing or not positive; give "
            "the heat at heat input 1 in W"
        )
    return power


def checked_distances(distances: Sequence[Sequence[float]]) -> list[list[float]]:
    """Return r_ij, m, one row for each fictitious source, one column for each sensor.

    Raises
    ------
    InputError
        They are too few, too many or not positive.
    """
    count = len(JOINT_SENSORS)
    if [len(row) for row in distances] != [count] * count:
        raise InputError(
            f"distances: give r_ij from source i to sensor T_j, {count} rows of {count}, in m"
        )
    return [[float(r) for r in row] for row in make_geometry(distances).distances]


def moving_axes(reference: xr.Dataset, others: Mapping[float, xr.Dataset]) -> list[str]:
    """Return the axes along which something moves, in the order of the reference.

    Parameters
    ----------
    reference, others
        As in `check_responses`.

    Raises
    ------
    InputError
        Nothing moves.
    """
    axes = [str(name) for name in reference["axis"].to_numpy()]
    peaks = np.max(
        [
            np.abs(response["displacement"].sel(axis=axes).to_numpy()).max(axis=0)
            for response in (reference, *others.values())
        ],
        axis=0,
    )
    if not peaks.any():
        raise InputError(
            f"{WHERE}: the displacement is zero along every axis; record points that move"
        )
    return [axis for axis, peak in zip(axes, peaks, strict=True) if peak > STILL * peaks.max()]
