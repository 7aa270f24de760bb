"""Export of banks of exponential states: propagation over an interval as tables.

The same recursion as `thermojoint.models.filters.bank.over_interval`, mode by mode and complex, in
a form that keeps its digits in single precision, too:

- an increment is added to a state, not a state multiplied: x1 = x0 + (φ_0 - 1) x0 + ...;
- an inverse is written as 1/(s - p) = -1/p + s / (p (s - p)). Its residues, which nearly cancel,
  then see only the changes of the temperatures, and what stands still passes by one number;
- the leak s/(s + λ) is a stage of its own, as in Python.

With w' = -λ w + u' and u' constant, w' = exp(-λ t) c, c = u' - λ w0, so that the modes
v' = p v + w'/p are known in closed form by the divided differences φ_k[-λ dt, p dt].
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from estimator.export.program import Operations
from thermojoint.artefacts.errors import InputError
from thermojoint.models.filters.bank import Bank
from thermojoint.models.filters.phi import divided_differences, phi_functions

#: Of a compensated sum, of a complex number.
_KEPT = Operations(additions=8)
#: φ functions of one mode by their series, and by the recursion.
_SERIES = Operations(28 * 6 + 4 * 4 + 4, 28 * 3 + 4 * 3 + 3, 29)
_RECURSION = Operations(24, 14, 1, 3)
#: What is made of them, and the two ways to the divided difference of φ_1.
_CONSTANT_STEP = Operations(14, 5)
_LINE_STEP = Operations(30, 13, 1, 4)
_MEAN_SERIES, _MEAN_RECURSION = Operations(27 * 12, 27 * 8, 27 * 2), Operations(4, 4, 2)


@dataclass(frozen=True, eq=False)
class Modes:
    """A bank whose modes with a double pole stand first; m modes, d of them double.

    Attributes
    ----------
    poles : ndarray of complex, shape (m,)
        1/s.
    drive : ndarray, shape (m, n_in)
    gain : ndarray of complex, shape (m, n_out)
    double : ndarray of complex, shape (d, n_out)
    rest, slope : ndarray, shape (n_out, n_in)
        What it gives of an input that stands still, and the slope.
    leak : float
        λ, 1/s.
    flow : ndarray, shape (2,)
        dt φ_1 and dt φ_2 of -λ dt, at the nominal interval, s.
    nominal : ndarray of complex, shape (m, columns)
        What the nominal interval does; columns as in the structures of the template.
    """

    poles: np.ndarray
    drive: np.ndarray
    gain: np.ndarray
    double: np.ndarray
    rest: np.ndarray
    slope: np.ndarray
    nominal: np.ndarray
    leak: float = 0.0
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
    """Return a bank that takes straight lines and gives the mean over each interval.

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
    flow = [dt * float(one.real[0]) for one in phi_functions(np.array([at + 0j]))[1:3]]
    return replace(modes, nominal=np.stack(parts, axis=1), leak=bank.leak, flow=np.array(flow))


def on_constants(bank: Bank, dt: float) -> Modes:
    """Return a bank whose inputs hold over each interval and that gives the value at its end."""
    modes = _sorted(bank)
    z, (phi0, phi1, phi2, _, _) = modes.poles * dt, phi_functions(modes.poles * dt)
    parts = (z * phi1, dt * phi1, dt * phi0, dt * dt * (phi1 - phi2))
    return replace(modes, nominal=np.stack(parts, axis=1))


def operations_on_lines(modes: Modes) -> Operations:
    """Return those of one sample at the nominal interval."""
    outputs, inputs = modes.rest.shape
    one = Operations(12 + inputs + 2 * outputs, 8 + inputs + 2 * outputs) + _KEPT
    direct = Operations(4, 3, 1).times(outputs * inputs) + Operations(2, 6, 1).times(inputs)
    return one.times(len(modes.poles)) + direct


def operations_on_constants(modes: Modes) -> Operations:
    """Return those of one sample at the nominal interval."""
    outputs, inputs = modes.rest.shape
    one = Operations(6 + inputs + 2 * outputs, 4 + inputs + 2 * outputs) + _KEPT
    second = Operations(10 + 2 * outputs, 8 + 2 * outputs) + _KEPT
    return one.times(len(modes.poles)) + second.times(len(modes.double))


def operations_of_interval(modes: Modes, on_lines: bool) -> Operations:
    """Return what another interval than the nominal costs more, at most."""
    phi = _dearer(_SERIES, _RECURSION)
    if not on_lines:
        return (phi + _CONSTANT_STEP).times(len(modes.poles))
    one = phi.times(2) + _LINE_STEP + _dearer(_MEAN_SERIES, _MEAN_RECURSION + phi)
    return one.times(len(modes.poles)) + phi + Operations(3)


def _dearer(one: Operations, other: Operations) -> Operations:
    """At most either."""
    return Operations(
        max(one.multiplications, other.multiplications),
        max(one.additions, other.additions),
        max(one.divisions, other.divisions),
        max(one.functions, other.functions),
    )


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
