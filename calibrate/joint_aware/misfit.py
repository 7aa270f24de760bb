"""Whitened residuals of calibration runs: measured minus simulated temperatures and displacements.

A sensor's error in a run is that of the physics, f(theta), minus the part explained by the
discrepancy and a constant offset of the sensor: both are linear, with normal priors, and are
eliminated by ridge regression (`discrepancy.Ridge`). A displacement has no offset: it is zero at
rest by definition.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.signal import lfilter

from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.reduced.discrepancy import (
    SHARE,
    Discrepancy,
    Ridge,
    make_ridge,
    relaxation_rates,
    relaxed,
    told_by,
)
from thermojoint.reduced.machine import ReducedMachine, diagonal_basis, on_basis
from thermojoint.reduced.parameters import Parameter, factors_of, lag_name, with_factors
from thermojoint.reduced.physics import (
    Physics,
    at_start,
    make_physics,
    simulate_known,
    starting_under,
)


@dataclass(frozen=True)
class Sigmas:
    """Errors of model and sensors assumed in a fit.

    The confidence bands that follow from them are checked on drawn machines (``make plants``,
    docs/joint-aware.md).
    """

    #: Most samples of a run that are used.
    samples: int = 120
    #: Assumed model error for every sample, K and m. Model errors persist from sample to sample, so
    #: that a whole run has little more information than one sample: these are errors of 0.03 K and
    #: 0.05 um that last for a run.
    temperature: float = 0.3
    displacement: float = 0.5e-6
    #: Of few readings of a displacement each has a smaller one, as errors last for a run, but not
    #: below this noise of a probe, m.
    reading: float = 0.2e-6
    #: The same for the discrepancy, which is fitted to the rest sample by sample, K and m.
    discrepancy_temperature: float = 0.03
    discrepancy_displacement: float = 1e-7
    #: Sensors with errors below this, K, or below the median error have equal weight.
    alike: float = 0.005
    #: Prior standard deviation of a sensor's offset, K.
    offset: float = 0.3


#: The defaults.
SIGMAS = Sigmas()
#: Prefixes of the names of parameters that change the shape of the modes.
TURNING = ("film", "conduction")


@dataclass(frozen=True, eq=False)
class Run:
    """One calibration run on the steps of the march."""

    #: Shape (n, s + h + 1 + v): heat of each source according to the case, W, held surfaces and
    #: ambient, K, and factors of the loads that change, at the end of each step.
    inputs: Array
    #: Shape (k,): samples that are used, s.
    times: Array
    #: Shape (k, p): K.
    temperature: Array
    #: Shape (k, axes): m; NaN where it was not read.
    displacement: Array
    #: Of a step, s.
    length: float
    #: Shape (n, x): travel of each axis in each step, m; None for the change of its position.
    gone: Array | None = None
    #: Shape (l,): factors of the loads that change, at time zero; None for those of the case.
    loads: Array | None = None
    #: Whether the displacement is relative to the first reading of each axis, at whatever time.
    zeroed: bool = False

    @property
    def read(self) -> Flags:
        """Whether a displacement was read in a sample, (k, axes)."""
        return np.isfinite(self.displacement)

    def beyond(self, moved: Array) -> Array:
        """Return the readings less a displacement (k, axes), m; NaN where there is no reading."""
        every = self.displacement - moved
        if self.zeroed:
            every = every - every[self.read.argmax(axis=0), np.arange(every.shape[1])]
        return every

    def weighted(self, values: Array, axis: int) -> Array:
        """Return values (k, ...) as a fit has them at readings along an axis, 0 elsewhere.

        They are weighted. Where all have the error of their zero, they are relative to their mean.
        """
        read, shown = self.read[:, axis], np.zeros_like(values)
        zero = values[read].mean(axis=0) if self.zeroed else 0.0
        shown[read] = self.weight(axis) * (values[read] - zero)
        return shown

    def weight(self, axis: int) -> float:
        """Return the weight of a reading along an axis.

        Errors of a model persist, so that few readings tell as much of them as many do, up to their
        noise (`SIGMAS`).
        """
        few = math.sqrt(self.times.size / np.count_nonzero(self.read[:, axis]))
        return min(few, SIGMAS.displacement / SIGMAS.reading)


def largest_displacement(runs: Sequence[Run]) -> Array:
    """Return the largest displacement of some runs along every axis, (axes,), m."""
    return np.asarray(np.max([np.nanmax(np.abs(run.displacement), axis=0) for run in runs], axis=0))


def counted_in(run: Run, axes: Sequence[int]) -> Array:
    """Return the odometers of some axes (c,) at the samples of a run, (k, c), m."""
    if run.gone is None:
        return np.zeros((run.times.size, 0))
    grid = run.length * np.arange(len(run.gone) + 1.0)
    whole = np.pad(np.cumsum(run.gone, axis=0), ((1, 0), (0, 0)))[:, list(axes)]
    counted = [np.interp(run.times, grid, column) for column in whole.T]
    return np.array(counted).reshape(whole.shape[1], run.times.size).T


def joined(run: Run, factor: int) -> Run:
    """Return a run in steps `factor` times as long: means of its inputs, sums of the travel."""
    count = math.ceil(len(run.inputs) / factor)

    def means(values: Array) -> Array:
        padded = np.pad(values, ((0, factor * count - len(values)), (0, 0)), mode="edge")
        return np.asarray(padded.reshape(count, factor, -1).mean(axis=1))

    gone = None if run.gone is None else factor * means(run.gone)
    return replace(run, inputs=means(run.inputs), length=factor * run.length, gone=gone)


def searched(machine: ReducedMachine, runs: Sequence[Run], steps: int) -> list[Run]:
    """Return the runs for the marches of a search: in at most this many steps.

    Runs in which an axis moves are not changed: longer steps would miss most of its travel, and
    with it the friction heat that distinguishes preload from heat.
    """
    axes = len(machine.axis_names)
    return [
        run
        if np.ptp(run.inputs[:, run.inputs.shape[1] - axes :], axis=0).any()
        else joined(run, math.ceil(len(run.inputs) / steps))
        for run in runs
    ]


def fewer(run: Run) -> Run:
    """Return a run with few samples (`SIGMAS`); the first one, at rest, determines the offsets.

    Of displacements that are read in some samples only, as many readings are kept.
    """
    rows = [np.arange(run.times.size), *map(np.flatnonzero, run.read.T)]
    kept = np.unique(
        np.concatenate([every[:: max(1, math.ceil(every.size / SIGMAS.samples))] for every in rows])
    )
    return replace(
        run,
        times=run.times[kept],
        temperature=run.temperature[kept],
        displacement=run.displacement[kept],
    )


@dataclass(frozen=True, eq=False)
class Problem:
    """Calibration runs of a machine, prepared for comparison with it."""

    #: As described by the case.
    machine: ReducedMachine
    #: From rest.
    runs: Sequence[Run]
    #: Shape (q,): of the discrepancy, 1/s.
    rates: Array
    #: Shape (n, s q): relaxations of the heat at the samples of all runs.
    states: Array
    #: Shape (axes, n, s q): the relaxations as a fit has them at readings of the displacement.
    seen: Array
    #: Shape (s q,): 1 where a gain is fitted, 0 where the runs are too short for it.
    shape: Array
    #: Sensor by sensor; the last column of each is its offset.
    temperature: tuple[Channel, ...]
    #: Axis by axis.
    displacement: tuple[Channel, ...]
    #: Shape (p,): factor on the error of a temperature for every sensor.
    trust: Array
    #: Factor on all of them, prior sizes of the discrepancy included (`doubt_of`).
    doubt: float = 1.0

    @property
    def read(self) -> Flags:
        """Whether a displacement was read in a sample, (n, axes)."""
        return np.vstack([run.read for run in self.runs])


@dataclass(frozen=True, eq=False)
class Channel:
    """A measured channel of all runs, concatenated."""

    #: Its linear part.
    ridge: Ridge
    #: Prior standard deviation of a gain, K or m; zero for a channel that does not move.
    tau: float
    #: Root mean square weight of its readings: their noise in them is larger by this.
    weight: float = 1.0

    def whitened(self, errors: Array, sigma: float) -> Array:
        """Return the unexplained part of errors (n,), in units of sigma."""
        return self.ridge.whitened(errors, sigma, self.tau) if self.tau else np.zeros(0)

    def gains(self, errors: Array, sigma: float) -> tuple[Array, Array]:
        """Return the gains that explain errors (n,), and the residual."""
        if not self.tau:
            return np.zeros(self.ridge.shape.size), errors
        return self.ridge.gains(errors, self.weight * sigma, self.tau)


def highest_heat(machine: ReducedMachine, runs: Sequence[Run]) -> float:
    """Return the largest heat of any source in some runs, relative to that of the case."""
    sources = machine.power.size
    each = (float(np.abs(run.inputs[:, :sources] / machine.power).max()) for run in runs)
    return max(each, default=0.0)


def make_problem(machine: ReducedMachine, runs: Sequence[Run]) -> Problem:
    """Return the calibration problem of a machine and its runs."""
    rates = relaxation_rates()
    sources = machine.power.size
    each = [
        sampled(relaxed(run.inputs[:, :sources] / machine.power, rates, run.length), run)
        for run in runs
    ]
    states = np.vstack(each)
    level = highest_heat(machine, runs)
    longest = max(run.length * len(run.inputs) for run in runs)
    shape = np.tile(told_by(rates, longest), sources)
    seen = np.array(
        [
            np.vstack([run.weighted(part, axis) for run, part in zip(runs, each, strict=True)])
            for axis in range(len(machine.axes))
        ]
    )
    constant = np.column_stack([states, np.ones(len(states))])

    def with_offset(tau: float) -> Array:
        return np.append(shape, SIGMAS.offset / tau if tau else 0.0)

    warmest = np.max([np.abs(run.temperature).max(axis=0) for run in runs], axis=0)
    sensed, moved = SHARE / level * warmest, SHARE / level * largest_displacement(runs)
    return Problem(
        machine,
        runs,
        rates,
        states,
        seen,
        shape,
        tuple(Channel(make_ridge(constant, with_offset(tau)), tau) for tau in sensed),
        tuple(
            Channel(make_ridge(own, shape), tau, _usual_weight(runs, axis))
            for axis, (own, tau) in enumerate(zip(seen, moved, strict=True))
        ),
        np.ones(len(machine.sensors)),
    )


def _usual_weight(runs: Sequence[Run], axis: int) -> float:
    """Root mean square weight of the readings of the displacement along an axis."""
    counts = [np.count_nonzero(run.read[:, axis]) for run in runs]
    return math.sqrt(np.average([run.weight(axis) ** 2 for run in runs], weights=counts))


def sampled(values: Array, run: Run, first: Array | None = None) -> Array:
    """Return values (n, c) after each step, `first` (c,) or zero before, at the samples, (k, c)."""
    grid = run.length * np.arange(len(values) + 1)
    whole = np.vstack([np.zeros(values.shape[1]) if first is None else first, values])
    return np.column_stack([np.interp(run.times, grid, column) for column in whole.T])


def errors(
    problem: Problem, parameters: tuple[Parameter, ...], coordinates: Array
) -> tuple[Array, Array]:
    """Return runs minus machine: temperature (k, p), weighted displacement (k, axes).

    Parameters
    ----------
    problem : Problem
        The runs.
    parameters : tuple of Parameter
        Parameters that differ from the case.
    coordinates : ndarray, shape (parameters,)
        Of their factors.

    Raises
    ------
    ConvergenceError
        The machine cannot be marched through the runs.
    """
    factors = factors_of(parameters, coordinates)
    lags = [factors.pop(lag_name(sensor), 0.0) for sensor in problem.machine.sensor_names]
    marched = _marched(problem.machine, tuple(problem.runs), tuple(factors.items()))
    temperature, displacement = [], []
    for run, ((warm, bent), (sensed, moved)) in zip(problem.runs, marched, strict=True):
        read = _lagged(sensed - warm, lags, run.length) + warm if any(lags) else sensed
        temperature.append(run.temperature - sampled(read, run, warm))
        apart = run.displacement - sampled(moved, run, bent)
        each = [run.weighted(column, axis) for axis, column in enumerate(apart.T)]
        displacement.append(np.column_stack(each))
    return np.vstack(temperature), np.vstack(displacement)


def best_lags(
    problem: Problem, parameters: tuple[Parameter, ...], coordinates: Array, lags: Sequence[float]
) -> Array:
    """Return the coordinates (k,) with the one of `lags` (s) that fits every sensor best.

    The misfit has a minimum at zero and another one at the lag of a sensor: a search only finds
    the one on whose side it begins.
    """
    found, names = coordinates.copy(), [parameter.name for parameter in parameters]
    sensors = problem.machine.sensor_names
    lagging = [k for k, sensor in enumerate(sensors) if lag_name(sensor) in names]
    at = [names.index(lag_name(sensors[k])) for k in lagging]
    # The lag of a sensor does not affect the others, so that all are given the same.
    costs = np.empty((len(lags), len(lagging)))
    for lag, cost in zip(lags, costs, strict=True):
        found[at] = lag
        left, _ = errors(problem, parameters, found)
        for k, sensor in enumerate(lagging):
            sigma = problem.trust[sensor] * SIGMAS.temperature
            white = problem.temperature[sensor].whitened(left[:, sensor], sigma) / problem.doubt
            cost[k] = white @ white + (lag / parameters[at[k]].spread) ** 2
    found[at] = np.array(lags)[costs.argmin(axis=0)]
    return found


# Lags of sensors do not affect a march.
@lru_cache(maxsize=2)
def _marched(
    machine: ReducedMachine, runs: tuple[Run, ...], factors: tuple[tuple[str, float], ...]
) -> list[tuple[tuple[Array, Array], tuple[Array, Array]]]:
    """Sensors and displacement at the start and in the steps of runs, of a machine with factors."""
    physics = physics_with(machine, dict(factors))
    each = [physics if run.loads is None else starting_under(physics, run.loads) for run in runs]
    return [
        (at_start(own), simulate_known(own, run.inputs, run.length, run.gone))
        for own, run in zip(each, runs, strict=True)
    ]


def _lagged(values: Array, lags: Sequence[float], length: float) -> Array:
    """Values (n, p) from rest through first-order lags, s, by the implicit steps of the modes."""
    read = values.copy()
    for sensor, lag in enumerate(lags):
        if lag > 0.0:
            part = lag / (lag + length)
            read[:, sensor] = lfilter([1.0 - part], [1.0, -part], values[:, sensor])
    return read


def physics_with(machine: ReducedMachine, factors: dict[str, float]) -> Physics:
    """Return the physics of a machine with changed parameters, for one run or a few.

    The modes assume the joint of the case, whatever its parameters: a march does not depend on this
    assumption, and so they are recomputed for a changed convection or conduction only. On several
    axes, or with a drive, they assume none (`thermojoint.reduced.axes_march`).
    """
    other, held = with_factors(machine, factors), assumed(machine)
    modes = on_basis(other, *basis_with(machine, factors), held)
    return make_physics(modes, other.joints, held)


def basis_with(machine: ReducedMachine, factors: dict[str, float]) -> tuple[Array, Array]:
    """Return rates (k,) and basis (r, k) of the modes of `physics_with`."""
    turning = {name: value for name, value in factors.items() if name.startswith(TURNING)}
    rates, basis = _basis(machine, tuple(turning.items()))
    # Held surfaces have no capacity.
    scale = np.ones(rates.size)
    scale[: rates.size - len(machine.held.names)] = factors.get("capacity", 1.0)
    return rates / scale, basis / np.sqrt(scale)


@lru_cache(maxsize=4)
def _basis(machine: ReducedMachine, turning: tuple[tuple[str, float], ...]) -> tuple[Array, Array]:
    return diagonal_basis(with_factors(machine, dict(turning)), assumed(machine))


def assumed(machine: ReducedMachine) -> Array:
    """Return conductance times area (m,), W/K, that the modes of a march include."""
    guide = machine.guide
    free = guide is not None and (len(guide.axes) > 1 or guide.drives.any)
    return np.zeros_like(machine.at_preload) if free else machine.at_preload


def residuals(problem: Problem, parameters: tuple[Parameter, ...], coordinates: Array) -> Array:
    """Return everything that neither parameters nor linear part explain, in units of sigma."""
    return whitened(problem, np.hstack(errors(problem, parameters, coordinates)))


def whitened(problem: Problem, left: Array) -> Array:
    """Return errors (n, p + axes) without their linear part, one channel after the other.

    In units of sigma, shape (n (p + axes),) unless a channel does not move. It is linear in them.
    """
    sigmas = [*(problem.trust * SIGMAS.temperature)]
    sigmas += [SIGMAS.displacement] * len(problem.displacement)
    channels = (*problem.temperature, *problem.displacement)
    parts = [
        channel.whitened(column, sigma)
        for channel, column, sigma in zip(channels, left.T, sigmas, strict=True)
    ]
    return np.asarray(np.concatenate(parts) / problem.doubt)


def doubt_of(problem: Problem, left: Array) -> float:
    """Return the factor on the assumed errors that the residuals (n,) of a fit require, at least 1.

    By assumption a run weighs as much as one sample of every channel, so that the squares of a
    channel sum to the number of runs, or to those of its noise where that is more. Larger sums show
    that the machine deviates from its model beyond the parameters, which are then less certain.
    """
    sensed = np.ones((len(problem.states), len(problem.temperature)), dtype=bool)
    channels = (*problem.temperature, *problem.displacement)
    read = np.hstack([sensed, problem.read])[:, [channel.tau > 0.0 for channel in channels]]
    noise = read.sum(axis=0) * reading_noise(problem, left.reshape(read.T.shape).T, read) ** 2
    expected = float(np.maximum(noise, len(problem.runs)).sum())
    return max(1.0, problem.doubt * math.sqrt(float(left @ left) / expected))


@dataclass(frozen=True, eq=False)
class Linear:
    """Linear coefficients fitted at some parameters, and the residual."""

    discrepancy: Discrepancy
    #: Shape (p,): of every sensor, K.
    offset: Array
    #: Shape (k, p): residual, K.
    temperature: Array
    #: Shape (k, axes): residual, m.
    displacement: Array


def fit_linear(problem: Problem, temperature: Array, displacement: Array) -> Linear:
    """Return the discrepancy and the offsets that explain the errors, and the residual."""
    sensed = [
        channel.gains(column, SIGMAS.discrepancy_temperature)
        for channel, column in zip(problem.temperature, temperature.T, strict=True)
    ]
    moved = [
        channel.gains(column, SIGMAS.discrepancy_displacement)
        for channel, column in zip(problem.displacement, displacement.T, strict=True)
    ]
    gains = np.array([gain for gain, _ in sensed])
    return Linear(
        Discrepancy(problem.rates, gains[:, :-1], np.array([gain for gain, _ in moved])),
        gains[:, -1],
        np.column_stack([left for _, left in sensed]),
        np.column_stack([left for _, left in moved]),
    )


def trust_in(problem: Problem, left: Array) -> Array:
    """Return the factor on sigma of every sensor from its residuals in a fit, shape (p,).

    A sensor that the model cannot reproduce, in the contact plane or at an edge, where temperatures
    depend on the mesh, would bias the parameters. Its residual in the runs, without its noise,
    determines its weight.
    """
    own = np.mean(left**2, axis=0) - reading_noise(problem, left) ** 2
    errs = np.sqrt(np.maximum(own, 0.0))
    return np.asarray(np.maximum(errs / max(float(np.median(errs)), SIGMAS.alike), 1.0))


def reading_noise(problem: Problem, left: Array, read: Flags | None = None) -> Array:
    """Return the standard deviation (c,) of changes from reading to reading in `left`, (n, c).

    `read` (n, c) tells whether a sample has a reading; default all have.
    """
    read = np.ones(left.shape, dtype=bool) if read is None else read
    at = np.cumsum([len(run.times) for run in problem.runs])[:-1]

    def noise(column: Array, there: Flags) -> float:
        parts = zip(np.split(column, at), np.split(there, at), strict=True)
        changes = np.concatenate([np.diff(part[rows]) for part, rows in parts])
        return math.sqrt(0.5 * float(np.mean(changes**2)))

    return np.array([noise(*each) for each in zip(left.T, read.T, strict=True)])
