"""The calibrated model: every parameter of Tables 1-3, in SI, as frozen data.

`calibrate` fits it, `estimator` runs it, `thermojoint.models.model_file` stores it as JSON; the
types of these classes define the valid content of a file. The heat input is relative to the
reference step (dimensionless), so `K` is in kelvin per unit of heat input.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field

from pydantic import ConfigDict, NonNegativeFloat, PositiveFloat

from thermojoint.artefacts.display import Described

#: Unknown keys, numbers given as text, NaN and infinity are refused.
STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class RingModel:
    """Generalised thermal model (Eqs. 1-3): a ring source on a plate that convects."""

    __pydantic_config__ = STRICT

    #: Gain, K per unit heat input.
    K: float
    #: Convection parameter, 1/m2.
    a: PositiveFloat
    #: Apparent diffusivity, m2/s.
    alpha: PositiveFloat
    #: Distance of the point and radius of the ring, m.
    r: NonNegativeFloat
    r0: PositiveFloat


@dataclass(frozen=True)
class Regularisation:
    """Regularisation function f_R = (A t + B t2) exp(-gamma t) (Eq. 7); K/s, K/s2 and 1/s.

    Its unit is that of the step response it is added to: K per unit heat input.
    """

    __pydantic_config__ = STRICT

    A: float
    B: float
    gamma: PositiveFloat


@dataclass(frozen=True)
class Relaxation:
    """Direct thermal model as a relaxation spectrum: sum of c_k (1 - exp(-lambda_k t))."""

    __pydantic_config__ = STRICT

    #: c_k, K per unit heat input.
    amplitudes: tuple[float, ...]
    #: lambda_k, 1/s, positive.
    rates: tuple[PositiveFloat, ...]


@dataclass(frozen=True)
class DeformationModel:
    """Step response of a displacement (Eq. 8; Eq. 18 with the last term).

    C + D - C exp(-c t) - D exp(-d t) + E t exp(-e t) + F t exp(-f t), with C, D in m per unit of
    heat input, E, F in m/s per unit and the rates in 1/s. Eq. 8 has F = f = 0.
    """

    __pydantic_config__ = STRICT

    C: float
    D: float
    E: float
    c: PositiveFloat
    d: PositiveFloat
    e: PositiveFloat
    F: float = 0.0
    f: NonNegativeFloat = 0.0


@dataclass(frozen=True)
class LinearModel:
    """Table 1: the linear response of the structure, calibrated at the reference input."""

    __pydantic_config__ = STRICT

    #: Heat input to temperature difference (a) - (b).
    thermal: RingModel
    #: f_R of its inverse.
    regularisation: Regularisation
    #: Axis name (e.g. "x", "y") to its Eq. 8 model.
    deformation: dict[str, DeformationModel]
    #: Sensor role ("T1", "T2") to the model of its temperature rise (block 3 of Figure 5).
    direct: dict[str, RingModel | Relaxation]


@dataclass(frozen=True)
class FictitiousSource:
    """One fictitious contact heat source: its row of Tables 2 and 3."""

    __pydantic_config__ = STRICT

    #: Parameters as in `RingModel`; the distances are in `Model.distances`.
    K: float
    a: PositiveFloat
    alpha: PositiveFloat
    r0: PositiveFloat
    #: Calibration heat input to the source's step strength q at this input.
    strengths: dict[float, float]
    #: f_R of its inverse.
    regularisation: Regularisation
    #: Axis name to the Eq. 18 model per unit strength, calibrated to steps (Table 3).
    deformation: dict[str, DeformationModel]
    #: The same, calibrated to the strengths that the inverse filters estimate
    #: (`calibrate.driven_deformation`). Preferred by the estimator; empty in the paper's scheme.
    driven: dict[str, DeformationModel] = field(default_factory=dict)

    @property
    def applied(self) -> dict[str, DeformationModel]:
        """The deformation models that the estimator uses."""
        return self.driven or self.deformation


@dataclass(frozen=True)
class Span:
    """Calibrated ranges; beyond them a model extrapolates."""

    __pydantic_config__ = STRICT

    #: Length of the calibration runs from rest, s.
    duration_s: PositiveFloat
    #: Smallest and largest heat input, rest included, 1.
    heat: tuple[float, float]
    #: Channel ("delta_T", "T1", ...) to its smallest and largest value, K.
    temperatures: dict[str, tuple[float, float]]


@dataclass(frozen=True, repr=False)
class Model(Described):
    """Everything the estimator of Figure 5 needs.

    Attributes
    ----------
    linear : LinearModel
        Table 1.
    sources : tuple of FictitiousSource
        Tables 2 and 3.
    distances : tuple of tuple of float
        r_ij, m: from source i to sensor T_j, fixed by the geometry (Eq. 16).
    sensors : dict
        Role ("a", "b", "T1", "T2") to the position in m.
    reference_power_W : float
        Heat at heat input 1, W, as stated in the reference response. A simulated response states
        the case's value: for a single source the power per source or in total, depending on its
        ``reading``; for several sources their sum.
    span : Span
        Calibrated ranges.
    leak : float
        Rate at which a constant deviation ∂T decays from the strengths, 1/s, since deviations
        longer than the calibration cannot be distinguished from errors of block 3. 0 in the paper's
        scheme.
    """

    __pydantic_config__ = STRICT

    linear: LinearModel
    sources: tuple[FictitiousSource, ...]
    distances: tuple[tuple[PositiveFloat, ...], ...]
    sensors: dict[str, tuple[float, float, float]]
    reference_power_W: PositiveFloat
    span: Span
    leak: NonNegativeFloat = 0.0

    def _facts(self) -> dict[str, str]:
        return {
            "axes": ", ".join(self.linear.deformation),
            "fictitious sources": str(len(self.sources)),
            "sensors": ", ".join(self.sensors),
            "calibrated": f"{self.span.duration_s / 60.0:g} min",
        }

    @property
    def rings(self) -> list[list[RingModel]]:
        """``rings[i][j]``: source i to sensor j (Eq. 16)."""
        return [
            [RingModel(source.K, source.a, source.alpha, r, source.r0) for r in row]
            for source, row in zip(self.sources, self.distances, strict=True)
        ]

    @property
    def digest(self) -> str:
        """Digest of all parameters."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()
