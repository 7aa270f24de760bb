"""Bode plot, step responses and simulated runs of a closed loop."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.joint_aware.observer_model import ObserverModel
from thermojoint.artefacts.figures import SHADES, WIDTH, legend_above, stacked_panels
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.loop.judging import runs_of
from thermojoint.compensation.loop.linear import (
    disturbed,
    loop_channels,
    open_loop,
    python_control,
    state_space,
)
from thermojoint.compensation.loop.run import Closed, Design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Length of the step response, s, and number of points of a curve.
_STEP, _POINTS = 7200.0, 1500


def bode_figure(design: Design, delay: float) -> Figure:
    """Return gain and phase of the open loop, and the disturbance response, free and controlled.

    The delay of the estimates is in s.
    """
    responses, tuned = design.responses, design.tuned
    loop = open_loop(responses, tuned.controller, delay)
    figure, (gain, phase, moved) = _panels(3)
    w = responses.frequencies
    for k, (name, values) in enumerate(
        {
            "open loop": loop,
            "machine, µm/kW": 1e9 * responses.heater.displacement,
            "its estimate, µm/kW": 1e9 * responses.heater.estimate,
        }.items()
    ):
        line: dict[str, Any] = {"label": name, "color": SHADES[k], "linewidth": 1.2}
        line["linestyle"] = "--" if k == 2 else "-"
        gain.loglog(w, np.abs(values), **line)
        phase.semilogx(w, np.degrees(np.unwrap(np.angle(values))), **line)
    gain.axhline(1.0, color="0.4", linewidth=0.8)
    phase.axhline(-180.0, color="0.4", linewidth=0.8)
    for panel in (gain, phase):
        panel.axvline(tuned.nominal.crossover, color="0.4", linewidth=0.8, linestyle=":")
    phase.set_ylim(-360.0, 10.0)
    gain.set_ylabel("gain")
    phase.set_ylabel("phase (°)")
    closed = disturbed(responses, tuned.controller, delay)
    for name, values, shade in (
        ("free", responses.disturbance.displacement, SHADES[1]),
        ("controlled", closed, SHADES[2]),
    ):
        moved.loglog(w, 1e9 * np.abs(values), label=name, color=shade, linewidth=1.2)
    moved.set_ylabel("δ per disturbing\nheat (µm/kW)")
    moved.set_xlabel("frequency (rad/s)")
    return _finished(figure)


def step_figure(model: ObserverModel, closed: Closed) -> Figure:
    """Return the responses to 1 kW steps of disturbance and heater, near the preload."""
    heater = closed.loop.heater
    figure, (panel,) = _panels(1)
    if heater is not None:
        channels = loop_channels(model, heater.source, heater.against, heater.axis)
        times = model.step * np.arange(round(_STEP / model.step) + 1)
        named = ((heater.against, channels.disturbance), (heater.source, channels.heater))
        for k, (name, source) in enumerate(named):
            response = python_control().step_response(
                state_space(model, source, channels.axis), times
            )
            panel.plot(
                times / 60.0, 1e9 * response.outputs.ravel(), label=name, color=SHADES[k + 1]
            )
        panel.set_ylabel(f"δ {heater.axis} (µm)")
    panel.set_xlabel("time after a step of 1 kW (min)")
    return _finished(figure)


def runs_figure(closed: Closed) -> Figure:
    """Return displacement, residual and heat against time."""
    axes = closed.axes
    figure, panels = _panels(2 * len(axes) + (closed.heated is not None))
    for k, axis in enumerate(axes):
        first, second = panels[2 * k], panels[2 * k + 1]
        for shade, (name, course, _) in zip(cycle(SHADES), runs_of(closed), strict=False):
            thin = slice(None, None, max(1, course.times.size // _POINTS))
            time = course.times[thin] / 60.0
            for panel, values in ((first, course.displacement), (second, course.residual)):
                shown = values[thin, k] / MICRO
                panel.plot(time, shown, label=name, color=shade, linewidth=1.1)
        first.set_ylabel(f"δ {axis} (µm)")
        second.set_ylabel(
            f"δ {axis} with\noffsets (µm)" if closed.loop.offsets else f"δ {axis} (µm), close"
        )
        if closed.loop.offsets is None:
            second.set_ylim(-5.0, 5.0)
    if closed.heated is not None:
        for shade, (name, course, heated) in zip(cycle(SHADES), runs_of(closed), strict=False):
            if heated:
                thin = slice(None, None, max(1, course.times.size // _POINTS))
                panels[-1].plot(
                    course.times[thin] / 60.0,
                    course.heater[thin],
                    color=shade,
                    linewidth=0.9,
                    label=name,
                )
        panels[-1].set_ylabel("heater (W)")
    panels[-1].set_xlabel("time (min)")
    return _finished(figure)


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    return stacked_panels(count, WIDTH, 0.5 + 2.6 * count)


def _finished(figure: Figure) -> Figure:
    for panel in figure.axes:
        panel.grid(visible=True, color="0.88", linewidth=0.6)
        legend_above(panel)
    return figure
