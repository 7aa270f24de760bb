"""Validation of calibration responses before any long computation.

Every check raises one line that says what is wrong, where, and what to do.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calibrate.drivable import check_alone
from calibrate.fictitious import WHERE, check_steps
from calibrate.source_thermal import make_geometry
from fesim.setup.structure import body_of_candidate
from thermojoint.artefacts import steps
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.response import axes_of, axes_that_move, displaced, probes_of
from thermojoint.models.sensors import ROLES

if TYPE_CHECKING:
    import xarray as xr

#: An axis with motion below this fraction of the largest displacement is left out.
STILL = 1e-3
#: Powers of a source that differ by more than this share of those of all sources are different.
SAME_POWER = 0.01


def candidates_in(response: xr.Dataset) -> tuple[list[str], list[str]]:
    """Return the candidates for the sensors around the source, and for those at the joint.

    They are those in the two boxes of candidates, if the case has two. Otherwise every probe is a
    candidate for a and b, and the half of them nearest to the contact elements for T1, T2 ...

    Raises
    ------
    InputError
        A response that was not simulated does not name its sensors.
    """
    try:
        case = json.loads(response.attrs["case"])
        boxes, named = case["candidates"], case["probes"]
    except (KeyError, ValueError, TypeError):
        missing = ", ".join(sorted(set(ROLES) - set(probes_of(response))))
        raise InputError(
            f"{WHERE}, reference: contains no case and no probe {missing}; name the sensors a, b, "
            "T1 and T2"
        ) from None
    if len(boxes) == 2:
        near_source, at_joint = (_inside(response, box, named) for box in boxes)
        return near_source, at_joint
    names = probes_of(response)
    if "contact_position" not in response:
        return names, []
    apart = response["probe_position"].to_numpy()[:, None] - response["contact_position"].to_numpy()
    nearest_first = np.argsort(np.linalg.norm(apart, axis=2).min(axis=1), kind="stable")
    return names, [names[i] for i in sorted(nearest_first[: (len(names) + 1) // 2])]


def _inside(
    response: xr.Dataset, box: Mapping[str, Any], named: Mapping[str, Mapping[str, Any]]
) -> list[str]:
    """Return the probes in a box without those of other bodies; `named` are those of the case."""
    position = 1e3 * response["probe_position"].to_numpy()
    low, high = np.array(box["low_mm"]) - 1e-6, np.array(box["high_mm"]) + 1e-6
    holds = ((position >= low) & (position <= high)).all(axis=1)
    inside = [probes_of(response)[index] for index in np.flatnonzero(holds)]

    def body_of(name: str) -> str | None:
        return named[name]["body"] if name in named else body_of_candidate(name)

    return [name for name in inside if body_of(name) in (None, box["body"])]


def check_responses(
    reference: xr.Dataset, others: Mapping[float, xr.Dataset], sources: int
) -> None:
    """Refuse responses that cannot be calibrated together, wherever the sensors are.

    Parameters
    ----------
    reference : xarray.Dataset
        Response to the reference step.
    others : mapping
        Heat input to the response to it.
    sources : int
        Number of fictitious sources; 0 if it is not given.

    Raises
    ------
    InputError
        They are not steps, not sampled evenly at the same times, or too few, something other than
        the heat input acted, the power of a source or the displaced point is another one, or the
        reference lacks the positions of its probes or its power.
    """
    check_steps(reference, others)
    check_alone(reference, f"{WHERE}, reference")
    for level, response in others.items():
        check_alone(response, f"{WHERE}, input {level:g}")
    steps.even_interval(steps.times(reference), f"{WHERE}, reference")
    if len(others) < max(1, sources):
        raise InputError(
            f"{WHERE}: {len(others)} beside the reference for {max(1, sources)} fictitious "
            "sources; give as many heat inputs as sources, or more"
        )
    if "probe_position" not in reference:
        raise InputError(
            f"{WHERE}, reference: variable 'probe_position' is missing; give the position of each "
            "probe in m"
        )
    reference_power(reference)
    for level, response in others.items():
        _check_powers(reference, response, f"{WHERE}, input {level:g}")
        _check_points(reference, response, f"{WHERE}, input {level:g}")


def _check_powers(reference: xr.Dataset, response: xr.Dataset, where: str) -> None:
    """Refuse a step whose sources have other powers at heat input 1 than those of the reference."""
    if "source_power" not in reference or "source_power" not in response:
        return
    base, power = (
        one["source_power"][-1].to_series() / float(one["heat_input"][-1])
        for one in (reference, response)
    )
    for name, given in base.items():
        now = power.get(name, 0.0)
        if abs(now - given) > SAME_POWER * base.sum():
            raise InputError(
                f"{where}: at heat input 1 source {name!r} has {now:.4g} W, in the reference "
                f"{given:.4g} W; record all steps on one machine"
            )


def _check_points(reference: xr.Dataset, response: xr.Dataset, where: str) -> None:
    """Refuse a step whose displacement is that of other points than in the reference."""
    base, points = (one.attrs.get("displacement_of") for one in (reference, response))
    if base is not None and points is not None and points != base:
        raise InputError(
            f"{where}: displacement of {points}, in the reference of {base}; record that of the "
            "same points in all steps"
        )


def check_probes(
    reference: xr.Dataset, others: Mapping[float, xr.Dataset], needed: Sequence[str]
) -> None:
    """Refuse responses in which a required probe of the reference is missing or elsewhere."""
    positions = reference["probe_position"]
    places = {name: positions.sel(probe=name).to_numpy().tolist() for name in needed}
    for level, response in others.items():
        known = probes_of(response)
        for probe in needed:
            if probe not in known:
                raise unknown_name("probe", probe, known, f"{WHERE}, input {level:g}")
        for probe, apart in displaced(response, places):
            raise InputError(
                f"{WHERE}, input {level:g}: probe {probe!r} is {1e3 * apart:.3g} mm from its place "
                "in the reference; record all steps with the same thermometers"
            )


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


def checked_distances(distances: Sequence[Sequence[float]], count: int) -> list[list[float]]:
    """Return r_ij, m, one row for each of `count` fictitious sources, one column for each sensor.

    Raises
    ------
    InputError
        Their number is wrong, or one is not positive.
    """
    if [len(row) for row in distances] != [count] * count:
        raise InputError(
            f"distances: give r_ij from source i to sensor T_j, {count} rows of {count}, in m"
        )
    return [[float(r) for r in row] for row in make_geometry(distances).distances]


def moving_axes(reference: xr.Dataset, others: Mapping[float, xr.Dataset]) -> list[str]:
    """Return the axes with motion, in the order of the reference; raises as `axes_that_move`."""
    return axes_that_move((reference, *others.values()), axes_of(reference), STILL, WHERE)
