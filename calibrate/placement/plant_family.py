"""Machines with indistinguishable calibration responses, and their responses to a day.

Parameters are drawn from the posterior after a calibration by steps; each machine has the linear
discrepancy that gives it the nominal responses to those steps. Sensors are compared over minutes,
not seconds: marches take long steps on few modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from calibrate.joint_aware.assembling import PAST
from calibrate.joint_aware.misfit import Run, errors, fit_linear, make_problem
from calibrate.joint_aware.past import Pasts, answer, states_after
from calibrate.joint_aware.physics_fit import fit_physics
from calibrate.joint_aware.random_heat import random_levels
from estimator.joint_aware.filter_design import Noise, compressed
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.reduced.discrepancy import relaxation_rates, relaxed
from thermojoint.reduced.machine import ReducedMachine, coupled_in, diagonal_modes
from thermojoint.reduced.parameters import factors_of, with_factors
from thermojoint.reduced.physics import make_physics, simulate_known


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


#: The defaults.
USUAL = Drawing()


@dataclass(frozen=True, eq=False)
class Family:
    """Responses of a family of plants to a day, relative to the nominal machine."""

    #: Interval of the n samples, s.
    step: float
    #: Shape (n, p, plants): of every candidate, K.
    readings: Array
    #: Shape (n, axes, plants): m.
    displacement: Array
    #: Shape (modes + s + 1, k): covariance factor of an unknown start that counts as well:
    #: amplitudes with the joint held at its preload, heat of the sources, W, and ambient, K
    #: (`with_start`).
    start: Array | None = None


def with_start(family: Family, machine: ReducedMachine, pasts: Pasts) -> Family:
    """Return a family whose machine also starts with one of some pasts, nobody knows which."""
    modes = diagonal_modes(machine, machine.at_preload)
    walk = np.ones(machine.power.size + 1)
    states = states_after(modes, np.zeros(0), machine.power, walk, pasts)
    start = compressed(states / np.sqrt(states.shape[1]), np.ones(len(states)), PAST.columns)
    return replace(family, start=start)


def make_family(machine: ReducedMachine, drawing: Drawing = USUAL) -> Family:
    """Draw machines that a calibration cannot distinguish, and march them through one day.

    The calibration uses the nominal machine as plant, with the displacement and some sensors. They
    are where the temperatures differ most (pivots of a QR factorisation), since the final choice is
    not yet known.

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
    rng = np.random.default_rng(drawing.seed)
    slow = replace(machine, step=drawing.step)
    runs = [_calibration(slow, level, drawing.calibrated) for level in drawing.levels]
    temperatures = np.vstack([run.temperature for run in runs])
    at = qr(temperatures, mode="r", pivoting=True)[1][: drawing.seen]
    few = slow.with_sensors([slow.sensor_names[k] for k in at])
    fit = fit_physics(few, [replace(run, temperature=run.temperature[:, at]) for run in runs])
    day, states = _day(rng, slow, drawing)
    nominal, problem = _answers(slow, day), make_problem(slow, runs)
    values, turn = np.linalg.eigh(fit.covariance)
    spread = turn * np.sqrt(np.maximum(values, 0.0))
    readings, displacement = [], []
    for drawn in rng.normal(size=(drawing.plants, values.size)):
        coordinates = spread @ drawn
        plant = with_factors(slow, factors_of(fit.parameters, coordinates))
        try:
            temperature, moved = _answers(plant, day)
            beside = fit_linear(problem, *errors(problem, fit.parameters, coordinates)).discrepancy
        except ConvergenceError:
            continue
        readings.append(temperature + states @ beside.temperature.T - nominal[0])
        displacement.append(moved + states @ beside.displacement.T - nominal[1])
    if not readings:
        raise ConvergenceError("placement: no plant of the family can be marched; check the case")
    return Family(drawing.step, np.stack(readings, axis=-1), np.stack(displacement, axis=-1))


def _calibration(machine: ReducedMachine, level: float, length: float) -> Run:
    """A step from rest, with the machine's own response."""
    count = round(length / machine.step)
    inputs = np.tile(np.append(level * machine.power, 0.0), (count, 1))
    times: Array = machine.step * np.arange(1.0, count + 1.0)
    return Run(inputs, times, *_answers(machine, inputs), machine.step)


def _day(
    rng: np.random.Generator, machine: ReducedMachine, drawing: Drawing
) -> tuple[Array, Array]:
    """Inputs (n, s + 1) of a day, and the relaxed heat."""
    heat = random_levels(rng, drawing.duration, machine.step, drawing.highest, machine.power.size)
    walk = np.cumsum(rng.normal(size=len(heat)))
    ambient = drawing.ambient * walk / np.abs(walk).max()
    states = relaxed(heat, relaxation_rates(), machine.step)
    return np.column_stack([heat * machine.power, ambient]), states


def _answers(machine: ReducedMachine, inputs: Array) -> tuple[Array, Array]:
    held = machine.at_preload
    physics = make_physics(diagonal_modes(machine, held), machine.joints, held)
    return simulate_known(physics, inputs, machine.step)


def loudest(machine: ReducedMachine, step: float) -> list[int]:
    """Return for each source the candidate that responds most to it, and less to the others.

    Parameters
    ----------
    machine : ReducedMachine
        Its sensors are the candidates.
    step : float
        Duration of the heat, s.
    """
    modes = diagonal_modes(machine, machine.at_preload)
    soon = answer(modes.rates, step, 0.0)[:, None] * modes.drive[:, : machine.power.size]
    answers = np.abs(modes.sensors @ (soon * machine.power))
    share = answers / np.maximum(answers.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    return [int(np.argmax(column)) for column in (answers * share).T]


def fewer_modes(machine: ReducedMachine, drawing: Drawing = USUAL) -> ReducedMachine:
    """Return a machine with the few modes that its inputs excite at the times of a run.

    They span the fields that every source at its power, the ambient and flows across the joint
    cause after the times of `PAST`: (M / time + K + H) T = input. The machine's 300 modes resolve
    seconds everywhere; here minutes are enough, and all surfaces share one film.

    Parameters
    ----------
    machine : ReducedMachine
        Any.
    drawing : Drawing
        Its step is the shortest resolved time, s.
    """
    if machine.held.names:
        raise InputError("placement: held temperatures are not considered; place without them")
    flow = Noise().joint_flow
    inputs = np.column_stack(
        [machine.sources * machine.power, PAST.ambient * machine.ambient, flow * machine.jump.T]
    )
    linear = machine.conduction + machine.convection
    linear = linear + machine.jump.T @ (machine.at_preload[:, None] * machine.jump)
    fields = [
        np.linalg.solve(machine.capacity / time + linear, inputs)
        for time in (drawing.step, *PAST.lengths)
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
