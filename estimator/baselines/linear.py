"""Eq. 8 alone: FCHS without its blocks 3 to 7."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimator.baselines.samples import began
from estimator.interface import Channel, Estimate
from estimator.span import status_of
from thermojoint.artefacts.arrays import Array
from thermojoint.models.assembly import Assembly
from thermojoint.models.filters.bank import over_interval


@dataclass(frozen=True, eq=False)
class Linear:
    """ΔT to Q̂ (Eqs. 3-6) to δ_L (Eq. 8).

    Its state is (time of the last sample, start of the run, last ΔT, states of both banks).

    Attributes
    ----------
    assembly : Assembly
        Only its first two blocks are used.
    """

    assembly: Assembly
    kind: Literal["linear"] = "linear"

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return self.assembly.axes

    @property
    def channels(self) -> tuple[Channel, ...]:
        """ΔT = T_a - T_b."""
        return (Channel("delta_T", "K"),)

    @property
    def details(self) -> tuple[Channel, ...]:
        """Q̂."""
        return (Channel("heat_input", "1"),)

    def initial_state(self) -> Array:
        """Return the state of a machine at rest at ambient temperature, before any sample."""
        banks = self.assembly.heat, self.assembly.linear
        state = np.zeros(3 + sum(bank.n_state for bank in banks))
        state[:2] = np.nan
        return state

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`."""
        begun, dt = began(state, time, values, self.channels, self.assembly.dt_s)
        heat = over_interval(self.assembly.heat, dt)
        linear = over_interval(self.assembly.linear, dt)
        new, old = np.asarray(values, dtype=float), state[2:3]
        x_heat, x_linear = np.split(state[3:], [self.assembly.heat.n_state])
        q = heat.mean @ x_heat + heat.mean_old @ old + heat.mean_new @ new
        x_heat = heat.advance @ x_heat + heat.old @ old + heat.new @ new
        x_linear = linear.advance @ x_linear + (linear.old + linear.new) @ q
        status = status_of(
            self.assembly.model.span, time - begun, {"delta_T": float(new[0])}, float(q[0])
        )
        band = np.full(len(self.axes), np.nan)
        return np.concatenate(([time, begun], new, x_heat, x_linear)), Estimate(
            time, linear.end @ x_linear, band, status, q
        )
