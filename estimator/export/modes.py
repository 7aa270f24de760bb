"""Banks of exponential states as tables: what an interval does to every mode.

The same recursion as `models.filters.bank.over_interval`, mode by mode and complex, in a form that
keeps its digits in single precision, too:

- an increment is added to a state, not a state multiplied: x1 = x0 + (φ_0 - 1) x0 + ...;
- an inverse is written as 1/(s - p) = -1/p + s / (p (s - p)). Its residues, which nearly cancel,
  then see only the changes of the temperatures, and what stands still passes by one number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from artefacts.errors import InputError
from estimator.export.c_source import Operations
from models.filters.bank import Bank, phi_functions

#: Of a compensated sum, of a complex number.
_KEPT = Operations(additions=8)
#: φ functions of one mode by their series, and by the recursion.
_SERIES = Operations(28 * 6 + 4 * 4 + 4, 28 * 3 + 4 * 3 + 3, 29)
_RECURSION = Operations(24, 14, 1, 3)
#: What is made of them.
_INTERVAL = Operations(18, 7, 1)


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

    @property
    def states(self) -> int:
        """Number of complex states."""
        return len(self.poles) + len(self.double)

    @property
    def numbers(self) -> int:
        """Real numbers in its tables."""
        complex_ones = (self.poles, self.gain, self.double, self.nominal)
        real_ones = (self.drive, self.rest, self.slope)
        return 2 * sum(a.size for a in complex_ones) + sum(a.size for a in real_ones)


def on_lines(bank: Bank, dt: float) -> Modes:
    """Return a bank that takes straight lines and gives the mean over each interval.

    Raises
    ------
    InputError
        It has a double pole.
    """
    modes = _sorted(bank)
    if len(modes.double):
        raise InputError("export: an inverse with double poles has no program; assemble again")
    z, (_, phi1, phi2, _, _) = modes.poles * dt, phi_functions(modes.poles * dt)
    parts = (z * phi1, phi1 / modes.poles, phi1, phi2 / modes.poles)
    return _with_nominal(modes, np.stack(parts, axis=1))


def on_constants(bank: Bank, dt: float) -> Modes:
    """Return a bank whose inputs hold over each interval and that gives the value at its end."""
    modes = _sorted(bank)
    z, (phi0, phi1, phi2, _, _) = modes.poles * dt, phi_functions(modes.poles * dt)
    parts = (z * phi1, dt * phi1, dt * phi0, dt * dt * (phi1 - phi2))
    return _with_nominal(modes, np.stack(parts, axis=1))


def operations_on_lines(modes: Modes) -> Operations:
    """Return those of one sample at the nominal interval."""
    outputs, inputs = modes.rest.shape
    one = Operations(12 + inputs + 2 * outputs, 8 + inputs + 2 * outputs) + _KEPT
    direct = Operations(3, 3, 1).times(outputs * inputs)
    return one.times(len(modes.poles)) + direct + Operations(additions=inputs)


def operations_on_constants(modes: Modes) -> Operations:
    """Return those of one sample at the nominal interval."""
    outputs, inputs = modes.rest.shape
    one = Operations(6 + inputs + 2 * outputs, 4 + inputs + 2 * outputs) + _KEPT
    second = Operations(10 + 2 * outputs, 8 + 2 * outputs) + _KEPT
    return one.times(len(modes.poles)) + second.times(len(modes.double))


def operations_of_interval(modes: Modes) -> Operations:
    """Return what another interval than the nominal costs more, at most."""
    dearer = Operations(
        *(max(a, b) for a, b in zip(_flat(_SERIES), _flat(_RECURSION), strict=True))
    )
    return (dearer + _INTERVAL).times(len(modes.poles))


def _flat(one: Operations) -> tuple[int, int, int, int]:
    return one.multiplications, one.additions, one.divisions, one.functions


def _sorted(bank: Bank) -> Modes:
    twice = (bank.double != 0.0).any(axis=0)
    order = np.concatenate((np.flatnonzero(twice), np.flatnonzero(~twice)))
    return Modes(
        poles=bank.poles[order],
        drive=bank.drive[order],
        gain=bank.gain.T[order],
        double=bank.double.T[np.flatnonzero(twice)],
        rest=bank.constant - ((bank.gain / bank.poles) @ bank.drive).real,
        slope=bank.slope,
        nominal=np.empty((0, 0), dtype=complex),
    )


def _with_nominal(modes: Modes, nominal: np.ndarray) -> Modes:
    return Modes(
        modes.poles, modes.drive, modes.gain, modes.double, modes.rest, modes.slope, nominal
    )
