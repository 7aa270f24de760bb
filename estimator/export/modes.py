"""Export of banks of exponential states: propagation over an interval as tables.

The same recursion as `thermojoint.models.filters.bank.over_interval`, mode by mode and complex, in
a form that stays accurate in single precision:

- increments are added to a state instead of multiplying it: x1 = x0 + (φ_0 - 1) x0 + ...;
- an inverse is written as 1/(s - p) = -1/p + s / (p (s - p)). Its residues, which nearly cancel,
  then act only on temperature changes, and a constant passes through a single coefficient;
- the leak s/(s + λ) is a separate stage, as in Python.

With w' = -λ w + u' and u' constant, w' = exp(-λ t) c, c = u' - λ w0, so that the modes
v' = p v + w'/p are known in closed form by the divided differences φ_k[-λ dt, p dt].
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace

import numpy as np

from estimator.export.program import Operations
from thermojoint.artefacts.errors import InputError
from thermojoint.models.filters.bank import Bank
from thermojoint.models.filters.phi import divided_differences, phi_functions

#: Cost of a compensated sum of a complex number.
_KEPT = Operations(additions=8)
#: Cost of the φ functions of one mode by series and by recursion.
_SERIES = Operations(28 * 6 + 4 * 4 + 4, 28 * 3 + 4 * 3 + 3, 29)
_RECURSION = Operations(24, 14, 1, 3)
#: Cost of the coefficients, and of the divided difference of φ_1 in both ways.
_CONSTANT_STEP = Operations(14, 5)
_LINE_STEP = Operations(30, 13, 1, 4)
_MEAN_SERIES, _MEAN_RECURSION = Operations(27 * 12, 27 * 8, 27 * 2), Operations(4, 4, 2)


@dataclass(frozen=True, eq=False)
class Modes:
    """A bank, modes with double poles first; m modes, d of them double."""

    #: Shape (m,): 1/s.
    poles: np.ndarray
    #: Shape (m, n_in).
    drive: np.ndarray
    #: Shape (m, n_out).
    gain: np.ndarray
    #: Shape (d, n_out).
    double: np.ndarray
    #: Shape (n_out, n_in): response to a constant input, and its slope.
    rest: np.ndarray
    slope: np.ndarray
    #: Shape (m, columns): propagation over the nominal interval; columns as in the structures of
    #: the template.
    nominal: np.ndarray
    #: λ, 1/s.
    leak: float = 0.0
    #: Shape (2,): dt φ_1 and dt φ_2 of -λ dt, at the nominal interval, s.
    flow: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def states(self) -> int:
        """Number of complex states."""
        return len(self.poles) + len(self.double)

    @property
    def numbers(self) -> int:
        """Real numbers in its tables."""
        complex_ones = (self.poles, self.gain, self.double, self.nominal)
        real_ones = (self.drive, self.rest, self.slope, self.flow)
        return 2 * sum(a.size for a in complex_ones) + sum(a.size for a in real_ones)


def on_lines(bank: Bank, dt: float) -> Modes:
    """Return a bank for piecewise linear inputs whose output is the mean over each interval.

    Parameters
    ----------
    bank : Bank
        Without double poles; it may leak.
    dt : float
        Nominal interval, s.

    Raises
    ------
    InputError
        It has a double pole.
    """
    if (bank.double != 0.0).any():
        raise InputError("export: an inverse with double poles has no program; assemble again")
    modes = _sorted(bank)
    at = -bank.leak * dt
    direct, mean = divided_differences(at, modes.poles * dt)
    phi1 = phi_functions(modes.poles * dt)[1]
    parts = (modes.poles * dt * phi1, dt * direct / modes.poles, phi1, dt * mean / modes.poles)
    flow = [dt * float(phi.real[0]) for phi in phi_functions(np.array([at + 0j]))[1:3]]
    return replace(modes, nominal=np.stack(parts, axis=1), leak=bank.leak, flow=np.array(flow))


def on_constants(bank: Bank, dt: float) -> Modes:
    """Return a bank for piecewise constant inputs whose output is the value at the end."""
    modes = _sorted(bank)
    z, (phi0, phi1, phi2, _, _) = modes.poles * dt, phi_functions(modes.poles * dt)
    parts = (z * phi1, dt * phi1, dt * phi0, dt * dt * (phi1 - phi2))
    return replace(modes, nominal=np.stack(parts, axis=1))


def operations_on_lines(modes: Modes) -> Operations:
    """Return the operations of one sample at the nominal interval."""
    outputs, inputs = modes.rest.shape
    mode = Operations(12 + inputs + 2 * outputs, 8 + inputs + 2 * outputs) + _KEPT
    direct = Operations(4, 3, 1).times(outputs * inputs) + Operations(2, 6, 1).times(inputs)
    return mode.times(len(modes.poles)) + direct


def operations_on_constants(modes: Modes) -> Operations:
    """Return the operations of one sample at the nominal interval."""
    outputs, inputs = modes.rest.shape
    mode = Operations(6 + inputs + 2 * outputs, 4 + inputs + 2 * outputs) + _KEPT
    second = Operations(10 + 2 * outputs, 8 + 2 * outputs) + _KEPT
    return mode.times(len(modes.poles)) + second.times(len(modes.double))


def operations_of_interval(modes: Modes, on_lines: bool) -> Operations:
    """Return the extra operations, at most, of an interval other than the nominal one."""
    phi = _dearer(_SERIES, _RECURSION)
    if not on_lines:
        return (phi + _CONSTANT_STEP).times(len(modes.poles))
    mode = phi.times(2) + _LINE_STEP + _dearer(_MEAN_SERIES, _MEAN_RECURSION + phi)
    return mode.times(len(modes.poles)) + phi + Operations(3)


def _dearer(left: Operations, right: Operations) -> Operations:
    """Upper bound of the two costs."""
    return Operations(*map(max, astuple(left), astuple(right)))


def _sorted(bank: Bank) -> Modes:
    twice = (bank.double != 0.0).any(axis=0)
    order = np.concatenate((np.flatnonzero(twice), np.flatnonzero(~twice)))
    return Modes(
        poles=bank.poles[order],
        drive=bank.drive[order],
        gain=bank.gain.T[order],
        double=bank.double.T[np.flatnonzero(twice)],
        rest=bank.at_rest,
        slope=bank.slope,
        nominal=np.empty((0, 0), dtype=complex),
    )
