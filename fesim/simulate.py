"""Simulation of a case: set-up, time integration, response."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fesim.accuracy.estimate import Accuracy, Marched, accuracy_of
from fesim.axes.axis import Axis, cold_drives
from fesim.axes.course import Mapped, course_values, mapped
from fesim.axes.machine import MovingMachine
from fesim.axes.march import march_iterated, march_staggered
from fesim.axes.setup import MovingSetup, axis_inputs, set_up_axes
from fesim.case.history import Histories, entering_in_steps
from fesim.case.identity import set_up_differently
from fesim.case.schema import (
    TOLERANCE_K,
    TOLERANCE_UM,
    Case,
    case_from_data,
    read_case,
    step_count,
)
from fesim.forces import check_tight, mechanical_values, outputs_of
from fesim.march.adaptive import march_adaptively
from fesim.march.adaptive_state import Effort, Passed, StepEnds
from fesim.march.alternation import unresolved
from fesim.march.heat_step import each
from fesim.march.machine import State, Step, load_factors
from fesim.march.settling import at_rest
from fesim.march.step_control import Tolerance
from fesim.march.stepping import (
    Advance,
    iterated,
    march_along,
    staggered,
)
from fesim.march.track import Track, joined, track_of
from fesim.one_thread import threads_beside_solver, threads_of_march
from fesim.setup.bolts import first_forces
from fesim.setup.loads import MarchInputs, check_turns, march_inputs, source_names, source_power
from fesim.setup.machine import Setup, set_up
from fesim.setup.soundness import check_one_ambient
from fesim.setup.structure import displacement_of
from fesim.setup.temperature_dependence import convecting_surfaces
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.friction_heat import friction_work
from fesim.solid.linear_solver import default_solver
from meshes.covered import covered_areas
from thermojoint.artefacts.display import Described, as_html, curves
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.artefacts.response import ArrayResponse, array_response
from thermojoint.artefacts.units import MEGA, MICRO

if TYPE_CHECKING:
    import xarray as xr

COUPLINGS: dict[str, Advance] = {"staggered": staggered, "iterated": iterated}
#: From a machine with axes, inputs (n, k) and a state to the steps.
MovingMarch = Callable[[MovingMachine, Sequence[Axis], np.ndarray, State], Iterator[Track]]
MOVING_COUPLINGS: dict[str, MovingMarch] = {
    "staggered": march_staggered,
    "iterated": march_iterated,
}

Progress = Callable[[int, int], None]
OnStep = Callable[[Step], None]


@dataclass(frozen=True, repr=False)
class Simulation(Described):
    """A finished march.

    Attributes
    ----------
    arrays : ArrayResponse
        See `thermojoint.artefacts.response`.
    state : State
        State at the end; `simulate` continues from it with identical results.
    """

    arrays: ArrayResponse
    state: State

    @cached_property
    def response(self) -> xr.Dataset:
        """The response as a labelled dataset of the same arrays."""
        return self.arrays.dataset()

    def _facts(self) -> dict[str, str]:
        times, moved = self.response["time"], MEGA * self.response["displacement"][-1]
        final = zip(self.response["axis"].to_numpy(), moved.to_numpy(), strict=True)
        return {
            "title": str(self.response.attrs["title"]),
            "times": f"{times.size}, to {float(times[-1]) / 60.0:g} min",
            "final displacement": ", ".join(f"{axis} {value:.3g} µm" for axis, value in final)
            or "none",
        }

    def _repr_html_(self) -> str:
        shown = MEGA * self.response["displacement"]
        if not shown.size:
            shown = self.response["temperature"]
        names = [str(name) for name in shown[shown.dims[1]].to_numpy()]
        picture = curves(self.response["time"].to_numpy(), shown.to_numpy(), names)
        return as_html(type(self).__name__, self._facts(), picture)


def simulate(
    case: Case | Path | str,
    *,
    setup: Setup | MovingSetup | None = None,
    start: State | None = None,
    on_step: OnStep | None = None,
    progress: Progress | None = None,
    accuracy: bool = True,
) -> Simulation:
    """Run a case.

    Parameters
    ----------
    case : Case or path
        The case, or its file.
    setup : Setup or MovingSetup, optional
        The condensed structure, for several heat inputs on one structure; default
        `prepared(case)`. Its case may differ in heat, loads or duration only.
    start : State, optional
        A saved state to continue from; default the preload, and the case's initial temperatures.
    on_step : callable, optional
        Called with every step, e.g. to write snapshots.
    progress : callable, optional
        Called with (steps done, steps in all).
    accuracy : bool
        Whether the response includes the estimated errors of its displacement, which take a
        fraction of the time of the march; batches and calibrations omit them
        (`fesim.accuracy.estimate`).

    Raises
    ------
    InputError
        The case does not match the structure.
    ConvergenceError
        A step did not converge, or a pressure is beyond the range of the joint's law.
    """
    if not isinstance(case, Case):
        case = read_case(case)
    if setup is None:
        given = prepared(case)
    else:
        check_turns(case)
        given = setup
    moving = given if isinstance(given, MovingSetup) else None
    ready = standing(given)
    _check_fits(ready, case)
    inputs = march_inputs(case) if moving is None else axis_inputs(case)
    (at_zero,) = inputs.at(np.zeros(1))
    at_first = cold_drives(moving.axes if moving is not None else ())
    parts: list[_Course] = []
    first = start
    if first is None:
        rest = at_rest(ready.machine, at_zero)
        first = replace(rest.state, drive=at_first)
        parts.append(_kept(given, first.slip, replace(track_of(rest), drive=at_first[None])))
    _check_state(first, ready, at_first)
    count = step_count(case.march) - first.index
    if count < (1 if start is None else 2):
        raise InputError(
            f"march: the saved state is at {first.index * case.march.step_s:g} s already, less "
            "than two steps before the end; make march.duration_min longer"
        )
    ends = case.march.step_s * (first.index + 1.0 + np.arange(count, dtype=np.float64))
    state, done, passed = first, 0, None
    with threads_of_march(ready.machine.contact.count):
        for track, adaptive in _marching(case, given, inputs, ends, first):
            passed = adaptive
            _check_pressures(ready, track.pressure, ready.machine.thermal.step * track.index)
            # The temperature field is the only large part of a step: store the probes only.
            parts.append(_kept(given, state.slip, track))
            state = track.step(-1).state
            for at in range(len(track)):
                done += 1
                if on_step is not None:
                    on_step(track.step(at))
                if progress is not None:
                    progress(done, count)
    course = _joined(parts)
    response = _response(case, given, inputs, course)
    known = None
    if passed is not None:
        response.attrs.update(_spent(passed.effort))
        known = passed.effort.displacement
        state = replace(state, course=passed.now.packed(course.track.inputs[-1]))
    elif moving is None:
        response.attrs.update(_unresolved(ready, course.track))
    if accuracy and case.displacement is not None and moving is None:
        taken = course.track.displacement[-count:]
        marched = Marched(case, ready, COUPLINGS[case.march.coupling], start, taken)
        with threads_beside_solver(ready.machine.contact.count):
            response.attrs.update(_good_to(accuracy_of(marched, known)))
    return Simulation(response, state)


def prepared(case: Case) -> Setup | MovingSetup:
    """Set up a case, with or without moving axes, for `simulate`.

    Raises
    ------
    InputError
        As `fesim.setup.machine.set_up` and `fesim.axes.setup.set_up_axes`; or a load reverses
        where no step can follow.
    """
    check_turns(case)
    return set_up_axes(case) if case.axes else set_up(case)


def standing(given: Setup | MovingSetup) -> Setup:
    """Return the set-up of a machine; with moving axes, that of its position at time zero."""
    return given.setup if isinstance(given, MovingSetup) else given


def _marching(
    case: Case, ready: Setup | MovingSetup, inputs: MarchInputs, ends: np.ndarray, first: State
) -> Iterator[tuple[Track, Passed | None]]:
    """Yield the march up to the times of a response; an adaptive one with further results."""
    if isinstance(ready, MovingSetup):
        along, rows = MOVING_COUPLINGS[case.march.coupling], inputs.at(ends)
        for track in along(ready.moving, ready.axes, rows, first):
            yield track, None
        return
    machine, march = ready.machine, case.march
    if march.method == "adaptive" and ready.modes is not None:
        tolerance = Tolerance(
            MICRO * (march.tolerance_um or TOLERANCE_UM), march.tolerance_K or TOLERANCE_K
        )
        drive, rates = inputs.exactly(), ready.modes.rates
        judge = partial(_judge, ready, drive)
        yield from march_adaptively(machine, rates, drive, ends, tolerance, first, judge)
        return
    advance, between = COUPLINGS[march.coupling], inputs.reversed_forces(ends)
    for track in march_along(machine, inputs.at(ends), advance, first, between):
        yield track, None


def _spent(effort: Effort) -> dict[str, float | int]:
    """Attributes of a response from an adaptive march."""
    return {
        "march_steps": effort.steps,
        "rejected_steps": effort.rejected,
        "shortest_step_s": effort.shortest,
        "longest_step_s": effort.longest,
        "estimated_error_um": MEGA * effort.displacement,
        "estimated_error_K": effort.temperature,
    }


def _unresolved(ready: Setup, track: Track) -> dict[str, float | int]:
    """Attributes of a response whose steps do not resolve an oscillation; empty for others."""
    events = track.cuts > 0
    events[1:] |= np.diff(track.parts) > 0
    steps = unresolved(
        track.pressure / ready.machine.contact.reference_pressure, track.inputs, events
    )
    if not steps.size:
        return {}
    first, last = (float(ready.machine.thermal.step * track.index[at]) for at in steps[[0, -1]])
    return {"unresolved_steps": steps.size, "unresolved_from_s": first, "unresolved_to_s": last}


def _good_to(accuracy: Accuracy) -> dict[str, float | str]:
    """Attributes of a response with its estimated errors; unknown ones are left out."""
    parts = {name: getattr(accuracy, name) for name in ("total", "joint", "mesh", "time")}
    by_joint = {name: MEGA * value for name, value in accuracy.by_joint.items()}
    return {
        **{f"error_{name}_um": MEGA * part for name, part in parts.items() if part is not None},
        "error_by_joint_um": json.dumps(by_joint),
    }


@dataclass(frozen=True, eq=False)
class _Course:
    """Contents of a response: a track without its large fields, and the values read from them."""

    #: Track with empty temperatures, differences, frozen tangents and turnings.
    track: Track
    #: Shape (n, probes): temperatures of the probes, K.
    probes: np.ndarray
    #: Shape (n, o): `outputs_of` each step.
    outputs: np.ndarray
    #: Shape (n, m): frictional heat of the joints with slip heating, W.
    friction_heat: np.ndarray
    #: Displacement probes at other positions of the moving axes.
    mapped: Mapped


def _kept(given: Setup | MovingSetup, slip: np.ndarray, track: Track) -> _Course:
    """Contents of the response of a track that starts with a slip (2, m), m."""
    setup = standing(given)
    probes = each(setup.probe_rows, track.temperature)
    outputs = np.empty((len(track), 0))
    if setup.outputs is not None or setup.bolts is not None:
        outputs = np.array([outputs_of(setup, track.step(at)) for at in range(len(track))])
    none = np.empty((len(track), 0))
    small = replace(track, temperature=none, differences=none, frozen=none, turning=none)
    rubbed = np.empty((len(track), 0))
    if setup.machine.friction is not None:
        moved = np.diff(track.slip, axis=0, prepend=slip[None])
        elastic, counted = setup.machine.contact.elastic, setup.machine.friction.counted
        work = friction_work(elastic, track.remainder, track.gap, moved)
        rubbed = counted * work / setup.machine.thermal.step
    there = Mapped(np.empty((len(track), 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0)))
    if isinstance(given, MovingSetup):
        there = mapped(given, track)
    return _Course(small, probes, outputs, rubbed, there)


def _joined(parts: Sequence[_Course]) -> _Course:
    return _Course(
        joined([part.track for part in parts]),
        np.concatenate([part.probes for part in parts]),
        np.concatenate([part.outputs for part in parts]),
        np.concatenate([part.friction_heat for part in parts]),
        Mapped(*map(np.concatenate, zip(*(part.mapped for part in parts), strict=True))),
    )


def case_in(response: xr.Dataset, where: str, otherwise: str) -> Case:
    """Return the case contained in a simulated response.

    Parameters
    ----------
    response : xarray.Dataset
        Simulated or measured response.
    where : str
        Name of the response in error messages.
    otherwise : str
        End of the message if there is no case: the consequence, and what to do.

    Raises
    ------
    InputError
        There is no case, or it is unusable.
    """
    try:
        data = json.loads(response.attrs["case"])
    except (KeyError, ValueError, TypeError):
        raise InputError(f"{where}: contains no case, {otherwise}") from None
    return case_from_data(data, f"{where}, case", Path())


def _check_fits(ready: Setup, case: Case) -> None:
    """Refuse a set-up of another case if that of this one would be refused or different."""
    if ready.machine.thermal.step != case.march.step_s:
        raise InputError(
            f"march.step_s: {case.march.step_s:g} s, but the structure was set up for steps of "
            f"{ready.machine.thermal.step:g} s; set it up for this case"
        )
    if ready.case is case:
        return
    if (differing := set_up_differently(ready.case, case)) is not None:
        raise InputError(
            f"{differing}: the structure was set up for a case in which this differs; set it up "
            "for this case"
        )
    check_one_ambient(case)
    assembly, forces = ready.machine.assembly, first_forces(case)
    if assembly is not None and not np.array_equal(forces, assembly.factors[-1 - len(forces) : -1]):
        raise InputError(
            "bolts: the structure was set up with other bolt forces; set it up for this case"
        )


def _check_state(first: State, ready: Setup, drive: np.ndarray) -> None:
    """Refuse to begin at the state of another machine, which `drive` would not be a state of."""
    if first.model != ready.machine.thermal.model:
        raise InputError(
            "start: the state is of another reduced thermal model, built elsewhere; simulate from "
            'the start, or use thermal = "full" in [march] for both'
        )
    if first.drive.shape != drive.shape:
        raise InputError(
            "start: the state is of a machine with another drive; simulate from the start, or take "
            "the case that it was saved with"
        )


def _judge(ready: Setup, drive: Histories, ends: StepEnds) -> None:
    """Refuse pressures and bolt forces at the ends of steps, as for the rows of a response."""
    _check_pressures(ready, ends.pressure, ends.times)
    if ready.bolts is None:
        return
    for time, unknowns, remainder, _ in zip(*ends, strict=True):
        factors = load_factors(ready.machine, drive(time))
        check_tight(ready, ready.bolts.force.of(unknowns, remainder, factors), time)


def _check_pressures(ready: Setup, pressure: np.ndarray, times: np.ndarray) -> None:
    limit = ready.machine.contact.pressure_limit
    beyond = pressure > limit
    if beyond.any():
        step, element = np.argwhere(beyond)[0]
        name = [joint.name for joint in ready.joints for _ in joint.area][element]
        raise ConvergenceError(
            f"joint {name!r}: the pressure passes {MICRO * limit[element]:.4g} MPa, half of its "
            f"hardness, within {times[step]:g} s: the surfaces "
            "yield as a whole, which no joint law describes; check preload_MPa, hardness_GPa and "
            "the loads"
        )


def _response(
    case: Case, given: Setup | MovingSetup, inputs: MarchInputs, course: _Course
) -> ArrayResponse:
    setup = standing(given)
    machine, track = setup.machine, course.track
    names = [joint.name for joint in setup.joints for _ in joint.area]
    times = machine.thermal.step * track.index
    layout = inputs.layout
    powers = track.inputs[:, layout.source_columns]
    values = {
        "heat_input": _heat_input(case, inputs, times, powers[:, : len(case.sources)]),
        "source_power": powers,
        "ambient": track.inputs[:, layout.ambient],
        "temperature": course.probes,
        "displacement": track.displacement[:, : len(DIRECTIONS)],
        "probe_position": np.array([probe.position for probe in setup.probes.values()]),
        "pressure": track.pressure,
        "conductance": track.conductance,
        "heat_flow": track.heat_flow,
        "opening": track.gap[:, 0],
        "slip": track.slip.transpose(0, 2, 1),
        "contact_position": np.concatenate(
            [np.empty((0, 3)), *(joint.centre for joint in setup.joints)]
        ),
        "contact_area": np.concatenate([np.empty(0), *(joint.area for joint in setup.joints)]),
        "contact_joint": np.array(names, dtype=str),
        "gap_residual": track.residual,
        "iterations": track.iterations,
        "cuts": track.cuts,
        "taken_over": (track.parts > 0).astype(np.int64),
        "heat_balance": track.heat_balance,
    }
    if case.held_temperatures:
        values["held_temperature"] = track.inputs[:, layout.held_columns]
    if case.loads:
        values["load_factor"] = track.inputs[:, layout.count : layout.count + len(case.loads)]
    if machine.friction is not None:
        values["friction_heat"] = course.friction_heat
    if machine.variable is not None:
        values["secant_residual"] = track.secant_residual
    coords: dict[str, np.ndarray | list[str]] = {
        "time": times,
        "source": source_names(case),
        "probe": list(setup.probes),
        "axis": np.array(DIRECTIONS if case.displacement else (), dtype=str),
        "space": list(DIRECTIONS),
        "tangent": ["along", "across"],
        "contact": np.arange(1, machine.contact.count + 1),
    }
    if case.held_temperatures:
        coords["held"] = list(case.held_temperatures)
    if case.loads:
        coords["load"] = list(case.loads)
    if setup.outputs is not None or setup.bolts is not None:
        steps = [track.step(at) for at in range(len(track))]
        forces, places = mechanical_values(case, setup, steps, course.outputs)
        values, coords = values | forces, coords | places
    if isinstance(given, MovingSetup):
        moved, places = course_values(given, times, track, course.mapped)
        values, coords = values | moved, coords | places
    attrs: dict[str, str | float | int] = {
        "title": case.title,
        "reference_power_W": _reference_power(case),
        "case": case.model_dump_json(),
        "versions": _versions(),
        "linear_solver": case.march.solver or default_solver(),
        "thermal_model": "full" if setup.modes is None else "reduced",
        "thermal_unknowns": int(setup.spaces.heat.N),
        "thermal_modes": 0 if setup.modes is None else int(setup.modes.rates.size),
        "reduction_error": 0.0 if setup.modes is None else setup.modes.error,
        "displacement_unknowns": int(setup.spaces.displacement_size),
        "displacement_of": displacement_of(case),
        "covered_area_m2": json.dumps(
            _covered(setup.structure, tuple(convecting_surfaces(case)), tuple(setup.joints))
        ),
        "friction": ", ".join(f"{law.friction.coefficient:g}" for law, _ in machine.contact.laws),
    }
    return array_response(values, coords, attrs)


# The cases of a study have the same structure.
_covered = lru_cache(maxsize=1)(covered_areas)


@cache
def _versions() -> str:
    """Versions as JSON; cached, since reading them takes a tenth of a short march."""
    names = ("thermojoint", "scikit-fem", "numpy", "scipy")
    return json.dumps({name: version(name) for name in names})


def _reference_power(case: Case) -> float:
    """Return the heat of the reference step in the case, W, summed over several sources."""
    if len(case.sources) == 1:
        return next(iter(case.sources.values())).reference_power_W
    return sum(source_power(source) for source in case.sources.values())


def _heat_input(
    case: Case, inputs: MarchInputs, times: np.ndarray, powers: np.ndarray
) -> np.ndarray:
    """Return the case's heat input; if sources have their own, the mean weighted by power."""
    own = [source for source in case.sources.values() if source.heat_input is not None]
    if case.heat_input is not None and not own:
        # Not from the powers: 590 W x 1.5 / 590 W is 1.5 up to rounding only.
        if case.march.method == "adaptive":
            return np.where(times > 0.0, inputs.heat(times), 0.0)
        return np.where(times > 0.0, entering_in_steps(inputs.heat, inputs.step, times), 0.0)
    total = sum(power for power, _ in inputs.sources)
    return powers.sum(axis=1) / total if total else np.zeros(len(times))
