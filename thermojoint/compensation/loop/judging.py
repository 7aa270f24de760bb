"""Residual displacement of the runs, and its cause where it exceeds the noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.loop.linear import Margins
from thermojoint.compensation.loop.march import Course
from thermojoint.compensation.loop.run import Closed, Design

SCHEMA, SCHEMA_VERSION = "thermojoint-control", 1
#: A heater at its limit for more than this fraction of a run is reported.
NOTICED = 0.02


def runs_of(closed: Closed) -> Iterator[tuple[str, Course, bool]]:
    """Yield the name and the course of every run, and whether the heater acts."""
    yield "free", closed.free, False
    if closed.heated is not None:
        yield "heater", closed.heated, True
    for delay, course in closed.late.items():
        yield f"delay {delay:g} s", course, closed.heated is not None


def as_content(closed: Closed) -> dict[str, Any]:
    """Return margins and residuals for a JSON file, with units in the keys."""
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "title": closed.loop.title,
        "design": None if closed.design is None else _design(closed.design),
        "runs": [_run(closed, *run) for run in runs_of(closed)],
    }


def _design(design: Design) -> dict[str, Any]:
    controller, tuned = design.tuned.controller, design.tuned
    return {
        "gain_W_um": controller.gain * MICRO,
        "integral_time_s": controller.integral_time,
        "derivative_time_s": controller.derivative_time,
        "feed_forward_W_W": controller.feed_forward,
        "feed_forward_filter_s": controller.feed_forward_filter,
        "margins": _margins(tuned.nominal),
        "worst_gain_margin_dB": _decibel(tuned.worst_gain),
        "worst_phase_margin_deg": math.degrees(tuned.worst_phase),
        "heat_noise_W": tuned.heat_noise,
        "late": {f"{delay:g}": _margins(margins) for delay, margins in design.late.items()},
    }


def _margins(margins: Margins) -> dict[str, float | None]:
    return {
        "gain_margin_dB": _decibel(margins.gain),
        "phase_margin_deg": math.degrees(margins.phase),
        "delay_margin_s": margins.delay,
        "crossover_rad_s": margins.crossover,
    }


def _decibel(factor: float) -> float | None:
    """A factor in dB; None where there is no limit."""
    return 20.0 * math.log10(factor) if math.isfinite(factor) and factor > 0.0 else None


def _run(closed: Closed, name: str, run: Course, heated: bool) -> dict[str, Any]:
    heater, course = closed.loop.heater, judged(closed, run)
    aim = setpoints(closed, heated)
    # Offsets of an axis also compensate the setpoint.
    left = np.where(np.isin(closed.axes, closed.followed), 0.0, aim)
    content: dict[str, Any] = {
        "run": name,
        "axes": {
            axis: {
                "displacement": _extent(course.times, course.displacement[:, k] - aim[k]),
                "estimate_error": _extent(
                    course.times, course.estimate[:, k] - course.displacement[:, k]
                ),
                **(
                    {"with_offsets": _extent(course.times, course.residual[:, k] - left[k])}
                    if closed.loop.offsets is not None
                    else {}
                ),
            }
            for k, axis in enumerate(closed.axes)
        },
    }
    if heated and heater is not None:
        content["heater"] = {
            "largest_W": float(course.heater.max()),
            "mean_W": float(course.heater.mean()),
            "at_largest": float((course.heater >= heater.largest_W - heater.resolution_W).mean()),
            "at_zero": float((course.heater <= 0.0).mean()),
        }
        content["reached"] = reached(closed, run)
    return content


def _extent(times: Array, values: Array) -> dict[str, float]:
    """The largest absolute value of a signal (m), its time, and the root mean square."""
    at = int(np.abs(values).argmax())
    return {
        "largest_um": float(np.abs(values[at])) / MICRO,
        "at_s": float(times[at]),
        "rms_um": float(np.sqrt(np.square(values).mean())) / MICRO,
    }


def judged(closed: Closed, course: Course) -> Course:
    """Return the part of a course that counts: from `plant.judged_from_min` on."""
    kept = course.times >= 60.0 * closed.loop.plant.judged_from_min
    return Course(*(part[kept] for part in course))


def setpoints(closed: Closed, heated: bool) -> Array:
    """Return the setpoint of each axis of a run, m, shape (axes,)."""
    heater, targets = closed.loop.heater, np.zeros(len(closed.axes))
    if heater is not None and heated:
        targets[closed.axes.index(heater.axis)] = MICRO * heater.setpoint_um
    return targets


def reached(closed: Closed, run: Course) -> str:
    """Describe what the heater achieved on its axis, and the cause of what remains."""
    heater = closed.loop.heater
    if heater is None:
        return ""
    course, at = judged(closed, run), closed.axes.index(heater.axis)
    left = np.abs(course.displacement[:, at] - setpoints(closed, True)[at])
    free = float(np.abs(judged(closed, closed.free).displacement[:, at]).max())
    where = f" of {heater.setpoint_um:g} um" if heater.setpoint_um else ""
    sentence = (
        f"{heater.axis} within {left.max() / MICRO:.3g} um{where}, where the free machine moves "
        f"{free / MICRO:.3g} um"
    )
    limits = (
        (
            course.heater >= heater.largest_W - heater.resolution_W,
            f"the heater gives no more than {heater.largest_W:.4g} W",
        ),
        (course.heater <= 0.0, "the heater cannot cool"),
    )
    # The heater was not needed before it first heated.
    begun = int(np.argmax(course.heater > 0.0))
    reasons = []
    for reached_limit, why in limits:
        share = float(reached_limit[begun:].mean())
        if share > NOTICED:
            held = float(left[begun:][reached_limit[begun:]].max()) / MICRO
            reasons.append(f"{why}: {share:.0%} of the time, up to {held:.3g} um")
    return "; ".join([sentence, *reasons])
