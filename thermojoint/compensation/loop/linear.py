"""Frequency responses and margins of the loop, linearised near the preload.

Machine and estimator are taken from a joint-aware model: modes and relaxations, diagonal, sampled
at the estimator's own step T. With x' = D x + b u for the machine and the steady filter
x+ = F x + K e, e = y - H F x, for the estimator (docs/closing-the-loop.md):

δ/u = M (z - D)^-1 b,  y/u = H (z - D)^-1 b,  x/y = z N (1 + z H N - H K)^-1,  N = (z - F)^-1 K.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware.filter_design import LinearSystem, correct
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_model import ObserverModel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import unknown_name
from thermojoint.artefacts.extras import require
from thermojoint.compensation.loop.controller import Controller

if TYPE_CHECKING:
    import control

Complex = NDArray[np.complex128]
#: Lowest frequency evaluated, 1/s; below it the integral part keeps the error at zero.
SLOWEST = 1e-5
#: Number of frequencies.
COUNT = 300


@dataclass(frozen=True)
class Channels:
    """Inputs and output of a loop."""

    #: Columns of the inputs.
    heater: int
    disturbance: int
    #: Index of the axis of the displacement.
    axis: int


class SourceResponse(NamedTuple):
    """Frequency response to one heat source."""

    #: Shape (f,): δ, and its estimate, m/W.
    displacement: Complex
    estimate: Complex
    #: Shape (f,): estimated disturbing heat, W/W.
    heat: Complex


@dataclass(frozen=True, eq=False)
class Responses:
    """Frequency responses at the estimator's own sampling."""

    #: Shape (f,): angular frequencies, 1/s, up to half the sampling frequency.
    frequencies: Array
    #: Responses per W of the heater, and of the disturbance.
    heater: SourceResponse
    disturbance: SourceResponse
    #: Shape (f, p + 1): the same per K of each reading, m/K and W/K.
    noise_estimate: Complex
    noise_heat: Complex
    #: T, s.
    step: float


def python_control() -> ModuleType:
    """Return python-control, an optional dependency.

    Raises
    ------
    InputError
        It is not installed.
    """
    require("heater: its transfer functions", "control", "control")
    import control

    return control


def loop_channels(model: ObserverModel, heater: str, disturbance: str, axis: str) -> Channels:
    """Return the channels of a loop in a model.

    Raises
    ------
    InputError
        The model has no source or axis of that name.
    """
    for name in (heater, disturbance):
        if name not in model.sources:
            raise unknown_name("source", name, model.sources, "estimator: its model")
    if axis not in model.axes:
        raise unknown_name("axis", axis, model.axes, "estimator: its model")
    return Channels(
        model.sources.index(heater), model.sources.index(disturbance), model.axes.index(axis)
    )


def frequencies_of(model: ObserverModel) -> Array:
    """Return the frequencies at which a sampled loop is evaluated, 1/s, shape (f,)."""
    return np.geomspace(SLOWEST, np.pi / model.step, COUNT)


def state_space(model: ObserverModel, source: int, axis: int) -> control.StateSpace:
    """Return the discrete-time machine from the heat of a source (W) to the displacement (m)."""
    system = Observer(model).system
    dynamic = system.decay.size
    return python_control().ss(
        np.diag(system.decay),
        system.drive[:, [source]],
        model.band.tangent[[axis], :dynamic],
        np.zeros((1, 1)),
        model.step,
    )


def responses_of(model: ObserverModel, channels: Channels, frequencies: Array) -> Responses:
    """Return the frequency responses of a machine and its estimator near the preload."""
    observer = Observer(model)
    system = observer.system
    dynamic, everything = system.decay.size, np.arange(len(system.rows))
    gain, _ = correct(model.filter, system.rows, everything, np.zeros((system.size, 1)), 1.0)
    out = np.zeros((2, system.size))
    out[0] = model.band.tangent[channels.axis]
    out[1, dynamic + channels.disturbance] = 1.0
    points = np.exp(1j * frequencies * model.step)
    estimator = np.array([_estimator_response(system, gain, out, z) for z in points])

    def path(source: int) -> SourceResponse:
        states = system.drive[:, source] / (points[:, None] - system.decay)
        both = np.einsum("fop,fp->of", estimator, states @ system.rows[:, :dynamic].T)
        return SourceResponse(states @ out[0, :dynamic], both[0], both[1])

    return Responses(
        frequencies,
        path(channels.heater),
        path(channels.disturbance),
        estimator[:, 0],
        estimator[:, 1],
        model.step,
    )


def _estimator_response(system: LinearSystem, gain: Array, out: Array, z: complex) -> Complex:
    """Rows `out` of the estimator's state per reading, shape (rows, p + 1)."""
    dynamic = system.decay.size
    state = np.empty(gain.shape, dtype=complex)
    state[dynamic:] = gain[dynamic:] / (z - 1.0)
    state[:dynamic] = (gain[:dynamic] + system.drive @ state[dynamic:]) / (
        z - system.decay[:, None]
    )
    loop = np.eye(len(system.rows)) + z * (system.rows @ state) - system.rows @ gain
    return np.asarray(np.linalg.solve(loop.T, (z * (out @ state)).T).T, dtype=np.complex128)


def controller_response(
    controller: Controller, frequencies: Array, delay: float
) -> tuple[Complex, Complex]:
    """Return the response of a controller to the estimate (W/m) and to the disturbing heat (W/W).

    Parameters
    ----------
    controller : Controller
    frequencies : ndarray, shape (f,)
        1/s.
    delay : float
        Transmission delay of the estimates, s.
    """
    z, step = np.exp(1j * frequencies * controller.interval), controller.interval
    slow, fed = controller.derivative_filter, controller.feed_forward_filter
    pid = controller.gain * (
        1.0
        + step / controller.integral_time * z / (z - 1.0)
        + controller.derivative_time * (z - 1.0) / ((slow + step) * z - slow)
    )
    low_pass = step * z / ((step + fed) * z - fed)
    late = np.exp(-1j * frequencies * delay)
    return -controller.sign * pid * late, controller.feed_forward * low_pass * late


def open_loop(responses: Responses, controller: Controller, delay: float) -> Complex:
    """Return L, shape (f,): the loop is stable as long as it does not encircle -1."""
    pid, ahead = controller_response(controller, responses.frequencies, delay)
    return np.asarray(-(pid * responses.heater.estimate + ahead * responses.heater.heat))


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop."""

    #: Gain margin, a factor; infinite if no gain destabilises the loop.
    gain: float
    #: Phase margin, rad.
    phase: float
    #: Additional delay until instability, s.
    delay: float
    #: Frequency at which the loop has gain 1, 1/s.
    crossover: float


def margins_of(frequencies: Array, loop: Complex) -> Margins:
    """Return the margins of an open loop, by python-control; NaN phase if it never has gain 1.

    Parameters
    ----------
    frequencies : ndarray, shape (f,)
        1/s; the last is the Nyquist frequency, where a sampled loop is real and may be -1.
    loop : ndarray, shape (f,)
        Response of the open loop.
    """
    control = python_control()
    data = control.FrequencyResponseData(loop, frequencies, smooth=True)
    gain, _, _, _, crossover, _ = control.stability_margins(data)
    if loop[-1].real < 0.0:
        gain = min(float(gain), float(-1.0 / loop[-1].real), key=lambda margin: abs(np.log(margin)))
    # The unwrapped phase, which lags by several turns with a long delay.
    turned = np.interp(crossover, frequencies, np.unwrap(np.angle(loop)))
    left = np.pi + float(turned)
    return Margins(float(gain), left, left / float(crossover), float(crossover))


def disturbed(responses: Responses, controller: Controller, delay: float) -> Complex:
    """Return δ per W of the disturbance with the loop closed, m/W, shape (f,): Eq. 17."""
    pid, ahead = controller_response(controller, responses.frequencies, delay)
    demand = pid * responses.disturbance.estimate + ahead * responses.disturbance.heat
    heater = demand / (1.0 + open_loop(responses, controller, delay))
    return np.asarray(responses.disturbance.displacement + responses.heater.displacement * heater)


def noise_of_heat(
    responses: Responses, controller: Controller, delay: float, noise: Array
) -> float:
    """Standard deviation of the heater's power caused by sensor noise, W.

    Parameters
    ----------
    responses : Responses
    controller : Controller
    delay : float
        s.
    noise : ndarray, shape (p + 1,)
        Standard deviation of the white noise of each reading, K.
    """
    pid, ahead = controller_response(controller, responses.frequencies, delay)
    open_ = open_loop(responses, controller, delay)
    demand = (pid[:, None] * responses.noise_estimate + ahead[:, None] * responses.noise_heat) / (
        1.0 + open_
    )[:, None]
    density = (np.abs(demand) ** 2 * noise**2).sum(axis=1) * responses.step / np.pi
    return float(np.sqrt(np.trapezoid(density, responses.frequencies)))
