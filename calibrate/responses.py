"""Validation of calibration responses before any long computation.

Every check raises one line that says what is wrong, where, and what to do.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from calibrate.fictitious import check_steps
from calibrate.source_thermal import make_geometry
from thermojoint.artefacts import steps
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.response import axes_of, probes_of
from thermojoint.models.sensors import JOINT_SENSORS, ROLES

if TYPE_CHECKING:
    import xarray as xr

#: An axis with motion below this fraction of the largest displacement is left out.
STILL = 1e-3
#: Names of the responses in errors.
WHERE = "calibration responses"


def candidates_in(response: xr.Dataset) -> tuple[list[str], list[str]]:
    """Return the probes in the case's two candidate boxes: around the source, and at the joint.

    Raises
    ------
    InputError
        The response contains no case, or its case does not have two boxes.
    """
    try:
        boxes = json.loads(response.attrs["case"])["candidates"]
    except (KeyError, ValueError, TypeError):
        missing = ", ".join(sorted(set(ROLES) - set(probes_of(response))))
        raise InputError(
            f"{WHERE}, reference: contains no case and no probe {missing}; name the sensors a, b, "
            "T1 and T2"
        ) from None
    check_boxes(len(boxes))
    near_source, at_joint = (_inside(response, box["low_mm"], box["high_mm"]) for box in boxes)
    return near_source, at_joint


def check_boxes(count: int) -> None:
    """Refuse cases without exactly the two candidate boxes of the placement rule."""
    if count != 2:
        raise InputError(
            f"candidates: the placement rule needs two boxes, the first around the source, the "
            f"second at the joint; the case has {count}"
        )


def _inside(response: xr.Dataset, low_mm: Sequence[float], high_mm: Sequence[float]) -> list[str]:
    position = 1e3 * response["probe_position"].to_numpy()
    low, high = np.array(low_mm) - 1e-6, np.array(high_mm) + 1e-6
    holds = ((position >= low) & (position <= high)).all(axis=1)
    return [probes_of(response)[index] for index in np.flatnonzero(holds)]


def check_responses(reference: xr.Dataset, others: Mapping[float, xr.Dataset]) -> None:
    """Refuse responses that cannot be calibrated together, wherever the sensors are.

    Raises
    ------
    InputError
        They are not steps, not sampled evenly at the same times, or too few, or the reference lacks
        the positions of its probes or its power.
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
            f"{WHERE}, reference: variable 'probe_position' is missing; give the position of each "
            "probe in m"
        )
    reference_power(reference)


def check_probes(others: Mapping[float, xr.Dataset], needed: Sequence[str]) -> None:
    """Refuse responses that lack a required probe of the reference."""
    for level, response in others.items():
        known = probes_of(response)
        for probe in needed:
            if probe not in known:
                raise unknown_name("probe", probe, known, f"{WHERE}, input {level:g}")


def reference_power(response: xr.Dataset) -> float:
    """Return the heat at heat input 1 according to a response, W.

    Raises
    ------
    InputError
        It is not recorded.
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
        Their number is wrong, or one is not positive.
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
        Nothing moves along any axis.
    """
    axes = axes_of(reference)
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
