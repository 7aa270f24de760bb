"""Where sensors tell most of the displacement: greedy with exchange over candidates.

The family are machines that a calibration cannot tell apart: drawn from what it leaves open of the
parameters, each with the linear remainder with which it answers the calibration alike. They march,
joint and all, through a random day, and the nominal machine beside them. What they answer otherwise
an observer of the nominal machine has to bear. With the steady filter of a set of sensors the mean
square error of the displacement is

    v = D P+ D^T + mean over plants and time of |D e - d|^2,    e' = F e,  e <- e + K (u - H e),

P+ the covariance after a reading (unknown heat, ambient, flows across the joint, noise), u what a
plant's sensors read more than the nominal machine's, d what it moves more. The criterion is the
sum of v over the axes. A set that hears of the heat late has a large first part, one that sits
where the plants differ a large second one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from artefacts.arrays import Array
from artefacts.errors import ConvergenceError, InputError, unknown_name
from estimator.joint_aware.assembling import PASTS, answer, sticking_tangent
from estimator.joint_aware.estimator import WIDTH
from estimator.joint_aware.filter_design import Noise, linear_system
from estimator.joint_aware.open_band import random_levels
from estimator.joint_aware.parameters import factors_of, with_factors
from estimator.joint_aware.physics import make_physics, simulate_known
from estimator.joint_aware.physics_fit import Run, fit_physics, remainder_at
from estimator.joint_aware.reduced_machine import ReducedMachine, diagonal_modes
from estimator.joint_aware.remainder import Remainder, relaxation_rates, relaxed

#: Plants of the family, and its seed.
PLANTS, SEED = 12, 2
#: Sensors that their calibration sees.
SEEN = 4
#: Step of the marches and of the filter while sensors are compared, s.
STEP = 60.0
#: Steps that a plant is calibrated with: heat inputs and length, s.
LEVELS, CALIBRATED = (0.5, 1.0, 2.0), 2100.0
#: Highest heat of the day.
HIGHEST = 2.0
#: Random walk of the ambient over the day, K.
AMBIENT = 3.0
#: Fields that are smaller than this part of the largest get no mode.
NEGLIGIBLE = 1e-6
#: An exchange must lower the criterion by this part; each sensor is tried so often at most.
WORTH, ROUNDS = 1e-3, 3
#: Doublings of the Riccati equation, and when they end.
DOUBLINGS, CLOSE = 40, 1e-10

Report = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Family:
    """What the plants of a family answer to a day, more than the nominal machine does.

    Attributes
    ----------
    readings : ndarray, shape (n, p, plants)
        Of every candidate, K.
    displacement : ndarray, shape (n, axes, plants)
        m.
    """

    readings: Array
    displacement: Array


@dataclass(frozen=True, eq=False)
class Choice:
    """Sensors, and how well the displacement is known with them.

    Attributes
    ----------
    names : tuple of str
        In the order in which they were chosen.
    band : ndarray, shape (axes,)
        1.96 roots of the mean square error of the displacement, m.
    """

    names: tuple[str, ...]
    band: Array


@dataclass(frozen=True, eq=False)
class Placement:
    """What `place_sensors` found.

    Attributes
    ----------
    steps : tuple of Choice
        By adding one sensor after another, the first as small as it can be.
    chosen : Choice
        As many as were asked for, after exchanges.
    """

    steps: tuple[Choice, ...]
    chosen: Choice


def make_family(
    machine: ReducedMachine, plants: int = PLANTS, seed: int = SEED, seen: int = SEEN
) -> Family:
    """Draw the machines that a calibration cannot tell apart, and march them through one day.

    The calibration is that of a plant that is the nominal machine, by steps of `LEVELS`. It sees
    the displacement and some sensors, where the temperatures of these steps differ most from each
    other (pivots of a QR factorisation): which ones will be chosen is not known yet.

    Parameters
    ----------
    machine : ReducedMachine
        Nominal; its sensors are the candidates.
    plants : int
        How many to draw. One that cannot be marched is left out.
    seed : int
        Of plants and day.
    seen : int
        How many sensors the calibration sees.

    Raises
    ------
    ConvergenceError
        No plant, or not even the nominal machine, can be marched.
    """
    rng = np.random.default_rng(seed)
    slow = replace(machine, step=STEP)
    runs = [_calibration(slow, level) for level in LEVELS]
    temperatures = np.vstack([run.temperature for run in runs])
    at = qr(temperatures, mode="r", pivoting=True)[1][:seen]
    few = replace(
        slow, sensors=slow.sensors[at], sensor_names=tuple(slow.sensor_names[k] for k in at)
    )
    fit = fit_physics(few, [replace(run, temperature=run.temperature[:, at]) for run in runs])
    day, states = _day(rng, slow)
    nominal = _answers(slow, day)
    values, turn = np.linalg.eigh(fit.covariance)
    spread = turn * np.sqrt(np.maximum(values, 0.0))
    readings, displacement = [], []
    for drawn in rng.normal(size=(plants, values.size)):
        logarithms = spread @ drawn
        plant = with_factors(slow, factors_of(fit.parameters, logarithms))
        try:
            temperature, moved = _answers(plant, day)
            beside = remainder_at(slow, runs, fit, logarithms)
        except ConvergenceError:
            continue
        readings.append(temperature + states @ beside.temperature.T - nominal[0])
        displacement.append(moved + states @ beside.displacement.T - nominal[1])
    if not readings:
        raise ConvergenceError("placement: no plant of the family can be marched; check the case")
    return Family(np.stack(readings, axis=-1), np.stack(displacement, axis=-1))


def _calibration(machine: ReducedMachine, level: float) -> Run:
    """A step from rest, with what the machine itself answers."""
    count = round(CALIBRATED / machine.step)
    inputs = np.tile(np.append(level * machine.power, 0.0), (count, 1))
    times: Array = machine.step * np.arange(1.0, count + 1.0)
    return Run(inputs, times, *_answers(machine, inputs), machine.step)


def _day(rng: np.random.Generator, machine: ReducedMachine) -> tuple[Array, Array]:
    """Inputs (n, s + 1) of a day, and the relaxed heat."""
    heat = random_levels(rng, machine.step, HIGHEST, machine.power.size)
    walk = np.cumsum(rng.normal(size=len(heat)))
    ambient = AMBIENT * walk / np.abs(walk).max()
    states = relaxed(heat, relaxation_rates(), machine.step)
    return np.column_stack([heat * machine.power, ambient]), states


def _answers(machine: ReducedMachine, inputs: Array) -> tuple[Array, Array]:
    held = machine.at_preload
    physics = make_physics(diagonal_modes(machine, held), machine.joints, held)
    return simulate_known(physics, inputs, machine.step)


def _loudest(machine: ReducedMachine) -> list[int]:
    """For each source a candidate that its heat warms soon, and the others' heat less."""
    modes = diagonal_modes(machine, machine.at_preload)
    soon = answer(modes.rates, STEP, 0.0)[:, None] * modes.drive[:, : machine.power.size]
    answers = np.abs(modes.sensors @ (soon * machine.power))
    share = answers / np.maximum(answers.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    return [int(np.argmax(column)) for column in (answers * share).T]


def place_sensors(
    machine: ReducedMachine,
    count: int,
    kept: Sequence[str] = (),
    family: Family | None = None,
    noise: Noise | None = None,
    report: Report | None = None,
) -> Placement:
    """Choose sensors among the candidates of a machine.

    Parameters
    ----------
    machine : ReducedMachine
        Nominal; its sensors are the candidates, its axes those that count. `fewer_modes` of it
        are enough.
    count : int
        How many to choose, `kept` ones included.
    kept : sequence of str
        Candidates that are chosen in any case: sensors that are there already.
    family : Family, optional
        Default `make_family` of the machine.
    noise : Noise, optional
        What the filter reckons with.
    report : callable, optional
        Called with (what, done, in all).

    Raises
    ------
    InputError
        More sensors than candidates or fewer than sources or kept ones, or no candidate of a name.
    ConvergenceError
        The machine cannot be marched.
    """
    names = list(machine.sensor_names)
    _check(machine, count, kept)
    problem = _problem(machine, family or make_family(machine), noise or Noise())
    done, tell = 0, report or (lambda *_: None)
    chosen = [names.index(name) for name in kept]
    # With fewer sensors than sources no filter exists: begin with one close to each.
    first = len(machine.source_names)
    if len(chosen) < first and first > 1:
        chosen += [one for one in _loudest(machine) if one not in chosen][: first - len(chosen)]
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


def band_with(
    machine: ReducedMachine, sensors: Sequence[str], family: Family, noise: Noise | None = None
) -> Array:
    """Return the band (axes,), m, of some of a machine's candidates over a family of plants."""
    problem = _problem(machine, family, noise or Noise())
    names = list(machine.sensor_names)
    return _choice(problem, names, [names.index(name) for name in sensors]).band


def _check(machine: ReducedMachine, count: int, kept: Sequence[str]) -> None:
    names, sources = machine.sensor_names, len(machine.source_names)
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

    transition, disturbance (n, n); rows (p + 1, n); variance (p + 1,); tangent (axes, n).
    """

    transition: Array
    disturbance: Array
    rows: Array
    variance: Array
    tangent: Array
    family: Family


def _problem(machine: ReducedMachine, family: Family, noise: Noise) -> _Problem:
    held = machine.at_preload
    modes = diagonal_modes(machine, held)
    nothing = Remainder(
        np.zeros(0), np.zeros((len(modes.sensors), 0)), np.zeros((len(machine.axes), 0))
    )
    system = linear_system(modes, nothing, machine.power, STEP)
    # A walk over a long step is one of many short ones.
    walk = math.sqrt(STEP / machine.step) * np.append(
        noise.heat_walk * machine.power, noise.ambient_walk
    )
    count = modes.rates.size
    source = np.zeros((system.size, walk.size + len(modes.jump)))
    source[count:, : walk.size] = np.diag(walk)
    source[:count, : walk.size] = system.drive * walk
    source[:count, walk.size :] = (
        noise.joint_flow * math.sqrt(STEP * machine.step) * system.decay[:, None] * modes.jump.T
    )
    # In units of the walks all unknowns are of one size.
    unit = np.concatenate([np.ones(count), walk])
    source = source / unit[:, None]
    tangent = sticking_tangent(make_physics(modes, machine.joints, held))
    return _Problem(
        transition=system.matrix * unit / unit[:, None],
        disturbance=source @ source.T,
        rows=system.rows * unit,
        variance=np.append(np.full(len(modes.sensors), noise.sensor**2), noise.ambient_sensor**2),
        tangent=np.hstack([tangent, np.zeros((len(tangent), walk.size))]),
        family=family,
    )


def fewer_modes(
    machine: ReducedMachine, noise: Noise | None = None, shortest: float = STEP
) -> ReducedMachine:
    """Return a machine on the few modes that its inputs drive at the times of a run.

    The fields that every source at its power, the ambient and flows across the joint leave after
    `PASTS`, (M / time + K + H) T = input, span them, but for what is smaller than `NEGLIGIBLE` of
    the largest. Its 300 modes resolve seconds everywhere; here minutes are enough.

    Parameters
    ----------
    machine : ReducedMachine
        Any.
    noise : Noise, optional
        Says how large flows across the joint are.
    shortest : float
        Time that is resolved, s.
    """
    flow = (noise or Noise()).joint_flow
    inputs = np.column_stack(
        [machine.sources * machine.power, AMBIENT * machine.ambient, flow * machine.jump.T]
    )
    linear = machine.conduction + machine.convection
    linear = linear + machine.jump.T @ (machine.at_preload[:, None] * machine.jump)
    fields = [
        np.linalg.solve(machine.capacity / time + linear, inputs) for time in (shortest, *PASTS)
    ]
    # Fields are compared by the heat they hold: in coordinates in which M is the identity.
    root = np.linalg.cholesky(machine.capacity).T
    basis, sizes, _ = np.linalg.svd(root @ np.hstack(fields), full_matrices=False)
    basis = np.linalg.solve(root, basis[:, sizes > NEGLIGIBLE * sizes[0]])
    elastic = machine.elastic
    return replace(
        machine,
        capacity=basis.T @ machine.capacity @ basis,
        conduction=basis.T @ machine.conduction @ basis,
        convection=basis.T @ machine.convection @ basis,
        sources=basis.T @ machine.sources,
        ambient=basis.T @ machine.ambient,
        jump=machine.jump @ basis,
        sensors=machine.sensors @ basis,
        elastic=replace(
            elastic,
            thermal_gap=elastic.thermal_gap @ basis,
            probe_thermal=elastic.probe_thermal @ basis,
        ),
    )


def steady_covariance(transition: Array, rows: Array, disturbance: Array, variance: Array) -> Array:
    """Return the covariance before a reading that solves the discrete Riccati equation.

    Structure-preserving doubling (Chu, Fan, Lin, Wang, Int. J. Control 77, 2004): for a few dozen
    states ten times as fast as the general solver of `filter_design`, and it is solved for every
    set of sensors.

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
        There is none: the readings do not determine what never decays.
    """
    a, h = transition.T, disturbance
    g = (rows.T / variance) @ rows
    one = np.eye(len(a))
    for _ in range(DOUBLINGS):
        try:
            factor = np.linalg.inv(one + g @ h)
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
    """Mean square error of the displacement, m2, shape (axes,), with some candidates."""
    at = np.append(chosen, len(problem.rows) - 1)
    rows, variance = problem.rows[at], problem.variance[at]
    before = steady_covariance(problem.transition, rows, problem.disturbance, variance)
    cross = before @ rows.T
    gain = np.linalg.solve(rows @ cross + np.diag(variance), cross.T).T
    after = before - gain @ cross.T
    known = np.einsum("an,nm,am->a", problem.tangent, after, problem.tangent)
    # The ambient's own reading is no different for a plant.
    closed = problem.transition - gain @ (rows @ problem.transition)
    driven = np.einsum("np,tpk->tnk", gain[:, :-1], problem.family.readings[:, chosen])
    error = np.zeros((len(closed), driven.shape[2]))
    moved = np.empty_like(problem.family.displacement)
    for k, more in enumerate(driven):
        error = closed @ error + more
        moved[k] = problem.tangent @ error
    left = np.square(moved - problem.family.displacement).mean(axis=(0, 2))
    return np.asarray(np.maximum(known, 0.0) + left)


def _criterion(problem: _Problem, chosen: Sequence[int]) -> float:
    try:
        return float(_mean_squares(problem, chosen).sum())
    except ConvergenceError:
        return math.inf


def _choice(problem: _Problem, names: Sequence[str], chosen: Sequence[int]) -> Choice:
    band = WIDTH * np.sqrt(_mean_squares(problem, chosen))
    return Choice(tuple(names[one] for one in chosen), band)


def _best(problem: _Problem, chosen: Sequence[int]) -> int:
    """The candidate that lowers the criterion most beside those that are chosen."""
    others = [one for one in range(len(problem.variance) - 1) if one not in chosen]
    return min(others, key=lambda one: _criterion(problem, [*chosen, one]))


def _exchanged(problem: _Problem, chosen: Sequence[int], kept: int) -> list[int]:
    """Sensors of which none, but for the first `kept`, can be exchanged for a better one."""
    found, now = list(chosen), _criterion(problem, chosen)
    for _ in range(ROUNDS):
        begun = now
        for at in range(kept, len(found)):
            rest = [*found[:at], *found[at + 1 :]]
            other = _best(problem, rest)
            tried = [*found[:at], other, *found[at + 1 :]]
            value = _criterion(problem, tried)
            if value < (1.0 - WORTH) * now:
                found, now = tried, value
        if now >= begun:
            break
    return found
