"""Initial temperature field of a simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from fesim.march.reduced import ThermalModes, project_start
from fesim.solid.heat import HeatOperators
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class StartField:
    """Temperature unknowns (n,) at time zero, free + held u; held surfaces included."""

    #: Shape (n,): temperatures above the initial ambient, K, zero where held; or the amplitudes of
    #: a reduced model.
    free: Array
    #: Shape (n, k): held temperatures per unit of each input u of the march.
    held: csr_array

    def temperature(self, inputs: Array) -> Array:
        """Return the unknowns (n,) for the inputs (k or more) at time zero."""
        field: Array = self.free + self.held @ inputs[: self.held.shape[1]]
        return field


def start_field(
    heat: HeatOperators, field: Array | None, modes: ThermalModes | None
) -> StartField | None:
    """Return the initial temperatures of a march.

    Parameters
    ----------
    heat : HeatOperators
        Operators of the full model.
    field : ndarray, shape (n,), or None
        Nodal temperatures above the initial ambient, K; None starts at the ambient.
    modes : ThermalModes or None
        Modes of the reduced model; None for the full one.
    """
    if field is None:
        return None
    if modes is None:
        free = field.copy()
        free[heat.held] = 0.0
        count = heat.held.size
        entries = (np.ones(count), (heat.held, np.arange(count)))
        placed = csr_array(entries, shape=(len(free), count))
        return StartField(free, csr_array(placed @ csr_array(heat.held_inputs)))
    rows = np.zeros((modes.basis.shape[1], heat.layout.count))
    rows[modes.rates.size :, heat.layout.held_columns] = np.eye(heat.layout.held)
    return StartField(project_start(heat, modes, field), csr_array(rows))
