"""Time simulation of the closed loop: machine, estimator, heater and axis offsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from estimator.interface import Estimate
from estimator.joint_aware.estimator import JointAware
from fesim.case.schema import Case
from fesim.march.settling import initial_state
from fesim.march.stepping import Inputs, tracks_along
from fesim.march.track import joined
from fesim.setup.loads import input_layout, thermal_inputs
from fesim.setup.machine import Setup
from fesim.simulate import COUPLINGS
from fesim.solid.elasticity import DIRECTIONS
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.compensation.loop.controller import AT_REST, Controller, ControllerState, control
from thermojoint.compensation.offsets.output import (
    OutputState,
    at_zero,
    band_along,
    cycle,
    followed,
    offsets_of,
)
from thermojoint.compensation.offsets.settings import Settings
from thermojoint.compensation.offsets.usable import usable


@dataclass(frozen=True)
class Plant:
    """The compensated machine."""

    #: Case in which the heater, if there is one, has no heat input.
    case: Case
    #: Setup of the case.
    setup: Setup


@dataclass(frozen=True)
class Acting:
    """Actuators of a closed loop."""

    #: None without a heater.
    controller: Controller | None
    #: Indices of the plant's source, of the estimator's source, and of the estimate's axis.
    heater: int
    disturbance: int
    axis: int
    #: None without axis offsets.
    offsets: Settings | None
    #: Transmission delay of the estimates, samples.
    delay: int


class Course(NamedTuple):
    """Time histories of a run; one row per step of the plant."""

    #: Shape (n,): times, s.
    times: Array
    #: Shape (n, axes): displacement of the machine, and its newest estimate, m.
    displacement: Array
    estimate: Array
    #: Shape (n, axes): contribution of the axis offsets to the displacement, m.
    moved: Array
    #: Shape (n,): heat of the heater, W.
    heater: Array

    @property
    def residual(self) -> Array:
        """Residual displacement at the tool, m, shape (n, axes)."""
        return np.asarray(self.displacement + self.moved)


@threadpool_limits.wrap(limits=1)
def run_loop(plant: Plant, estimator: JointAware, acting: Acting, noise: Array) -> Course:
    """Simulate a machine from rest, with its estimator in the loop.

    Parameters
    ----------
    plant : Plant
        Machine, simulated by `fesim`.
    estimator : JointAware
        Estimator, sampled at the step of its model, a multiple of the plant's step.
    acting : Acting
        Actuators driven by its estimates.
    noise : ndarray, shape (samples, sensors)
        Noise of every reading, K, for all samples of the run.

    Raises
    ------
    InputError
        The plant lacks a sensor or an axis, or the steps do not fit.
    ConvergenceError
        A step of the machine or of the estimator does not converge.
    """
    machine, inputs = plant.setup.machine, thermal_inputs(plant.case)
    check_plant(plant.case, estimator)
    layout = input_layout(plant.case)
    each = round(estimator.model.step / machine.thermal.step)
    at = [list(plant.setup.probes).index(name) for name in estimator.model.sensors]
    rows = plant.setup.probe_rows[at]
    sensors = np.asarray(rows if isinstance(rows, np.ndarray) else rows.toarray())
    axes = [DIRECTIONS.index(axis) for axis in estimator.axes]
    state, observed = initial_state(machine), estimator.initial_state()
    act, take = _at_rest(acting, len(axes)), COUPLINGS[plant.case.march.coupling](machine)
    sent: list[Estimate] = []
    found = []
    for index, added in enumerate(noise):
        time = index * estimator.model.step
        ambient = inputs(time)[layout.ambient] if index else 0.0
        read = [*(sensors @ state.temperature + added), ambient]
        observed, estimate = estimator.sample(observed, time, read)
        sent.append(estimate)
        arrived = sent[index - acting.delay] if index >= acting.delay else None
        act = _act(acting, act, estimator.axes, arrived, time)
        times = [(state.index + 1 + k) * machine.thermal.step for k in range(each)]
        driven = _driven(inputs, times, acting.heater, act.heat)
        track = joined(list(tracks_along(machine, take, driven, state)))
        for step in map(track.step, range(each)):
            state = step.state
            found.append(
                (
                    state.index * machine.thermal.step,
                    *step.displacement[axes],
                    *estimate.displacement,
                    *act.moved,
                    act.heat,
                )
            )
    return _course(np.array(found), len(axes))


class _Act(NamedTuple):
    """Actuation between two samples: heat, W, and the offsets' displacement, m."""

    controlled: ControllerState
    output: OutputState | None
    heat: float
    moved: Array


def _at_rest(acting: Acting, axes: int) -> _Act:
    output = None if acting.offsets is None else at_zero(acting.offsets.output)
    return _Act(AT_REST, output, 0.0, np.zeros(axes))


def _act(
    acting: Acting, before: _Act, axes: tuple[str, ...], arrived: Estimate | None, time: float
) -> _Act:
    """Actuation after a sample, with the newest estimate, if there is one yet."""
    after = before
    if acting.controller is not None and arrived is not None:
        controlled, heat = control(
            acting.controller,
            before.controlled,
            float(arrived.displacement[acting.axis]),
            float(arrived.details[acting.disturbance]),
        )
        after = after._replace(controlled=controlled, heat=heat)
    if acting.offsets is not None and before.output is not None:
        wanted = _target(acting.offsets, axes, arrived, time)
        output = cycle(acting.offsets.output, before.output, time, wanted)
        offsets = offsets_of(acting.offsets.output, output)
        after = after._replace(output=output, moved=added_by(acting.offsets, axes, offsets))
    return after


def check_plant(case: Case, estimator: JointAware) -> None:
    """Refuse a plant that an estimator cannot follow.

    Raises
    ------
    InputError
        The estimator reads more than temperatures, or a probe that the plant lacks; its step is
        not a multiple of the plant's, or the plant's steps are adaptive.
    """
    model = estimator.model
    others = [*model.loads, *model.positions, *model.powers]
    if others:
        raise InputError(
            f"estimator: its model reads {', '.join(others)}; a loop has temperatures only: "
            "calibrate one without"
        )
    for name in model.sensors:
        if name not in case.probes:
            raise unknown_name("probe", name, case.probes, "plant: the estimator reads")
    if case.march.method == "adaptive":
        raise InputError(
            'plant: march.method = "adaptive" needs inputs that are known beforehand; take "fixed"'
        )
    ratio = model.step / case.march.step_s
    if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
        raise InputError(
            f"plant: march.step_s {case.march.step_s:g} does not divide the estimator's step of "
            f"{model.step:g} s; make it do so"
        )


def added_by(settings: Settings, axes: tuple[str, ...], offsets: Array) -> Array:
    """Return the displacement that offsets (m) cause along the estimate's axes, m.

    An offset with sign -1 is the negative estimate and is added; with sign 1 it is subtracted.
    """
    added = np.zeros(len(axes))
    given = zip(settings.output.estimated, settings.output.signs, offsets, strict=True)
    for name, sign, offset in given:
        added[axes.index(name)] -= sign * offset
    return added


def _target(
    settings: Settings, axes: tuple[str, ...], arrived: Estimate | None, time: float
) -> Array | None:
    if arrived is None:
        return None
    age = time - arrived.time
    band = band_along(settings.output, axes, arrived.band, None)
    if not usable(settings.trust, age, band, arrived.words):
        return None
    return followed(settings.output, axes, arrived.displacement)


def _driven(inputs: Inputs, times: Sequence[float], heater: int, heat: float) -> Array:
    """Inputs (n, k + l) at times with constant heat (W) of the heater; -1: no heater."""
    driven = np.array([inputs(time) for time in times])
    if heater >= 0:
        driven[:, heater] = heat
    return driven


def _course(rows: Array, axes: int) -> Course:
    ends = np.cumsum([1, axes, axes, axes])
    times, displacement, estimate, moved, heater = np.split(rows, ends, axis=1)
    return Course(times[:, 0], displacement, estimate, moved, heater[:, 0])
