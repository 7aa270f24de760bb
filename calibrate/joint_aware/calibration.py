"""Calibration of a machine's observer from a case and responses, with a report of the fit."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from calibrate.joint_aware.assembling import make_observer, seen_heat
from calibrate.joint_aware.left_out import widened
from calibrate.joint_aware.misfit import Run, fewer, highest_heat, largest_displacement
from calibrate.joint_aware.open_band import Drawing, open_band, variance_of_heat
from calibrate.joint_aware.physics_fit import SEARCH, Fit, Search, fit_physics
from calibrate.joint_aware.readings import heat_in, run_in, ways_of
from calibrate.joint_aware.recorded_days import is_day, shown_in, with_days
from estimator.joint_aware.filter_design import NOISE, Noise
from estimator.joint_aware.observer_model import Calibrated, ObserverModel
from estimator.joint_aware.readings import recorded, temperatures_in
from fesim.axes.axis import Axis, place_of
from fesim.axes.setup import MovingSetup, set_up_axes
from fesim.case.schema import Case
from fesim.setup.machine import set_up
from fesim.setup.parts import unit_direction
from fesim.setup.structure import displacement_of
from fesim.solid.elasticity import DIRECTIONS
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.artefacts.response import axes_that_move, displaced, probes_of
from thermojoint.artefacts.units import MILLI
from thermojoint.reduced.axis_drive import displacement_probes, drives_on
from thermojoint.reduced.loosened import Loosening, loosening_of
from thermojoint.reduced.machine import (
    Guide,
    MovingAxis,
    ReducedMachine,
    along,
    reduce_machine,
)

#: The fastest minute of an axis, s.
MINUTE = 60.0
#: A machine is loosened, as one on feet, if that reduces the doubt to this share or less.
CLEARLY = 0.95
#: Least doubt of such a machine: at 1 the band would not allow for errors that no run shows.
UNLIKE = 1.1
#: An axis with less than this fraction of the largest displacement does not move.
STILL = 1e-6


@dataclass(frozen=True)
class Effort:
    """Effort of a calibration."""

    #: Effort and tolerances of the search for parameters.
    search: Search = SEARCH
    #: Plants and histories from which the bands are learned.
    drawing: Drawing = field(default_factory=Drawing)


#: The default effort.
USUAL = Effort()


@dataclass(frozen=True, eq=False, repr=False)
class JointAwareCalibration(Described):
    """A calibrated model and the intermediate results.

    Attributes
    ----------
    model : ObserverModel
    fit : Fit
    machine : ReducedMachine
        As described by the case, with the axes that move; loosened if that fits clearly better.
    runs : tuple of Run
        Calibration runs.
    unchecked : tuple of str
        Runs on which the band was not checked (`left_out.widened`).
    unknown_heat : float
        Heat of each face that comes from no source, W, if it is estimated; zero if not.
    days : tuple of str
        Recorded days, from which deviations from the case are learned, but no parameters.
    """

    model: ObserverModel
    fit: Fit
    machine: ReducedMachine
    runs: tuple[Run, ...]
    unchecked: tuple[str, ...] = ()
    unknown_heat: float = 0.0
    days: tuple[str, ...] = ()

    def _facts(self) -> dict[str, str]:
        return {"model": repr(self.model), "runs": str(len(self.runs))}


def sensors_of(case: Case, responses: Mapping[str, xr.Dataset]) -> tuple[str, ...]:
    """Return the probes of the case that every response has, then held surfaces likewise.

    Held surfaces are read if their temperature changes. A probe of the case that some responses
    have and others lack is left out with a warning, as is one that none has if they have others
    that the case does not name.

    Raises
    ------
    InputError
        There is none.
    """
    probes = {where: set(probes_of(response)) for where, response in responses.items()}
    shared, known = set.intersection(*probes.values()), set.union(*probes.values())
    unnamed = ", ".join(sorted(known - set(case.probes)))
    for name in case.probes:
        lacking = [where for where, one in probes.items() if name not in one]
        if lacking and (name in known or unnamed):
            warnings.warn(
                f"joint-aware: probe {name!r} of the case is left out, as it is not in "
                f"{', '.join(lacking)}; give every run its temperature"
                + (f", or the case the name of one of {unnamed}" if unnamed else ""),
                stacklevel=3,
            )
    sensors = tuple(name for name in case.probes if name in shared)
    held = tuple(name for name, one in case.held_temperatures.items() if one.file is not None)
    if not sensors:
        raise InputError(
            "joint-aware: the case names no probe that every response has; add [probes.NAME] where "
            "the sensors are"
        )
    return sensors + held


def warn_of_contradictions(
    case: Case, sensors: Sequence[str], responses: Mapping[str, xr.Dataset]
) -> None:
    """Warn of probes, displaced points and heat that are not in a response as in the case."""
    points = displacement_of(case)
    own = [repr(name) for name, one in case.sources.items() if one.heat_input is not None]
    places = {
        name: [MILLI * value for value in probe.position_mm]
        for name, probe in case.probes.items()
        if name in sensors
    }
    for where, response in responses.items():
        for name, apart in displaced(response, places):
            warnings.warn(
                f"joint-aware: probe {name!r} of {where} is {1e3 * apart:.3g} mm from that of the "
                "case; correct the place in the case or in the response",
                stacklevel=3,
            )
        if (told := response.attrs.get("displacement_of", points)) != points:
            warnings.warn(
                f"joint-aware: displacement of {where} is that of {told}, in the case that of "
                f"{points}; name the points in the case as they were measured",
                stacklevel=3,
            )
        if own and len(case.sources) > 1 and "source_power" not in response:
            warnings.warn(
                f"joint-aware: {where} has no power of each source, and its heat input is divided "
                f"in proportion to the powers in the case, although {', '.join(own)} of the case "
                "has a heat input of its own; record 'source_power'",
                stacklevel=3,
            )


@threadpool_limits.wrap(limits=1)
def calibrate_joint_aware(
    case: Case,
    responses: Mapping[str, xr.Dataset],
    sensors: Sequence[str] | None = None,
    noise: Noise | None = None,
    fitted: Sequence[str] | None = None,
    effort: Effort = USUAL,
) -> JointAwareCalibration:
    """Return the observer of a machine from its case and its calibration responses.

    Parameters
    ----------
    case : Case
        The machine as far as it is known; its heat input is not used.
    responses : mapping of str to xarray.Dataset
        Name (for error messages) to a run from rest with known heat input.
    sensors : sequence of str, optional
        Probes used as sensors; default those of the case.
    noise : Noise, optional
        Assumed noise.
    fitted : sequence of str, optional
        Parameters to fit; default all that the machine has.
    effort : Effort
        Effort of the calibration.

    Raises
    ------
    InputError
        Case and responses are inconsistent.
    ConvergenceError
        The machine cannot be marched, or its sensors do not determine the heat.
    """
    if not responses:
        raise InputError("joint-aware: no response to calibrate with; give one or more")
    names = tuple(sensors) if sensors is not None else sensors_of(case, responses)
    warn_of_contradictions(case, names, responses)
    if case.axes:
        return calibrate_machine(machine_of(case, names), responses, noise, fitted, effort)
    setup = set_up(case)
    machine, loosening = reduce_machine(case, setup, names), partial(loosening_of, case, setup)
    return calibrate_machine(machine, responses, noise, fitted, effort, loosening)


def machine_of(case: Case, sensors: Sequence[str]) -> ReducedMachine:
    """Return the machine of a case, which may have axes, with its `sensors`.

    Raises
    ------
    InputError
        As `fesim.setup.machine.set_up`, `reduce_machine` and `drives_on`.
    """
    if not case.axes:
        return reduce_machine(case, set_up(case), sensors)
    return machine_on_axes(case, set_up_axes(case), sensors)


def machine_on_axes(case: Case, ready: MovingSetup, sensors: Sequence[str]) -> ReducedMachine:
    """Return the machine of a case with axes and its set-up, with its `sensors`.

    Raises
    ------
    InputError
        As `reduce_machine` and `drives_on`.
    """
    axes = tuple(_moving_axis(case, axis) for axis in ready.axes)
    drives, way = drives_on(case, ready), ready.moving.guideway
    guide = Guide(axes, drives, way, place_of(ready.axes, 0.0))
    machine = reduce_machine(case, ready.setup, sensors, guide)
    return machine.with_probes(displacement_probes(ready).tolist())


def _moving_axis(case: Case, axis: Axis) -> MovingAxis:
    """Axis of a case as part of a model."""
    section = case.axes[axis.name]
    own = np.abs(unit_direction(section)).round(9) == 1.0
    along = "".join(one for one, moves in zip(DIRECTIONS, own, strict=True) if moves)
    return MovingAxis(axis.name, along, axis.asked, axis.reference, section.odometer)


def calibrate_machine(
    machine: ReducedMachine,
    responses: Mapping[str, xr.Dataset],
    noise: Noise | None = None,
    fitted: Sequence[str] | None = None,
    effort: Effort = USUAL,
    loosening: Callable[[], Loosening | None] = lambda: None,
) -> JointAwareCalibration:
    """Return the observer of an already reduced machine; see `calibrate_joint_aware`.

    `loosening` makes the compliant supports and films of a machine that is unlike its case.
    """
    moving = axes_that_move(responses.values(), machine.axes, STILL, "joint-aware")
    machine = along(machine, moving)
    every = {name: run_in(response, machine, name) for name, response in responses.items()}
    if not highest_heat(machine, list(every.values())):
        raise InputError("joint-aware: no run has any heat; add one, such as a step")
    names = tuple(name for name, run in every.items() if machine.guide or not is_day(run))
    # Without any shorter run with heat, there are only days to fit.
    if not highest_heat(machine, [every[name] for name in names]):
        names = tuple(every)
    days = tuple(name for name in every if name not in names)
    coarse = {name: fewer(run) for name, run in every.items()}
    fit = fit_physics(machine, [coarse[name] for name in names], fitted, effort.search)
    if days and fit.doubt <= 1.0:
        # For a machine of the family, days contribute to the parameters only, like any run.
        again = fit_physics(machine, list(coarse.values()), fitted, effort.search)
        if again.doubt <= 1.0:
            days, names, fit = (), tuple(every), again
    whole, runs = [every[name] for name in names], [coarse[name] for name in names]
    if fitted is None:
        machine, fit = loosened(machine, runs, fit, effort.search, loosening)
    known = calibrated_range(machine, responses)
    noises = [noise] if noise else _noises(machine, fit, known, runs)
    found = [_observer(machine, whole, fit, known, one, effort.drawing) for one in noises]
    # Of two observers the one with the narrower band, checked on runs that were left out.
    worth = [float(variance_of_heat(model).sum()) for model, _ in found]
    if days:
        # Errors in days that are left out are a better criterion.
        recorded = [every[name] for name in days]
        told = [_with_days(model, recorded, whole) for model, _ in found]
        worth = [squares for _, squares in told]
        found = [(model, apart) for (model, _), (_, apart) in zip(told, found, strict=True)]
    chosen = int(np.argmin(worth))
    model, unchecked = found[chosen]
    apart, heat = tuple(names[k] for k in unchecked), noises[chosen].unknown_heat
    return JointAwareCalibration(model, fit, machine, tuple(runs), apart, heat, days)


def _with_days(
    model: ObserverModel, days: Sequence[Run], others: Sequence[Run]
) -> tuple[ObserverModel, float]:
    """A model with corrections by recorded days, and its mean square error in days left out, m2."""
    shown = [[shown_in(model, run) for run in runs] for runs in (days, others)]
    return with_days(model, *shown)


def loosened(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    search: Search,
    loosening: Callable[[], Loosening | None],
) -> tuple[ReducedMachine, Fit]:
    """Return a machine with its fit, or loosened with its own fit if that has clearly less doubt.

    A machine of the family of its case is not fitted again. A loosened one counts as unlike its
    case even if the additional parameters explain all of its runs (`UNLIKE`).

    Parameters
    ----------
    machine : ReducedMachine
        As described by its case.
    runs : sequence of Run
        From rest.
    fit : Fit
        Of all its parameters.
    search : Search
        Effort and tolerances.
    loosening : callable
        Makes the loosening of the machine; only called if it is needed.
    """
    if fit.doubt <= 1.0 or (loose := loosening()) is None:
        return machine, fit
    other = loose.of(machine)
    try:
        again = fit_physics(other, runs, search=search)
    except ConvergenceError:
        return machine, fit
    if again.doubt > CLEARLY * fit.doubt:
        return machine, fit
    return other, replace(again, doubt=max(again.doubt, UNLIKE))


def _noises(
    machine: ReducedMachine, fit: Fit, known: Calibrated, runs: Sequence[Run]
) -> list[Noise]:
    """The usual noise, and one with unknown heat if thermometers determine it."""
    heat = seen_heat(machine, fit, known, largest_displacement(runs))
    return [NOISE, Noise(unknown_heat=heat)] if heat else [NOISE]


def _observer(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    known: Calibrated,
    noise: Noise,
    drawing: Drawing,
) -> tuple[ObserverModel, list[int]]:
    """The observer of a fit with its band, and the indices of runs on which it is not checked."""
    model = make_observer(machine, fit, known, noise)
    band = open_band(machine, [fewer(run) for run in runs], fit, model, noise, drawing)
    model = replace(model, band=band)
    band, unchecked = widened(machine, runs, fit, model, noise, drawing)
    # The machines of the band have no power readings: where there are any, it is too wide.
    return replace(model, band=band, power_shares=machine.power_shares), unchecked


def calibrated_range(machine: ReducedMachine, responses: Mapping[str, xr.Dataset]) -> Calibrated:
    """Return the range of calibration responses."""
    every = np.vstack(
        [temperatures_in(response, machine.sensor_names) for response in responses.values()]
    )
    loads = np.vstack(
        [recorded(one, "load_factor", machine.load_names) for one in responses.values()]
    )
    return Calibrated(
        duration_s=max(float(response["time"].to_numpy()[-1]) for response in responses.values()),
        heat=max(
            float(np.abs(heat_in(response, machine) / machine.power).max())
            for response in responses.values()
        ),
        temperatures={
            name: (min(0.0, float(column.min())), float(column.max()))
            for name, column in zip(machine.sensor_names, every.T, strict=True)
        },
        speeds=tuple(
            np.max([_fastest(one, machine) for one in responses.values()], axis=0).tolist()
        ),
        loads=tuple((float(one.min()), float(one.max())) for one in loads.T),
    )


def _fastest(response: xr.Dataset, machine: ReducedMachine) -> Array:
    """Speed of each moving axis in its fastest minute of a run, (x,), m/s."""
    times = response["time"].to_numpy().astype(float)
    positions = recorded(response, "axis_position", machine.axis_names)
    ways = ways_of(response, machine, positions)
    lasts = min(MINUTE, float(times[-1] - times[0]))
    ends = np.maximum(times, times[0] + lasts)
    found = [
        (np.interp(ends, times, way) - np.interp(ends - lasts, times, way)).max() / lasts
        for way in ways.T
    ]
    return np.array(found)
