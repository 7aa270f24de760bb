"""PID controller with feed-forward for one heater (Eq. 17) with limited, non-negative power.

The controlled variable is an estimated displacement with a setpoint δ0:

u = k_g F(s) Q_d + K (1 + 1/(T_i s) + T_d s/(1 + T_f s)) e,   e = sign (δ0 - δ),

where sign is that of the heater's effect on δ and F is a first-order low-pass; discretised by
backward differences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True)
class Controller:
    """Settings of the controller."""

    #: K, W/m; positive.
    gain: float
    #: T_i and T_d, s.
    integral_time: float
    derivative_time: float
    #: T_f, s.
    derivative_filter: float
    #: 1 if heat increases the displacement, else -1.
    sign: float
    #: k_g, W per W of the disturbing heat.
    feed_forward: float
    #: Time constant of F, s.
    feed_forward_filter: float
    #: Largest heat, W; the smallest is 0.
    largest: float
    #: Step of the heat, W; 0 for none.
    resolution: float
    #: Interval of the samples, s.
    interval: float
    #: δ0, m. A setpoint other than zero keeps the heater warm, so that its heat can be reduced.
    setpoint: float = 0.0


class ControllerState(NamedTuple):
    """State of the controller between two samples."""

    #: Integral term, W.
    integral: float
    #: e, m, and the filtered derivative term, m.
    error: float
    derivative: float
    #: F Q_d, W.
    fed: float


AT_REST = ControllerState(0.0, 0.0, 0.0, 0.0)


def control(
    controller: Controller, state: ControllerState, displacement: float, disturbing: float
) -> tuple[ControllerState, float]:
    """Return the state after a sample, and the power of the heater, W.

    Inputs are the estimated displacement, m, and the estimated disturbing heat, W.

    Anti-windup: at a limit of the heater the integral only changes away from the limit.
    """
    step = controller.interval
    error = controller.sign * (controller.setpoint - displacement)
    slow = controller.derivative_filter
    derivative = (slow * state.derivative + controller.derivative_time * (error - state.error)) / (
        slow + step
    )
    fed = state.fed + step / (step + controller.feed_forward_filter) * (disturbing - state.fed)
    ahead = controller.feed_forward * fed + controller.gain * (error + derivative)
    more = controller.gain * step / controller.integral_time * error
    wanted = ahead + state.integral + more
    beyond = (wanted > controller.largest and more > 0.0) or (wanted < 0.0 and more < 0.0)
    integral = state.integral if beyond else state.integral + more
    heat = min(max(ahead + integral, 0.0), controller.largest)
    if controller.resolution > 0.0:
        heat = min(
            controller.resolution * round(heat / controller.resolution),
            controller.resolution * math.floor(controller.largest / controller.resolution + 1e-9),
        )
    return ControllerState(integral, error, derivative, fed), heat
