"""Tuning rule: the fastest loop that keeps its margins under assumed model errors.

At a crossover ω the machine is approximated by an integrator with its gain there, |δ/u| ω, a
conservative approximation of diffusion. Skogestad's SIMC for an integrator then has the integral
time 4/ω, the gain that makes |L(jω)| = 1, and no derivative; the feed-forward is low-passed at ω,
and its gain is the least-squares fit of the two step responses. The crossover is the highest at
which all `Requirements` hold.

Skogestad (2003), Simple analytic rules for model reduction and PID controller tuning, J. Process
Control 13, 291-309.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_model import ObserverModel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.compensation.loop.controller import Controller
from thermojoint.compensation.loop.linear import (
    Channels,
    Margins,
    Responses,
    controller_response,
    margins_of,
    noise_of_heat,
    open_loop,
)

#: Number of crossovers tried per decade.
A_DECADE = 20
#: SIMC's integral time in units of 1/ω.
INTEGRAL = 4.0


@dataclass(frozen=True)
class Requirements:
    """Requirements for a tuned loop."""

    #: Smallest gain margin, a factor.
    gain_margin: float
    #: Smallest phase margin, rad.
    phase_margin: float
    #: Tolerated relative error of the model's gain, of either sign.
    gain_error: float
    #: Delay of the estimates, and its possible increase, s.
    delay: float
    delay_error: float
    #: Shape (p + 1,): standard deviation of each reading, K.
    noise: Array
    #: Largest standard deviation of the heat caused by sensor noise, W.
    most_noise: float


@dataclass(frozen=True)
class Tuned:
    """A controller, its margins with the nominal model, and the smallest under model errors."""

    controller: Controller
    nominal: Margins
    #: Smallest gain margin, a factor, and phase margin, rad.
    worst_gain: float
    worst_phase: float
    #: Standard deviation of the heat caused by sensor noise, W.
    heat_noise: float


def feed_forward_gain(model: ObserverModel, channels: Channels, horizon: float) -> float:
    """Return k_g, W/W: the heat that minimises the response to a disturbance step up to a time (s).

    Raises
    ------
    InputError
        The heater moves the axis in the same direction as the disturbance, so heat cannot
        compensate it.
    """
    system = Observer(model).system
    dynamic = system.decay.size
    steps = np.arange(1, max(2, round(horizon / model.step)) + 1)[:, None]
    both = []
    for source in (channels.disturbance, channels.heater):
        # Step response after k steps: a geometric sum for each state.
        level = system.drive[:, source] / (1.0 - system.decay)
        per_state = model.band.tangent[channels.axis, :dynamic] * level
        both.append((1.0 - system.decay[None, :] ** steps) @ per_state)
    disturbed, heated = both
    gain = -float(disturbed @ heated) / float(heated @ heated)
    if gain <= 0.0:
        raise InputError(
            f"heater: moves axis {model.axes[channels.axis]} as "
            f"{model.sources[channels.disturbance]} does, and it cannot cool; put it elsewhere, or "
            "control another axis"
        )
    return gain


def tune(responses: Responses, start: Controller, required: Requirements) -> Tuned:
    """Return the fastest controller with sign, limits and feed-forward gain of `start`.

    Raises
    ------
    InputError
        No crossover meets the requirements.
    """
    low, high = responses.frequencies[0] * 4.0, responses.frequencies[-1] / 3.0
    crossovers = np.geomspace(low, high, round(A_DECADE * np.log10(high / low)))
    for crossover in crossovers[::-1]:
        controller = _simc(responses, start, float(crossover))
        noise = noise_of_heat(responses, controller, required.delay, required.noise)
        if not noise <= required.most_noise:
            continue  # before the margins, whose computation takes much longer
        candidate = _checked(responses, controller, required, noise)
        if (
            candidate.worst_gain >= required.gain_margin
            and candidate.worst_phase >= required.phase_margin
        ):
            return candidate
    raise InputError(
        "tuning: no crossover meets the required margins and noise; relax them, or reduce the delay"
    )


def _simc(responses: Responses, start: Controller, crossover: float) -> Controller:
    """SIMC controller for the machine approximated by an integrator at a crossover (1/s)."""
    given = replace(
        start,
        gain=1.0,
        integral_time=INTEGRAL / crossover,
        derivative_time=0.0,
        feed_forward_filter=1.0 / crossover,
    )
    pid, _ = controller_response(given, np.array([crossover]), 0.0)
    moved = np.exp(
        np.interp(
            np.log(crossover),
            np.log(responses.frequencies),
            np.log(np.abs(responses.heater.displacement)),
        )
    )
    return replace(given, gain=float(1.0 / (np.abs(pid[0]) * moved)))


def _checked(
    responses: Responses, controller: Controller, required: Requirements, noise: float
) -> Tuned:
    """Margins of a controller with given noise of its heat (W), nominal and under model errors."""
    nominal = margins_of(responses.frequencies, open_loop(responses, controller, required.delay))
    late = open_loop(responses, controller, required.delay + required.delay_error)
    worst = [
        margins_of(responses.frequencies, (1.0 + error) * late)
        for error in (-required.gain_error, required.gain_error)
    ]
    return Tuned(
        controller,
        nominal,
        min(margins.gain for margins in (nominal, *worst)),
        # NaN for a loop that never has gain 1, in which nothing is controlled.
        float(np.min([margins.phase for margins in (nominal, *worst)])),
        noise,
    )
