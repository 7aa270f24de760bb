"""Figure 5 by convolution with the whole history (Eq. 5), kernels tabulated beforehand.

In two ways: block after block, as the figure draws it, and with one kernel for all blocks together,
which is the least that a convolution can cost. Both hold history and kernels for a number of
samples at one interval, and both give the numbers of `estimator.fchs.stream`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from estimator.fchs.stream import run
from thermojoint.artefacts.arrays import Array
from thermojoint.models.assembly import Assembly
from thermojoint.models.filters.bank import Bank, respond_to_line, respond_to_steps


class Blocks:
    """One sample after another, block after block, up to `length` samples."""

    def __init__(self, estimator: Assembly, length: int) -> None:
        times = estimator.dt_s * np.arange(1, length + 1)

        def line(bank: Bank) -> Array:
            return _kernel(
                lambda u: respond_to_line(bank, times, u, estimator.dt_s)[0], bank, length
            )

        def steps(bank: Bank) -> Array:
            return _kernel(lambda u: respond_to_steps(bank, times, u, estimator.dt_s), bank, length)

        self.kernels = (
            line(estimator.heat),
            steps(estimator.linear),
            steps(estimator.temperature),
            line(estimator.sources),
            steps(estimator.nonlinear),
        )
        sources = estimator.n_sources
        self.difference, self.heat = np.zeros(length), np.zeros(length)
        self.deviation, self.strength = np.zeros(length * sources), np.zeros(length * sources)
        self.sources, self.count = sources, 0

    def sample(self, delta_T: float, temperatures: Sequence[float]) -> tuple[Array, Array]:
        """Take one sample; return the linear and the nonlinear displacement, m."""
        n = self.count = self.count + 1
        wide, at = n * self.sources, slice((n - 1) * self.sources, n * self.sources)
        heat, linear, temperature, sources, nonlinear = self.kernels
        self.difference[n - 1] = delta_T
        self.heat[n - 1] = (heat[:, -n:] @ self.difference[:n])[0]
        self.deviation[at] = temperatures - temperature[:, -n:] @ self.heat[:n]
        self.strength[at] = sources[:, -wide:] @ self.deviation[:wide]
        return linear[:, -n:] @ self.heat[:n], nonlinear[:, -wide:] @ self.strength[:wide]


class Collapsed:
    """One sample after another with one kernel from what is measured to what is estimated."""

    def __init__(self, estimator: Assembly, length: int) -> None:
        channels = 1 + estimator.n_sources
        times = estimator.dt_s * np.arange(1, length + 1)

        def respond(pulse: Array) -> Array:
            found, _ = run(estimator, times, pulse[:, 0], pulse[:, 1:])
            return np.column_stack(
                [found.heat, found.sources, found.deviation, found.linear, found.nonlinear]
            )

        self.kernel = _table(respond, channels, length)
        self.history, self.channels, self.count = np.zeros(length * channels), channels, 0
        self.axes = len(estimator.axes)

    def sample(self, delta_T: float, temperatures: Sequence[float]) -> tuple[Array, Array]:
        """Take one sample; return the linear and the nonlinear displacement, m."""
        n = self.count = self.count + 1
        end = n * self.channels
        self.history[end - self.channels : end] = delta_T, *temperatures
        found = self.kernel[:, -end:] @ self.history[:end]
        return found[-2 * self.axes : -self.axes], found[-self.axes :]


def _kernel(respond: Callable[[Array], Array], bank: Bank, length: int) -> Array:
    return _table(respond, bank.drive.shape[1], length)


def _table(respond: Callable[[Array], Array], inputs: int, length: int) -> Array:
    """Outputs to one unit of each input, (outputs, length * inputs), the latest input last."""
    pulses = np.zeros((inputs, length, inputs))
    for i in range(inputs):
        pulses[i, 0, i] = 1.0
    answers = np.stack([respond(pulse) for pulse in pulses], axis=-1)
    outputs = answers.shape[1]
    return np.ascontiguousarray(answers[::-1].transpose(1, 0, 2).reshape(outputs, -1))
