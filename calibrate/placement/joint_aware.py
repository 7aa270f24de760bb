"""Sensor placement for the joint-aware estimator: greedy search with exchange.

The family consists of machines that a calibration cannot distinguish: drawn from its posterior,
each with the linear discrepancy that gives it the same calibration responses. They march, joint
included, through a random day, like the nominal machine. Their differences from it act as model
errors of an observer of the nominal machine. With the steady filter of a set of sensors the mean
square error of the displacement is

    v = D P+ D^T + mean over plants and time of |D e - d|^2,    e' = F e,  e <- e + K (u - H e),

P+ the covariance after a reading (unknown heat, ambient, flows across the joint, noise), u the
difference of a plant's sensor readings from the nominal machine, d that of its displacement. The
criterion is the sum of v over the axes. For a set that detects heat late the first part is large,
for one at places where the plants differ the second one. On a machine with moving axes D and d are
those of several places of its working volume, and v is that of the place where it is largest.

With an unknown start (`plant_family.with_start`) the variance that it leaves after `SETTLED` is
added: its covariance factor L goes through the same filter, which corrects it as the observer does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calibrate.joint_aware.sticking import tangents_at
from calibrate.placement.plant_family import Family, loudest, make_family
from estimator.joint_aware.band import WIDTH
from estimator.joint_aware.filter_design import NOISE, Noise, linear_system, mean_entry
from estimator.joint_aware.thresholds import USUAL
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, InputError, unknown_name
from thermojoint.reduced.discrepancy import Discrepancy
from thermojoint.reduced.machine import ReducedMachine, diagonal_modes

#: Minimum relative gain of an exchange; each sensor is tried at most this often.
WORTH, ROUNDS = 1e-3, 3
#: Most doublings of the Riccati equation, and their tolerance.
DOUBLINGS, CLOSE = 40, 1e-10

#: An unknown start counts after this time, s.
SETTLED = 1200.0

Report = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Choice:
    """Sensors, and the resulting uncertainty of the displacement."""

    #: In the order in which they were chosen.
    names: tuple[str, ...]
    #: Shape (axes,): 1.96 roots of the mean square error of the displacement, m; of a machine with
    #: moving axes where it is largest.
    band: Array


@dataclass(frozen=True, eq=False)
class Placement:
    """Result of `place_sensors`."""

    #: From adding one sensor after another, starting from the smallest possible set.
    steps: tuple[Choice, ...]
    #: With the requested number, after exchanges.
    chosen: Choice


def place_sensors(
    machine: ReducedMachine,
    count: int,
    kept: Sequence[str] = (),
    family: Family | None = None,
    report: Report | None = None,
) -> Placement:
    """Choose sensors among the candidates of a machine.

    Parameters
    ----------
    machine : ReducedMachine
        Nominal machine; its sensors are the candidates, its axes the relevant ones. Its
        `plant_family.filter_modes` are sufficient.
    count : int
        How many to choose, `kept` ones included.
    kept : sequence of str
        Candidates chosen in any case: existing sensors.
    family : Family, optional
        Default `make_family` of the machine.
    report : callable, optional
        Called with (what, done, total).

    Raises
    ------
    InputError
        Too many sensors, fewer than sources or `kept` ones, or an unknown candidate in `kept`.
    ConvergenceError
        The machine cannot be marched.
    """
    names = list(machine.sensor_names)
    check_count(names, len(machine.source_names), count, kept)
    family = family or make_family(machine)
    problem = _problem(machine, family)
    done, tell = 0, report or (lambda *_: None)
    chosen = [names.index(name) for name in kept]
    if len(machine.source_names) > 1:
        chosen = _one_for_each_source(problem, loudest(machine, family.step), chosen)
    steps: list[Choice] = []
    if chosen:
        steps.append(_choice(problem, names, chosen))
    while len(chosen) < count:
        chosen.append(_best(problem, chosen))
        steps.append(_choice(problem, names, chosen))
        done += 1
        tell("placing", done, count)
    chosen = _exchanged(problem, chosen, len(kept))
    return Placement(tuple(steps), _choice(problem, names, chosen))


def check_count(names: Sequence[str], sources: int, count: int, kept: Sequence[str]) -> None:
    """Refuse a number of sensors that a placement among candidates cannot have.

    Parameters
    ----------
    names : sequence of str
        The candidates.
    sources : int
        Number of sources of the machine.
    count : int
        Number of sensors.
    kept : sequence of str
        Candidates that are among them anyway.

    Raises
    ------
    InputError
        A kept one is no candidate, or there are fewer sensors than sources or kept ones, or more
        than candidates.
    """
    for name in kept:
        if name not in names:
            raise unknown_name("candidate", name, names, "placement")
    least = max(sources, len(kept), 1)
    if not least <= count <= len(names):
        raise InputError(
            f"placement: {count} sensors of {len(names)} candidates, with {sources} sources and "
            f"{len(kept)} to be kept; ask for {least} to {len(names)}"
        )


@dataclass(frozen=True, eq=False)
class _Problem:
    """A filter of few modes: x' = F x + w, w of covariance Q, rows of all candidates and ambient.

    transition, disturbance (n, n); rows (p + 1, n); variance, lasting (p + 1,): that of a reading,
    and of errors that last, for the correction of an unknown start; tangent (k axes, n) at k
    places; start (n, c) or None.
    """

    transition: Array
    disturbance: Array
    rows: Array
    variance: Array
    lasting: Array
    tangent: Array
    start: Array | None
    family: Family


def _problem(machine: ReducedMachine, family: Family) -> _Problem:
    noise, held, step = NOISE, machine.at_preload, family.step
    modes = diagonal_modes(machine, held)
    nothing = Discrepancy(
        np.zeros(0), np.zeros((len(modes.sensors), 0)), np.zeros((len(machine.axes), 0))
    )
    system = linear_system(modes, nothing, machine.power, step)
    # The walk over a long step is the sum of many short ones.
    walk = math.sqrt(step / machine.step) * np.append(
        noise.heat_walk * machine.power, noise.ambient_walk
    )
    count = modes.rates.size
    entry = mean_entry(modes)
    source = np.zeros((system.size, walk.size + entry.shape[1]))
    source[count:, : walk.size] = np.diag(walk)
    source[:count, : walk.size] = system.drive * walk
    source[:count, walk.size :] = (
        noise.joint_flow * math.sqrt(step * machine.step) * system.decay[:, None] * entry
    )
    # Scaled by the walks all unknowns are of one size.
    unit = np.concatenate([np.ones(count), walk])
    source = source / unit[:, None]
    tangent = np.vstack(tangents_at(modes, machine.laws, family.places))
    return _Problem(
        transition=system.matrix * unit / unit[:, None],
        disturbance=source @ source.T,
        rows=system.rows * unit,
        variance=np.append(np.full(len(modes.sensors), noise.sensor**2), noise.ambient_sensor**2),
        lasting=_lasting(noise, len(modes.sensors), machine.step / step),
        tangent=np.hstack([tangent, np.zeros((len(tangent), walk.size))]),
        start=None if family.start is None else family.start / unit[:, None],
        family=family,
    )


def _lasting(noise: Noise, sensors: int, share: float) -> Array:
    """Variance of lasting errors in a reading that stands for 1 / `share` of the observer's."""
    every = np.broadcast_to(USUAL.doubt_of_past * np.asarray(noise.lasting), sensors)
    return np.append(share * every**2, 0.0)


def steady_covariance(transition: Array, rows: Array, disturbance: Array, variance: Array) -> Array:
    """Return the covariance before a reading that solves the discrete Riccati equation.

    Doubling as in `riccati.predicted_covariance`, with whole matrices and without a check of the
    residual: for a few dozen states in a third of its time, and it is solved for every set.

    Parameters
    ----------
    transition, disturbance : ndarray, shape (n, n)
        F and the covariance of w in x' = F x + w.
    rows : ndarray, shape (p, n)
        H in y = H x + v.
    variance : ndarray, shape (p,)
        Of v.

    Raises
    ------
    ConvergenceError
        No solution exists: the readings do not determine an undamped state.
    """
    a, h = transition.T, disturbance
    g = (rows.T / variance) @ rows
    identity = np.eye(len(a))
    for _ in range(DOUBLINGS):
        try:
            factor = np.linalg.inv(identity + g @ h)
        except np.linalg.LinAlgError:
            break
        through = a @ factor
        added = a.T @ h @ factor @ a
        g = g + through @ g @ a.T
        a = through @ a
        h = h + 0.5 * (added + added.T)
        size = float(np.abs(h).max())
        if not math.isfinite(size):
            break
        if np.abs(added).max() <= CLOSE * size:
            return h
    raise ConvergenceError("placement: the sensors do not determine the heat of every source")


def _mean_squares(problem: _Problem, chosen: Sequence[int]) -> Array:
    """Mean square error of the displacement, m2, shape (axes,), for some candidates.

    Along each axis, at the place where it is largest.
    """
    at = np.append(chosen, len(problem.rows) - 1)
    rows, variance = problem.rows[at], problem.variance[at]
    before = steady_covariance(problem.transition, rows, problem.disturbance, variance)
    cross = before @ rows.T
    gain = np.linalg.solve(rows @ cross + np.diag(variance), cross.T).T
    after = before - gain @ cross.T
    known = np.einsum("an,nm,am->a", problem.tangent, after, problem.tangent)
    # The ambient reading is the same for all plants.
    closed = problem.transition - gain @ (rows @ problem.transition)
    driven = np.einsum("np,tpk->tnk", gain[:, :-1], problem.family.readings[:, chosen])
    error = np.zeros((len(closed), driven.shape[2]))
    moved = np.empty_like(problem.family.displacement)
    for k, more in enumerate(driven):
        error = closed @ error + more
        moved[k] = problem.tangent @ error
    left = np.square(moved - problem.family.displacement).mean(axis=(0, 2))
    squares = np.maximum(known, 0.0) + left
    if problem.start is not None:
        covariance = rows @ cross + np.diag(variance)
        doubted = covariance + np.diag(problem.lasting[at])
        squares = squares + _left_of_start(problem, rows, gain, doubted)
    return np.asarray(squares.reshape(len(problem.family.places), -1).max(axis=0))


def _left_of_start(problem: _Problem, rows: Array, gain: Array, doubted: Array) -> Array:
    """Variance of the displacement that an unknown start leaves after `SETTLED`, m2, (k axes,)."""
    factor = problem.start
    assert factor is not None
    identity = np.eye(factor.shape[1])
    for _ in range(round(SETTLED / problem.family.step)):
        seen = rows @ factor
        root = np.linalg.cholesky(identity + seen.T @ np.linalg.solve(doubted, seen))
        left = np.linalg.solve(root, (factor - gain @ seen).T).T
        factor = problem.transition @ left
    return np.asarray(np.square(problem.tangent @ factor).sum(axis=1))


def _criterion(problem: _Problem, chosen: Sequence[int]) -> float:
    try:
        return float(_mean_squares(problem, chosen).sum())
    except ConvergenceError:
        return math.inf


def _choice(problem: _Problem, names: Sequence[str], chosen: Sequence[int]) -> Choice:
    band = WIDTH * np.sqrt(_mean_squares(problem, chosen))
    return Choice(tuple(names[sensor] for sensor in chosen), band)


def _best(problem: _Problem, chosen: Sequence[int]) -> int:
    """The candidate that reduces the criterion most in addition to the chosen ones."""
    others = [sensor for sensor in range(len(problem.variance) - 1) if sensor not in chosen]
    return min(others, key=lambda sensor: _criterion(problem, [*chosen, sensor]))


def _one_for_each_source(
    problem: _Problem, close: Sequence[int], chosen: Sequence[int]
) -> list[int]:
    """Chosen sensors, and others up to the number of sources, without which no filter exists.

    Of those `close` to the sources, one for each, the ones that are best beside the chosen; others
    where several sources share theirs.
    """
    further = list(dict.fromkeys(sensor for sensor in close if sensor not in chosen))
    lacking = max(0, len(close) - len(chosen))
    sets = ([*chosen, *more] for more in combinations(further, min(lacking, len(further))))
    begun = min(sets, key=lambda sensors: _criterion(problem, sensors))
    while len(begun) < len(close):
        begun.append(_best(problem, begun))
    return begun


def _exchanged(problem: _Problem, chosen: Sequence[int], kept: int) -> list[int]:
    """Sensors of which none, except the first `kept`, can be exchanged for a better one."""
    sensors, now = list(chosen), _criterion(problem, chosen)
    for _ in range(ROUNDS):
        begun = now
        for at in range(kept, len(sensors)):
            rest = [*sensors[:at], *sensors[at + 1 :]]
            other = _best(problem, rest)
            tried = [*sensors[:at], other, *sensors[at + 1 :]]
            value = _criterion(problem, tried)
            if value < (1.0 - WORTH) * now:
                sensors, now = tried, value
        if now >= begun:
            break
    return sensors
