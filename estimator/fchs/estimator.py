"""The paper's estimator with the common interface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from estimator.fchs import stream
from estimator.interface import Channel, Estimate, Status, facts_of
from estimator.span import Settling, status_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.display import Described
from thermojoint.models.assembly import Assembly
from thermojoint.models.model_file import FILE
from thermojoint.models.parameters import Model

#: Index of the start of the run, and of the time up to which it is unsettled, in a state.
_BEGUN, _UNTIL = 1, -1


def _state(inner: Array, begun: float, until: float) -> Array:
    """Return the state of the blocks with the two times, s."""
    return np.append(np.insert(inner, _BEGUN, begun), until)


@dataclass(frozen=True, eq=False, repr=False)
class Fchs(Described):
    """Fictitious contact heat sources (Figure 5).

    Its state is that of `estimator.fchs.stream`, with the start of the run (s) inserted after its
    time, and the time up to which it is unsettled (s) at the end.

    Attributes
    ----------
    assembly : Assembly
        The blocks.
    """

    assembly: Assembly
    kind: Literal["fchs"] = "fchs"
    schema: str = FILE.schema

    def _facts(self) -> dict[str, str]:
        return facts_of(self)

    @property
    def model(self) -> Model:
        """The assembled model."""
        return self.assembly.model

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return self.assembly.axes

    @property
    def channels(self) -> tuple[Channel, ...]:
        """ΔT = T_a - T_b, and the temperatures at the joint above the current ambient."""
        return tuple(Channel(name, "K") for name in ("delta_T", *self.assembly.sensors))

    @property
    def details(self) -> tuple[Channel, ...]:
        """Q̂, every q̂ and ∂T, δ_L and δ_NL along every axis."""
        sensors, axes = self.assembly.sensors, self.assembly.axes
        return (
            Channel("heat_input", "1"),
            *(Channel(f"source_{k + 1}", "1") for k in range(len(sensors))),
            *(Channel(f"deviation_{name}", "K") for name in sensors),
            *(Channel(f"{part}_{axis}", "m") for part in ("linear", "nonlinear") for axis in axes),
        )

    def initial_state(self) -> Array:
        """Return the state of a machine at rest at ambient temperature, before any sample."""
        return _state(stream.initial_state(self.assembly), np.nan, np.nan)

    @cached_property
    def settling(self) -> Settling:
        """How long it is unsettled after a start on a warm machine."""
        a = self.assembly
        rates = [-bank.poles.real for bank in (a.linear, a.temperature, a.nonlinear)]
        slowest = 1.0 / float(np.concatenate(rates).min())
        return Settling(a.model.span, a.sensors, slowest, a.dt_s)

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator` and `estimator.fchs.stream.step`.

        Parameters
        ----------
        state : ndarray
            State after the previous sample, or the initial state.
        time : float
            s; later than that of the previous sample.
        values : sequence of float
            ΔT and the temperatures at the joint above the current ambient, K.
        """
        last, begun, until = (float(state[k]) for k in (stream.TIME, _BEGUN, _UNTIL))
        inner = np.delete(state, [_BEGUN, _UNTIL])
        inner, signals = stream.step(self.assembly, inner, time, *values)
        begun = time - self.assembly.dt_s if np.isnan(begun) else begun
        details = np.hstack(
            (signals.heat, signals.sources, signals.deviation, signals.linear, signals.nonlinear)
        )
        named = {channel.name: value for channel, value in zip(self.channels, values, strict=True)}
        span = self.assembly.model.span
        status = status_of(span, time - begun, named, float(signals.heat))
        until = self.settling.until(last, until, time, named)
        if time < until:
            status |= Status.UNSETTLED
        return _state(inner, begun, until), Estimate(
            time, signals.total, np.full(len(self.axes), np.nan), status, details
        )
