"""Steady Kalman filter of the linear part, and low-rank deviations of its covariance.

State: amplitudes of the modes, relaxations of the model discrepancy, heat of the sources, held
surfaces and ambient. With the joint at its preload one step is x' = F x + w, where F is diagonal
but for the columns of the inputs, which are random walks; readings are y = H x + v. The steady
covariance P before a reading solves the discrete Riccati equation. Any other covariance is
P + L L^T with a covariance factor L of few columns: an unknown start, missing readings, late
samples (`correct`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from estimator.joint_aware.riccati import predicted_covariance
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.discrepancy import Discrepancy
from thermojoint.reduced.machine import Modes


@dataclass(frozen=True)
class Noise:
    """Standard deviations assumed by the filter; per step for random walks."""

    #: Shape (p,): of one reading of each sensor, K.
    sensor: float | Array = 0.03
    #: Of one reading of the ambient, K.
    ambient_sensor: float = 0.05
    #: Of the heat of each source relative to its reference, per step.
    heat_walk: float = 0.05
    #: K per step.
    ambient_walk: float = 0.01
    #: Of the temperature of each held surface that changes, K per step.
    held_walk: float = 0.1
    #: Heat flow across each contact element, W, that the frozen conductance misses.
    joint_flow: float = 0.5
    #: Model errors of the readings that last for minutes, K, as an equivalent white noise. Only
    #: deviations from the steady covariance take it into account: an unknown start is learned from
    #: many samples, whose errors are not independent.
    lasting: float | Array = 3.0
    #: Heat of each face with thermometers that comes from no source, W, and how long it lasts, s.
    #: Zero where thermometers do not determine it (`calibrate.joint_aware.assembling.seen_heat`).
    unknown_heat: float = 0.0
    unknown_lasts: float = 4.0 * 3600.0


#: The defaults.
NOISE = Noise()


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """x' = F x with F = [[diag(decay), drive], [0, 1]], and the rows H of the readings."""

    #: Shape (d,): of the amplitudes and the relaxations over one step.
    decay: Array
    #: Shape (d, s + h + 1): per W of each source and K of the held surfaces and the ambient.
    drive: Array
    #: Shape (p + 1, d + s + h + 1): sensors, then the ambient's own.
    rows: Array

    @property
    def size(self) -> int:
        """Number of states."""
        return self.rows.shape[1]

    def advance(self, columns: Array) -> Array:
        """F times columns, shape (n, k)."""
        dynamic = self.decay.size
        advanced = np.empty(columns.shape)
        np.multiply(self.decay[:, None], columns[:dynamic], out=advanced[:dynamic])
        advanced[:dynamic] += self.drive @ columns[dynamic:]
        advanced[dynamic:] = columns[dynamic:]
        return advanced

    @property
    def matrix(self) -> Array:
        """F, shape (n, n)."""
        return self.advance(np.eye(self.size))


@dataclass(frozen=True, eq=False)
class SteadyFilter:
    """Precomputed data of the steady covariance P."""

    #: Shape (n, p + 1): P H^T.
    cross: Array
    #: Shape (p + 1, p + 1): H P H^T, without the readings' noise.
    innovation: Array
    #: Shape (p + 1,): variance of a reading, K2.
    noise: Array
    #: Shape (p + 1,): variance of lasting errors, K2 (`Noise`).
    lasting: Array
    #: Shape (n,): scale of every state, used to compare columns of a covariance.
    scale: Array
    #: Shape (s + h + 1,): standard deviation of the inputs' random walk per step: W and K; zero for
    #: those that are known and constant.
    walk: Array


def linear_system(
    modes: Modes, discrepancy: Discrepancy, power: Array, step: float
) -> LinearSystem:
    """Return the linear part of a machine with the joint at its preload."""
    inputs = modes.drive.shape[1]
    rates, sources = discrepancy.rates, power.size
    decay = 1.0 / (1.0 + step * np.concatenate([modes.rates, np.tile(rates, sources)]))
    drive = np.zeros((decay.size, inputs))
    count = modes.rates.size
    drive[:count] = step * decay[:count, None] * modes.drive
    for source in range(sources):
        at = slice(count + source * rates.size, count + (source + 1) * rates.size)
        drive[at, source] = (1.0 - decay[at]) / power[source]
    sensors = np.hstack(
        [modes.sensors, discrepancy.temperature, np.zeros((len(modes.sensors), inputs))]
    )
    ambient = np.zeros((1, sensors.shape[1]))
    ambient[0, -1] = 1.0
    return LinearSystem(decay, drive, np.vstack([sensors, ambient]))


def mean_entry(modes: Modes) -> Array:
    """Return the inputs (r, m) of the modes per W across each contact element.

    On an axis, heat flows between pads and the stations below, averaged over the stroke.
    """
    if modes.way is None:
        return modes.entry
    return np.asarray(modes.entry @ modes.way.stations.everywhere.coefficients.T)


def design_filter(
    system: LinearSystem, modes: Modes, walk: Array, step: float, noise: Noise, unknown: Array
) -> tuple[SteadyFilter, Array]:
    """Solve the Riccati equation of the linear part.

    Parameters
    ----------
    system : LinearSystem
        Of the machine over `step` (s).
    modes : Modes
        Of the machine.
    walk : ndarray, shape (s + h + 1,)
        As in `SteadyFilter`.
    step : float
        s.
    noise : Noise
        Of the readings and the joints.
    unknown : ndarray, shape (r, b)
        Change of the amplitudes in a step by unknown heat, one standard deviation each.

    Returns
    -------
    tuple of (SteadyFilter, ndarray of shape (n, n))
        The filter, and the covariance after a reading.

    Raises
    ------
    ConvergenceError
        No solution exists: the readings do not determine the inputs.
    """
    size, dynamic = system.size, system.decay.size
    entry = mean_entry(modes)
    walks = np.zeros((size, walk.size))
    walks[dynamic:] = np.diag(walk)
    walks[:dynamic] = system.drive * walk
    count = modes.rates.size
    flows = noise.joint_flow * step * system.decay[:count, None] * entry
    beside = np.pad(np.hstack([flows, unknown]), ((0, size - count), (0, 0)))
    source = np.hstack([walks, beside])
    readings = np.append(
        np.broadcast_to(np.square(noise.sensor), len(system.rows) - 1), noise.ambient_sensor**2
    )
    # Scaled by one step's walk of the inputs, amplitudes, W and K are of the same order.
    unit = np.concatenate([np.ones(dynamic), np.where(walk > 0.0, walk, 1.0)])
    matrix, rows = system.matrix * unit / unit[:, None], system.rows * unit
    source = source / unit[:, None]
    # Inputs that are known and constant have no covariance.
    open_ = np.flatnonzero(np.append(np.ones(dynamic, dtype=bool), walk > 0.0))
    before = np.zeros((size, size))
    before[np.ix_(open_, open_)] = predicted_covariance(
        matrix[np.ix_(open_, open_)], rows[:, open_], source[open_], readings
    )
    before = unit[:, None] * before * unit
    cross = before @ system.rows.T
    innovation = system.rows @ cross
    factor = cho_factor(innovation + np.diag(readings))
    every = np.broadcast_to(np.square(noise.lasting), len(readings) - 1)
    lasting = np.append(every, 0.0)
    after = before - cross @ cho_solve(factor, cross.T)
    steady = SteadyFilter(cross, innovation, readings, lasting, np.ones(size), walk)
    return steady, 0.5 * (after + after.T)


def with_errors(steady: SteadyFilter) -> SteadyFilter:
    """Return the filter of the states and, after them, of errors of the readings (p + 1,), K.

    In the steady covariance the errors are zero: only a covariance factor includes them.
    """
    none = np.zeros((len(steady.noise), len(steady.noise)))
    scale = np.concatenate([steady.scale, np.ones(len(none))])
    return replace(steady, cross=np.vstack([steady.cross, none]), scale=scale)


def correct(
    filter_: SteadyFilter,
    rows: Array,
    present: NDArray[np.int64],
    factor: Array,
    weight: float,
    doubt: float = 1.0,
) -> tuple[Array, Array]:
    """Return the gain for some readings, and the covariance factor after them.

    With S_s = H P H^T + R of the present readings, K_s = P H^T S_s^-1, X = (1 - K_s H) L and Y = H
    L, the covariance after them is P_s+ + X (1 + Y^T S_s^-1 Y)^-1 X^T, where P_s+ exceeds the
    steady one by the information of the missing readings. That is exact; for the correction of L,
    lasting errors are added to S_s, which slows it down.

    Parameters
    ----------
    filter_ : SteadyFilter
        The steady filter.
    rows : ndarray, shape (p + 1, n)
        H.
    present : ndarray of int, shape (q,)
        Indices of the present readings.
    factor : ndarray, shape (n, k)
        L before them.
    weight : float
        Factor on the variance of the readings: above 1 if they come more often than once a step.
    doubt : float, optional
        Share of the lasting errors that counts, as a standard deviation.

    Returns
    -------
    gain : ndarray, shape (n, q)
    covariance_factor : ndarray, shape (n, k + p + 1 - q)
        L after them.
    """
    # No indexing if every reading is present, as usual: it would take a third of the time.
    every = present.size == len(rows)
    own = np.s_[:] if every else present
    pairs = np.s_[:, :] if every else np.ix_(present, present)
    covariance = filter_.innovation + np.diag(weight * filter_.noise)
    seen = filter_.cross[:, own]
    # Few readings, many states: invert small matrices, then multiply.
    precision = np.linalg.inv(covariance[pairs])
    gain = seen @ precision
    lost = np.empty((len(seen), 0))
    if not every:
        absent = np.setdiff1d(np.arange(len(rows)), present)
        across = covariance[np.ix_(present, absent)]
        rest = covariance[np.ix_(absent, absent)] - across.T @ precision @ across
        unseen = filter_.cross[:, absent] - gain @ across
        lost = unseen @ np.linalg.inv(np.linalg.cholesky(rest)).T
    if not (present.size and factor.any()):
        return gain, np.hstack([factor, lost])
    seen_factor = rows[own] @ factor
    shifted = factor - gain @ seen_factor
    doubted = covariance + weight * doubt**2 * np.diag(filter_.lasting)
    solved = np.linalg.solve(doubted[pairs], seen_factor)
    root = np.linalg.cholesky(np.eye(factor.shape[1]) + seen_factor.T @ solved)
    inverse = np.linalg.inv(root)
    left = shifted @ inverse.T
    more = left @ (inverse @ solved.T)
    return gain + more, np.hstack([left, lost])


def compressed(factor: Array, scale: Array, count: int) -> Array:
    """Return a factor (n, k) of at most `count` columns that is nearest to L in units of `scale`.

    A factor with no more columns is returned as it is.
    """
    if factor.shape[1] > count:
        unit = np.where(scale > 0.0, scale, 1.0)[:, None]
        relative = factor / unit
        values, turn = np.linalg.eigh(relative.T @ relative)
        largest = np.argsort(values)[::-1][:count]
        return factor @ turn[:, largest]
    return factor
