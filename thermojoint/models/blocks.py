"""Single blocks of Figure 5 driven by given signals, to attribute errors.

Each function is one part of `estimator.fchs.stream` with the same interpolation: heat is constant
over the interval that ends at its sample, temperatures are interpolated linearly.
"""

from __future__ import annotations

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.models.assembly import Assembly
from thermojoint.models.filters.bank import respond_to_line, respond_to_steps


def heat_part(assembly: Assembly, times: np.ndarray, delta_T: np.ndarray) -> np.ndarray:
    """Return Q̂, shape (k,), from ΔT (K, shape (k,)) at `times` (s, shape (k,)): block 1."""
    inputs = _checked(times, np.asarray(delta_T)[:, None], 1, "ΔT")
    return respond_to_line(assembly.heat, times, inputs, assembly.dt_s)[0][:, 0]


def linear_part(assembly: Assembly, times: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """Return δ_L (m, shape (k, axes)) from a given heat input (1, shape (k,)): block 2."""
    inputs = _checked(times, np.asarray(heat)[:, None], 1, "heat")
    return respond_to_steps(assembly.linear, times, inputs, assembly.dt_s)


def deviations(
    assembly: Assembly, times: np.ndarray, heat: np.ndarray, temperatures: np.ndarray
) -> np.ndarray:
    """Return ∂T = T - T_lin (K, shape (k, n)) from a given heat input and T: block 3."""
    inputs = _checked(times, np.asarray(heat)[:, None], 1, "heat")
    measured = _checked(times, temperatures, assembly.n_sources, "T")
    return measured - respond_to_steps(assembly.temperature, times, inputs, assembly.dt_s)


def source_part(assembly: Assembly, times: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Return q̂ (1, shape (k, n)) from given deviations ∂T (K, shape (k, n)): blocks 4 and 5."""
    inputs = _checked(times, deviation, assembly.n_sources, "∂T")
    return respond_to_line(assembly.sources, times, inputs, assembly.dt_s)[0]


def displacement_part(assembly: Assembly, times: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """Return δ_NL (m, shape (k, axes)) from given strengths q (1, shape (k, n)): blocks 6 and 7."""
    inputs = _checked(times, sources, assembly.n_sources, "q")
    return respond_to_steps(assembly.nonlinear, times, inputs, assembly.dt_s)


def nonlinear_part(assembly: Assembly, times: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Return δ_NL (m, shape (k, axes)) from given deviations ∂T: blocks 4 to 7."""
    return displacement_part(assembly, times, source_part(assembly, times, deviation))


def _checked(times: np.ndarray, values: np.ndarray, width: int, what: str) -> np.ndarray:
    """Return `values` as floats of shape (k, width); InputError names an unusable sample."""
    table = np.asarray(values, dtype=float)
    if table.shape != (len(times), width):
        raise InputError(f"{what}: shape {table.shape}, expected {(len(times), width)}")
    backwards = np.flatnonzero(~(np.diff(times) > 0.0))
    if backwards.size:
        index = int(backwards[0]) + 1
        raise InputError(f"{what}: sample {index} at {times[index]:g} s: time does not increase")
    bad = np.argwhere(~np.isfinite(table))
    if bad.size:
        index = int(bad[0][0])
        raise InputError(
            f"{what}: sample {index} at {times[index]:g} s is not finite; leave it out"
        )
    return table
