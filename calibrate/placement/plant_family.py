"""Machines with indistinguishable calibration responses, and their responses to a day.

Parameters are drawn from the posterior after a calibration by steps; each machine has the linear
discrepancy that gives it the nominal responses to those steps. Sensors are compared over minutes,
not seconds: marches take long steps on few modes. Axes of a machine that moves go at random.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import qr

from calibrate.joint_aware.misfit import Run, assumed, errors, fit_linear, make_problem
from calibrate.joint_aware.past import Pasts, answer, start_factor, states_after
from calibrate.joint_aware.physics_fit import SEARCH, fit_physics
from calibrate.joint_aware.random_heat import random_course, random_levels
from calibrate.joint_aware.sticking import combinations
from estimator.joint_aware.filter_design import NOISE
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.reduced.discrepancy import relaxation_rates, relaxed
from thermojoint.reduced.machine import ReducedMachine, conducting, coupled_in, diagonal_modes
from thermojoint.reduced.parameters import factors_of, with_factors
from thermojoint.reduced.physics import (
    Physics,
    displaced_at,
    make_physics,
    march_known,
    simulate_known,
)


@dataclass(frozen=True)
class Drawing:
    """Size of the family, its calibration and its day (docs/sensor-placement.md)."""

    #: Step of the marches and of the filter while sensors are compared, s.
    step: float = 60.0
    #: Fields smaller than this fraction of the largest get no mode.
    negligible: float = 1e-6
    #: Number to draw, of which those that cannot be marched are left out; seed of plants and day.
    plants: int = 12
    seed: int = 2
    #: Number of sensors in the calibration, as in the paper.
    seen: int = 4
    #: Heat inputs of the calibration steps, as in the paper.
    levels: tuple[float, ...] = (0.5, 1.0, 2.0)
    #: Their length, s, as in the paper.
    calibrated: float = 2100.0
    #: Length of the day, s.
    duration: float = 8 * 3600.0
    #: Its highest heat, that of the calibration.
    highest: float = 2.0
    #: Random walk of the ambient over the day, K.
    ambient: float = 3.0
    #: An axis that moves is at another place after this time, s, as in the histories of a band.
    turns: float = 20.0


#: The defaults.
USUAL = Drawing()
#: A sensor is near a source if it responds at least this fraction of the most responsive candidate.
NEARBY = 0.1
#: Times of heating and cooling, s, and change of the ambient, K, whose fields get modes.
TIMES, AMBIENT = np.geomspace(60.0, 6e4, 8), 3.0


@dataclass(frozen=True, eq=False)
class Family:
    """Responses of a family of plants to a day, relative to the nominal machine."""

    #: Interval of the n samples, s.
    step: float
    #: Shape (n, p, plants): of every candidate, K.
    readings: Array
    #: Shape (n, k axes, plants): at one place after the other, m.
    displacement: Array
    #: Shape (k, x): places of moving axes at which the displacement counts, m.
    places: Array = field(default_factory=lambda: np.zeros((1, 0)))
    #: Shape (modes + s + 1, k): covariance factor of an unknown start that counts as well:
    #: amplitudes with the joint held at its preload, heat of the sources, W, and ambient, K
    #: (`with_start`).
    start: Array | None = None


def with_start(family: Family, machine: ReducedMachine, pasts: Pasts) -> Family:
    """Return a family whose machine also starts with one of some pasts, nobody knows which."""
    modes = diagonal_modes(machine, machine.at_preload)
    walk = np.ones(machine.power.size + 1)
    states = states_after(modes, np.zeros(0), machine.power, walk, pasts)
    return replace(family, start=start_factor(states, np.ones(len(states))))


def make_family(machine: ReducedMachine, drawing: Drawing = USUAL) -> Family:
    """Draw machines that a calibration cannot distinguish, and march them through one day.

    The calibration uses the nominal machine as plant, with the displacement and some sensors. They
    are where the temperatures differ most (pivots of a QR factorisation), since the final choice is
    not yet known. The displacement counts at the places of moving axes that the case asks about; of
    several axes at the combinations of the first, middle and last of them.

    Parameters
    ----------
    machine : ReducedMachine
        Nominal; its sensors are the candidates.
    drawing : Drawing
        Size of the family, its calibration and its day.

    Raises
    ------
    ConvergenceError
        No plant, or not even the nominal machine, can be marched.
    """
    rng, moves = (np.random.default_rng(drawing.seed) for _ in range(2))
    slow = replace(machine, step=drawing.step)
    guide = machine.guide
    places = combinations(() if guide is None else [axis.asked for axis in guide.axes])
    runs = [_calibration(moves, slow, level, drawing) for level in drawing.levels]
    temperatures = np.vstack([run.temperature for run in runs])
    at = qr(temperatures, mode="r", pivoting=True)[1][: drawing.seen]
    few = slow.with_sensors([slow.sensor_names[k] for k in at])
    seen = [replace(run, temperature=run.temperature[:, at]) for run in runs]
    # The machine fits its own responses: no search need begin elsewhere, nor go on.
    fit = fit_physics(few, seen, search=replace(SEARCH, starts=0, rounds=1))
    day = _day(rng, moves, slow, drawing)
    nominal, problem = _everywhere(slow, day, places), make_problem(slow, runs)
    values, turn = np.linalg.eigh(fit.covariance)
    spread = turn * np.sqrt(np.maximum(values, 0.0))
    readings, displacement = [], []
    for drawn in rng.normal(size=(drawing.plants, values.size)):
        coordinates = spread @ drawn
        plant = with_factors(slow, factors_of(fit.parameters, coordinates))
        try:
            temperature, moved = _everywhere(plant, day, places)
            beside = fit_linear(problem, *errors(problem, fit.parameters, coordinates)).discrepancy
        except ConvergenceError:
            continue
        readings.append(temperature + day.states @ beside.temperature.T - nominal[0])
        more = np.tile(day.states @ beside.displacement.T, len(places))
        displacement.append(moved + more - nominal[1])
    if not readings:
        raise ConvergenceError("placement: no plant of the family can be marched; check the case")
    sensed, moved = (np.stack(parts, axis=-1) for parts in (readings, displacement))
    return Family(drawing.step, sensed, moved, places)


@dataclass(frozen=True, eq=False)
class _Day:
    """Inputs (n, s + 1 + x), travel of the axes (n, x), m, and the relaxed heat (n, s q)."""

    inputs: Array
    gone: Array
    states: Array


def _course(
    moves: np.random.Generator, count: int, machine: ReducedMachine, drawing: Drawing
) -> tuple[Array, Array]:
    """Random positions of the axes after each of n steps, and their travel in it, m, (n, x)."""
    if (guide := machine.guide) is None:
        return np.zeros((count, 0)), np.zeros((count, 0))
    turns = math.ceil(machine.step / drawing.turns)
    course = random_course(moves, turns * count, machine.step / turns, guide.way)
    gone = np.abs(np.diff(course, axis=0, prepend=[guide.first]))
    return course[turns - 1 :: turns], gone.reshape(count, turns, -1).sum(axis=1)


def _calibration(
    moves: np.random.Generator, machine: ReducedMachine, level: float, drawing: Drawing
) -> Run:
    """A step from rest, with the machine's own response."""
    count = round(drawing.calibrated / machine.step)
    course, gone = _course(moves, count, machine, drawing)
    inputs = np.hstack([np.tile(np.append(level * machine.power, 0.0), (count, 1)), course])
    times: Array = machine.step * np.arange(1.0, count + 1.0)
    answers = simulate_known(_physics(machine), inputs, machine.step, gone)
    return Run(inputs, times, *answers, machine.step, gone)


def _day(
    rng: np.random.Generator,
    moves: np.random.Generator,
    machine: ReducedMachine,
    drawing: Drawing,
) -> _Day:
    heat = random_levels(rng, drawing.duration, machine.step, drawing.highest, machine.power.size)
    walk = np.cumsum(rng.normal(size=len(heat)))
    ambient = drawing.ambient * walk / np.abs(walk).max()
    states = relaxed(heat, relaxation_rates(), machine.step)
    course, gone = _course(moves, len(heat), machine, drawing)
    return _Day(np.column_stack([heat * machine.power, ambient, course]), gone, states)


def _physics(machine: ReducedMachine) -> Physics:
    held = assumed(machine)
    return make_physics(diagonal_modes(machine, held), machine.joints, held)


def _everywhere(machine: ReducedMachine, day: _Day, places: Array) -> tuple[Array, Array]:
    """Sensors (n, p), K, and displacement (n, k axes), m, at places (k, x), m, in a day."""
    physics = _physics(machine)
    if machine.guide is None:
        return simulate_known(physics, day.inputs, machine.step)
    marched = march_known(physics, day.inputs, machine.step, day.gone)
    moved = displaced_at(physics, marched, places)
    return marched.amplitudes @ physics.modes.sensors.T, moved.reshape(len(moved), -1)


def loudest(machine: ReducedMachine, step: float) -> list[int]:
    """Return for each source the candidate that responds most to it, and less to the others.

    Parameters
    ----------
    machine : ReducedMachine
        Its sensors are the candidates.
    step : float
        Duration of the heat, s.
    """
    return _loudest(_soon(machine, step))


def _loudest(answers: Array) -> list[int]:
    share = answers / np.maximum(answers.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    return [int(np.argmax(column)) for column in (answers * share).T]


def unseen_sources(machine: ReducedMachine, chosen: Sequence[str], step: float) -> dict[str, str]:
    """Return the sources without a chosen sensor nearby, each with its `loudest` candidate.

    None of the chosen sensors reaches a tenth (`NEARBY`) of the candidate's response, so every
    change of that heat is noticed late.

    Parameters
    ----------
    machine : ReducedMachine
        Its sensors are the candidates.
    chosen : sequence of str
        Names of some of them.
    step : float
        Duration of the heat, s.
    """
    answers, names = _soon(machine, step), machine.sensor_names
    best = answers[[names.index(name) for name in chosen]].max(axis=0)
    return {
        source: names[candidate]
        for k, (source, candidate) in enumerate(
            zip(machine.source_names, _loudest(answers), strict=True)
        )
        if best[k] < NEARBY * answers[candidate, k]
    }


def _soon(machine: ReducedMachine, step: float) -> Array:
    """Magnitude of every candidate's response to every source at its power, K, (p, s)."""
    modes = diagonal_modes(machine, machine.at_preload)
    soon = answer(modes.rates, step)[:, None] * modes.drive[:, : machine.power.size]
    return np.abs(modes.sensors @ (soon * machine.power))


def fewer_modes(machine: ReducedMachine, drawing: Drawing = USUAL) -> ReducedMachine:
    """Return a machine with the few modes that its inputs excite at the times of a run.

    They span the fields that every source at its power, the ambient, flows across the joint and
    drives cause after `TIMES`: (M / time + K + H) T = input. On axes every pad and
    every station has a flow of its own, as their friction heats them. The machine's 300 modes
    resolve seconds everywhere; here minutes are enough, and all surfaces share one film.

    Parameters
    ----------
    machine : ReducedMachine
        Any.
    drawing : Drawing
        Its step is the shortest resolved time, s.
    """
    if machine.held.names:
        raise InputError("placement: held temperatures are not considered; place without them")
    guide = machine.guide
    driven = np.zeros((len(machine.start), 0)) if guide is None else guide.drives.heated
    return _spanned(machine, np.column_stack([_entering(machine, machine.jump), driven]), drawing)


def filter_modes(machine: ReducedMachine) -> ReducedMachine:
    """Return a machine with the modes that a filter needs, out of those of `fewer_modes`.

    A filter does not model flows at single stations: on axes, heat flows between the pads and the
    stations below, averaged over the stroke. A machine without axes is returned as it is.
    """
    if (guide := machine.guide) is None:
        return machine
    jump = guide.way.stations.everywhere.coefficients @ machine.jump
    return _spanned(machine, _entering(machine, jump), USUAL)


def _entering(machine: ReducedMachine, jump: Array) -> Array:
    """Inputs (r, n) of the modes, W: sources, ambient, flows across the jumps (m, r)."""
    flow = NOISE.joint_flow
    return np.column_stack(
        [machine.sources * machine.power, AMBIENT * machine.ambient, flow * jump.T]
    )


def _spanned(machine: ReducedMachine, inputs: Array, drawing: Drawing) -> ReducedMachine:
    """The machine on the modes that inputs (r, n) excite."""
    linear = conducting(machine, machine.at_preload)
    fields = [
        np.linalg.solve(machine.capacity / time + linear, inputs) for time in (drawing.step, *TIMES)
    ]
    # Fields are compared by their heat content: in coordinates in which M is the identity.
    root = np.linalg.cholesky(machine.capacity).T
    basis, sizes, _ = np.linalg.svd(root @ np.hstack(fields), full_matrices=False)
    basis = np.linalg.solve(root, basis[:, sizes > drawing.negligible * sizes[0]])
    return replace(
        coupled_in(machine, basis),
        capacity=basis.T @ machine.capacity @ basis,
        conduction=basis.T @ machine.conduction @ basis,
        convection=basis.T @ machine.convection @ basis,
        films=(),
    )
