"""Summary of a simulated response: solver residuals and settling of the joint's pressure."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fesim.batch.summary import taken_steps
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MEGA, MILLI
from thermojoint.paper.inputs import EARLY
from thermojoint.paper.verdict import largest_error

if TYPE_CHECKING:
    import xarray as xr

    from estimator.rows import Row
    from thermojoint.artefacts.response import AnyResponse

#: A contact element with less than this fraction of the largest final change gets no share.
STILL = 0.1
#: With more contact elements than this, a joint's resistance to rocking is less than 5 % too low.
FINE = 4
#: Displacements (um, um/m) that a summary leaves out.
LEAST_SHOWN_UM = 1e-6


@dataclass(frozen=True)
class Convergence:
    """Solver statistics of a response."""

    #: Largest residual of the gap equations, m.
    gap_residual: float
    #: Largest relative heat imbalance, |in - stored - convected|.
    heat_balance: float
    #: Newton iterations in total, and largest number in a step.
    iterations: int
    most_iterations: int
    #: Number of viscous steps after a snap-through of a joint.
    cuts: int
    #: Number of time steps.
    steps: int
    #: Number of modes of the reduced thermal model; 0 for the full one.
    modes: int
    #: Largest error of an output of the reduced model, relative to the tolerance.
    reduction_error: float

    @property
    def thermal_model(self) -> str:
        """Description of the thermal model, with the error of a reduced one."""
        from fesim.march.reduced import DISPLACEMENT_ERROR, TEMPERATURE_ERROR

        if not self.modes:
            return "full"
        return (
            f"reduced to {self.modes} modes, error {self.reduction_error:.2g} of the allowed "
            f"{1e3 * TEMPERATURE_ERROR:g} mK and {1e9 * DISPLACEMENT_ERROR:g} nm"
        )


@dataclass(frozen=True)
class ElementShare:
    """One contact element: its change of pressure early and at the end, MPa, and their ratio.

    The ratio is None if the final change is near zero.
    """

    contact: int
    early_MPa: float
    final_MPa: float
    share: float | None


@dataclass(frozen=True)
class PressureShare:
    """Fraction of the final change that each contact pressure has reached at a given time."""

    #: The time, s.
    at_s: float
    #: (p(at) - p(0)) / (p(end) - p(0)) and both differences; rising pressure is positive.
    rows: tuple[ElementShare, ...]

    @property
    def least_compressed(self) -> float | None:
        """The smallest share among the elements whose pressure rises; None if there are none."""
        known = [row.share for row in self.rows if row.share is not None and row.final_MPa > 0.0]
        return min(known) if known else None


@dataclass(frozen=True)
class SchemeErrors:
    """Largest errors of one validation case, µm."""

    #: The axis is "vector" for the length of the error in all directions together.
    case: str
    axis: str
    #: Error of the linear estimator.
    linear: float
    #: Error of FCHS with Eq. 18 calibrated to steps, as in the paper.
    steps: float | None
    #: Error of FCHS with Eq. 18 calibrated to estimated strengths, the estimator's default.
    estimated: float


def result_lines(response: AnyResponse, figures: Mapping[str, float]) -> list[str]:
    """Return a description of temperatures, bolts and joints at the end."""
    temperature = response["temperature"].to_numpy()
    step, probe = np.unravel_index(temperature.argmax(), temperature.shape)
    lines = [
        f"Temperature: at most {temperature[step, probe]:.4g} K above the initial ambient; probe "
        f"{response['probe'].to_numpy()[probe]}, after {_lasting(response, int(step))}."
    ]
    if "bolt_force" in response:
        end = 1e-3 * response["bolt_force"].to_numpy()[-1]
        low, high = (1e-3 * figures[f"bolt_force_{what}_N"] for what in ("min", "max"))
        lines.append(
            f"Bolts: {end.min():.4g} to {end.max():.4g} kN at the end, {low:.4g} to {high:.4g} kN "
            f"in the run; least at the end in {response['bolt'].to_numpy()[end.argmin()]}."
        )
    if not response.sizes["axis"]:
        lines.append("Heat alone: the case has no [displacement], so nothing deforms.")
    elif "open_share_final" in figures:
        lines += _joint_lines(response, figures)
    if "march_steps" in response.attrs:
        lines.append(adaptive_line(response.attrs))
    return lines


def _joint_lines(response: AnyResponse, figures: Mapping[str, float]) -> list[str]:
    """Return a description of the joints at the end."""
    lines = []
    last = 1e-6 * response["pressure"].to_numpy()[-1]
    lines.append(
        f"Contact pressure: {last.min():.4g} to {last.max():.4g} MPa at the end, "
        f"{figures['pressure_min_MPa']:.4g} to {figures['pressure_max_MPa']:.4g} MPa in the run."
    )
    shares = (
        f"{figures[f'{what}_share_final']:.1%} {what} (at most {figures[f'{what}_share_peak']:.1%})"
        for what in ("open", "sliding")
    )
    lines.append(f"Area of the joints at the end: {', '.join(shares)}.")
    lines += rocking_lines(json.loads(response.attrs["case"])["joints"])
    if count := int(figures["taken_over"]):
        first = int(response["taken_over"].to_numpy().argmax())
        lines.append(
            f"Coupling: staggered steps alternated; {count} steps, from "
            f"{_lasting(response, first)} on, were iterated instead."
        )
    if "unresolved_steps" in response.attrs:
        lines.append(unresolved_line(response.attrs))
    return lines


def unresolved_line(attrs: Mapping[str, Any]) -> str:
    """Return a warning about an oscillation that the steps of a march do not resolve."""
    first, last = (attrs[f"unresolved_{end}_s"] for end in ("from", "to"))
    return (
        f"Steps: from {first:g} to {last:g} s pressures rise and fall from step to step though no "
        "input does: pressure and heat flow drive each other faster than the steps are long. Take "
        'march.method = "adaptive", or a shorter march.step_s.'
    )


def axis_lines(response: xr.Dataset) -> list[str]:
    """Return a line for each moving axis and each direction in which its displacement varies."""
    last = response.isel(time=-1)
    lines = []
    for name in response["moving_axis"].to_numpy():
        one = last.sel(moving_axis=name)
        for axis in response["axis"].to_numpy():
            offset, slope, left = (
                MEGA * float(one[key].sel(axis=axis))
                for key in ("line_offset", "line_slope", "line_left")
            )
            if max(abs(offset), abs(slope)) > LEAST_SHOWN_UM:
                at = float(one["reference_position"]) / MILLI
                lines.append(
                    f"axis {str(name)!r} at the end: displacement along {axis} is "
                    f"K0 {offset:.3g} µm at P0 {at:g} mm and tan β {slope:.3g} µm/m; "
                    f"the line leaves {left:.2g} µm"
                )
    return lines


def drive_lines(response: xr.Dataset) -> list[str]:
    """Return a line for the drive of each moving axis, and one for a screw that became slack."""
    if "positioning_error" not in response:
        return []
    lines = []
    for name in response["moving_axis"].to_numpy():
        one = response.sel(moving_axis=name)
        last = one.isel(time=-1)
        over = MEGA * last["asked_positioning_error"].to_numpy()
        parts = [
            f"axis {str(name)!r} at the end: positioning error "
            f"{MEGA * float(last['positioning_error']):.3g} µm at "
            f"{float(last['axis_position']) / MILLI:g} mm, {over.min():.3g} to {over.max():.3g} µm "
            "over the stroke"
        ]
        if "screw_temperature" in one and one["station_position"].any():
            warm = last["screw_temperature"].to_numpy()
            parts.append(f"screw {warm.min():.3g} to {warm.max():.3g} K warmer")
        if "scale_temperature" in one and one["scale_temperature"].any():
            parts.append(f"scale {float(last['scale_temperature']):.3g} K warmer")
        pulled = one["screw_tension"].to_numpy() if "screw_tension" in one else np.zeros(1)
        if pulled.any():
            parts.append(f"tension {1e-3 * pulled[-1]:.3g} kN")
        lines.append("; ".join(parts))
        slack = np.flatnonzero(pulled == 0.0)
        if pulled.any() and slack.size:
            lines.append(
                f"axis {str(name)!r}: the screw is slack at {_lasting(response, int(slack[0]))}; "
                "stretch it more, or take it as fixed-supported"
            )
    return lines


def accuracy_line(attrs: Mapping[str, Any]) -> str:
    """Return a description of a displacement's accuracy, from a response with error estimates."""
    by_joint = json.loads(attrs["error_by_joint_um"])
    parts = []
    for name in ("joint", "mesh", "time"):
        value = attrs.get(f"error_{name}_um")
        worst = f" (most by {max(by_joint, key=by_joint.get)!r})" if len(by_joint) > 1 else ""
        known = "unknown" if value is None else f"{value:.2g}"
        parts.append(f"{name} {known}{worst if name == 'joint' else ''}")
    return f"δ is good to about {attrs['error_total_um']:.2g} µm: {', '.join(parts)}."


def adaptive_line(attrs: Mapping[str, Any]) -> str:
    """Return a description of the steps chosen by an adaptive march, from a response."""
    return (
        f"Steps: {attrs['march_steps']} of {attrs['shortest_step_s']:.2g} to "
        f"{attrs['longest_step_s']:.3g} s, {attrs['rejected_steps']} rejected; estimated error "
        f"{attrs['estimated_error_um']:.2g} µm of the displacement, "
        f"{attrs['estimated_error_K']:.2g} K at the joints."
    )


def rocking_lines(joints: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a warning about the coarsest joint if its resistance to rocking is too low.

    n elements of uniform pressure have (1 - 1/n^2) of the strip's resistance to rotation about its
    middle (sum of areas times squared distances).
    """
    counts = [
        (joint[way], name, way)
        for name, joint in joints.items()
        if joint["preload_MPa"]
        for way in ("along", "across")
        if joint[way]
    ]
    if not counts or min(counts)[0] > FINE:
        return []
    count, name, way = min(counts)
    much = "has no resistance" if count == 1 else f"is {1 / (count**2 - 1):.0%} too soft"
    return [
        f"Contact elements: against rocking, joint {name!r} {much}, with {way} = {count}. Where no "
        "other joint or support holds its bodies, raise along and across."
    ]


def _lasting(response: AnyResponse, step: int) -> str:
    """Return the time of a sample as text, in s or min."""
    seconds = float(response["time"].to_numpy()[step])
    return f"{seconds:.4g} s" if seconds < 60.0 else f"{seconds / 60.0:.4g} min"


def convergence(response: AnyResponse) -> Convergence:
    """Return the solver statistics of a simulated response.

    Raises
    ------
    InputError
        The response is not simulated.
    """
    for name in ("gap_residual", "heat_balance", "iterations", "cuts"):
        _need(response, name)
    iterations = response["iterations"].to_numpy()
    return Convergence(
        gap_residual=float(response["gap_residual"].to_numpy().max()),
        heat_balance=float(np.abs(response["heat_balance"].to_numpy()).max()),
        iterations=int(iterations.sum()),
        most_iterations=int(iterations.max()),
        cuts=int(response["cuts"].to_numpy().sum()),
        steps=taken_steps(response),
        modes=int(response.attrs.get("thermal_modes", 0)),
        reduction_error=float(response.attrs.get("reduction_error", 0.0)),
    )


def covered_areas(response: AnyResponse) -> dict[str, float]:
    """Return the area of each convecting surface that joints cover, m2; it does not convect."""
    areas: dict[str, float] = json.loads(response.attrs.get("covered_area_m2", "{}"))
    return areas


def pressure_share(response: xr.Dataset, at_s: float = EARLY) -> PressureShare:
    """Return the fraction of the final pressure change that is reached at a time, s.

    The paper's elements under compression reach 75 % within one minute (section 5.3.2).

    Raises
    ------
    InputError
        There is no pressure, or the response ends before `at_s`.
    """
    _need(response, "pressure")
    time, pressure = response["time"].to_numpy(), response["pressure"].to_numpy()
    if not time[0] <= at_s < time[-1]:
        raise InputError(
            f"pressure share at {at_s:g} s: the response runs from {time[0]:g} to {time[-1]:g} s; "
            "simulate it for longer"
        )
    at = np.array([np.interp(at_s, time, column) for column in pressure.T])
    early, final = (at - pressure[0]) / 1e6, (pressure[-1] - pressure[0]) / 1e6
    moves = np.abs(final) > STILL * np.abs(final).max()
    return PressureShare(
        at_s,
        tuple(
            ElementShare(int(number), change, end, change / end if moving else None)
            for number, change, end, moving in zip(
                response["contact"].to_numpy(), early.tolist(), final.tolist(), moves, strict=True
            )
        ),
    )


def compare_schemes(
    rows: Sequence[Row], as_printed: Sequence[Row], vectors: Sequence[Row]
) -> list[SchemeErrors]:
    """Return the largest errors of the linear estimator and of both FCHS calibrations."""
    error = {(row["case"], row["axis"], row["estimator"]): largest_error(row) for row in rows}
    steps = {(row["case"], row["axis"]): largest_error(row) for row in as_printed}
    length = {(row["case"], row["estimator"]): largest_error(row) for row in vectors}
    errors = [
        SchemeErrors(str(case), str(axis), linear, steps[case, axis], error[case, axis, "fchs"])
        for (case, axis, estimator), linear in error.items()
        if estimator == "linear"
    ]
    errors += [
        SchemeErrors(str(case), "vector", linear, None, length[case, "fchs"])
        for (case, estimator), linear in length.items()
        if estimator == "linear"
    ]
    return errors


def _need(response: AnyResponse, name: str) -> None:
    if name not in response:
        raise InputError(f"response: variable {name!r} is missing; give a simulated response")
