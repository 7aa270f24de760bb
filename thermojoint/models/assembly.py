"""Assembly of the seven blocks of Figure 5 as banks of exponential states.

The poles of the inverse blocks are fitted, and the last digits of a fit depend on the processor. An
assembly is therefore built once, stored (`thermojoint.models.assembly_file`) and read back, not
rebuilt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError
from thermojoint.models.filters.bank import Bank, leaking, simple_bank, stacked, summed
from thermojoint.models.filters.inverse import inverse_bank
from thermojoint.models.filters.pole_residue import direct_bank
from thermojoint.models.parameters import DeformationModel, Model, Relaxation, RingModel

#: Relative error of the rational approximations over the band of a run.
TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Assembly(Described):
    """Precomputed blocks of a model.

    Attributes
    ----------
    model : Model
        The model.
    dt_s : float
        Nominal sampling interval, s; samples may have other intervals.
    run_length_s : float
        Length of a run, s; `dt_s` and `run_length_s` define the band of the approximations.
    heat : Bank
        Block 1.
    linear : Bank
        Block 2: one input, an output for each axis.
    temperature : Bank
        Block 3: one input, an output for each sensor at the joint.
    sources : Bank
        Blocks 4 and 5.
    nonlinear : Bank
        Blocks 6 and 7: n inputs, an output for each axis.
    """

    model: Model
    dt_s: float
    run_length_s: float
    heat: Bank
    linear: Bank
    temperature: Bank
    sources: Bank
    nonlinear: Bank

    def _facts(self) -> dict[str, str]:
        return {
            "axes": ", ".join(self.axes),
            "sensors": ", ".join(self.sensors),
            "interval": f"{self.dt_s:g} s",
            "run length": f"{self.run_length_s / 60.0:g} min",
        } | ({"approximated within": f"{self.error:.1e}"} if self.error > TOLERANCE else {})

    @property
    def error(self) -> float:
        """Largest relative error of the inverse filters over the band of a run."""
        return max(self.heat.error, self.sources.error)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the displacement axes."""
        return tuple(self.model.linear.deformation)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors at the joint."""
        return tuple(self.model.linear.direct)

    @property
    def banks(self) -> tuple[Bank, ...]:
        """The banks in the order of their states in the state array."""
        return self.heat, self.linear, self.temperature, self.sources, self.nonlinear

    @property
    def n_sources(self) -> int:
        """Number of fictitious sources, and of sensors at the joint."""
        return int(self.sources.constant.shape[0])

    @property
    def n_state(self) -> int:
        """Length of the state: time, last ΔT, last ∂T and the states of the banks."""
        return 2 + self.n_sources + sum(bank.n_state for bank in self.banks)


def deformation_bank(model: DeformationModel) -> Bank:
    """Return heat to displacement (Eqs. 8 and 18) as a bank: s times the step response."""
    m = model
    rates = np.array([m.c, m.d, m.e, m.f] if m.F else [m.c, m.d, m.e])
    gain = np.array([m.C * m.c, m.D * m.d, m.E, m.F][: rates.size], dtype=complex)
    double = np.array([0.0, 0.0, -m.E * m.e, -m.F * m.f][: rates.size], dtype=complex)
    nothing = np.zeros((1, 1))
    return Bank(
        -rates.astype(complex), np.ones((rates.size, 1)), gain[None], double[None], nothing, nothing
    )


def assemble(
    model: Model, dt_s: float, run_length_s: float, tolerance: float = TOLERANCE
) -> Assembly:
    """Return the blocks of `model`.

    Parameters
    ----------
    model : Model
        Tables 1-3; as many sensors at the joint as fictitious sources.
    dt_s : float
        Nominal sampling interval, s. Together with `run_length_s` it defines the band of the
        rational approximations; samples may have other intervals.
    run_length_s : float
        Length of a run, s.
    tolerance : float
        Relative error of the approximations over that band.

    Raises
    ------
    InputError
        The model's parts do not fit together, a rate is not positive, or an inverse is unstable.
    ConvergenceError
        An inverse filter has no usable approximation. An approximation that misses the tolerance is
        used; `Assembly.error` states its error.
    """
    table = model.linear
    axes, sensors = tuple(table.deformation), tuple(table.direct)
    count = len(model.sources)
    if count == 0 or len(sensors) != count:
        raise InputError(
            f"model: {count} fictitious sources and {len(sensors)} sensors at the joint "
            f"({', '.join(sensors)}); give as many of one as of the other, at least one"
        )
    if [len(row) for row in model.distances] != [count] * count:
        raise InputError(
            f"model: the distances are not {count} rows of {count}; give r_ij from every source "
            "to every sensor at the joint"
        )
    for i, source in enumerate(model.sources, start=1):
        if set(source.applied) != set(axes):
            raise InputError(
                f"model: source {i} has axes {sorted(source.applied)}, the linear model "
                f"{sorted(axes)}; calibrate both for the same axes"
            )
    band = (dt_s, run_length_s, tolerance)
    direct = [
        _direct_bank(table.direct[role], *band, f"direct model of {role}") for role in sensors
    ]
    sources = inverse_bank(
        model.rings, [s.regularisation for s in model.sources], *band, "inverse of the sources"
    )
    return Assembly(
        model=model,
        dt_s=dt_s,
        run_length_s=run_length_s,
        heat=inverse_bank([[table.thermal]], [table.regularisation], *band, "inverse of ΔT"),
        linear=stacked([deformation_bank(table.deformation[axis]) for axis in axes]),
        temperature=stacked(direct),
        sources=leaking(sources, model.leak) if model.leak else sources,
        nonlinear=summed(
            [
                stacked([deformation_bank(source.applied[axis]) for axis in axes])
                for source in model.sources
            ]
        ),
    )


def _direct_bank(
    model: RingModel | Relaxation, dt_s: float, run_length_s: float, tolerance: float, what: str
) -> Bank:
    if isinstance(model, RingModel):
        return direct_bank(model, dt_s, run_length_s, tolerance, what)
    rates = np.array(model.rates)
    return simple_bank(-rates, np.array(model.amplitudes) * rates)
