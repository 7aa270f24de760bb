"""Closed forms of the models that tests compare with."""

import numpy as np
from scipy.special import i0e, k0e

from thermojoint.models.parameters import DeformationModel, Regularisation


def initial_slope(model: DeformationModel) -> float:
    """Return dδ/dt at t = 0 after a unit step: C c + D d + E + F, m/s per unit heat input."""
    return model.C * model.c + model.D * model.d + model.E + model.F


def deformation_transfer(s: np.ndarray | complex, m: DeformationModel) -> np.ndarray:
    """Return s times the transform of Eqs. 8 and 18, m per unit: poles at minus the rates."""
    total = m.C * m.c / (s + m.c) + m.D * m.d / (s + m.d) + m.E * s / (s + m.e) ** 2
    return total + m.F * s / (s + m.f) ** 2 if m.F else total


def regularisation_function(t: np.ndarray, regularisation: Regularisation) -> np.ndarray:
    """Return f_R(t) (Eq. 7), K per unit heat input, shaped as `t` (s, >= 0)."""
    at = np.asarray(t, dtype=float)
    m = regularisation
    return (m.A + m.B * at) * at * np.exp(-m.gamma * at)


def steady_value(K: float, a: float, r: float, r0: float) -> float:
    """Return the temperature long after a unit step, K · I0(√a r<) · K0(√a r>), K per unit."""
    root = np.sqrt(a)
    inner, outer = min(r, r0), max(r, r0)
    scale = np.exp(root * (inner - outer))
    return float(K * i0e(root * inner) * k0e(root * outer) * scale)
