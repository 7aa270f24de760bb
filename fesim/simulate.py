"""From a case to a response: set up once, march, collect."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from artefacts.errors import InputError
from artefacts.response import make_response
from fesim.case.schema import Case, case_from_data, step_count
from fesim.forces import mechanical_values, outputs_of
from fesim.march.stepping import (
    Advance,
    CondensedMachine,
    State,
    Step,
    initial_state,
    iterated,
    load_factors,
    march,
    staggered,
)
from fesim.setup.loads import heat_history, input_layout, source_power, thermal_inputs
from fesim.setup.machine import Setup, measured_points, set_up
from fesim.setup.temperature_dependence import surfaces_with_films
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.linear_solver import default_solver
from meshes.covered import covered_areas

if TYPE_CHECKING:
    import xarray as xr

COUPLINGS: dict[str, Advance] = {"staggered": staggered, "iterated": iterated}

Progress = Callable[[int, int], None]
OnStep = Callable[[Step], None]


@dataclass(frozen=True)
class Simulation:
    """A finished march.

    Attributes
    ----------
    response : xarray.Dataset
        See `artefacts.response`.
    state : State
        At the end; `simulate` goes on from it with identical results.
    """

    response: xr.Dataset
    state: State


def simulate(
    case: Case,
    *,
    setup: Setup | None = None,
    start: State | None = None,
    on_step: OnStep | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Run a case.

    Parameters
    ----------
    case : Case
        What to run.
    setup : Setup, optional
        The case's structure condensed already, for several heat inputs on one structure; default
        `set_up(case)`. Its heat input is not used.
    start : State, optional
        A saved state to go on from; default the preload, and the case's initial temperatures.
    on_step : callable, optional
        Called with every step, e.g. to write snapshots.
    progress : callable, optional
        Called with (steps done, steps in all).

    Raises
    ------
    InputError
        The case does not fit the structure.
    ConvergenceError
        A step did not converge.
    """
    ready = setup if setup is not None else set_up(case)
    if ready.machine.thermal.step != case.march.step_s:
        raise InputError(
            f"march.step_s: {case.march.step_s:g} s, but the structure was set up for steps of "
            f"{ready.machine.thermal.step:g} s; set it up for this case"
        )
    inputs = thermal_inputs(case)
    first = start if start is not None else initial_state(ready.machine, inputs(0.0))
    if first.model != ready.machine.thermal.model:
        raise InputError(
            "start: the state is of another reduced thermal model, built elsewhere; simulate from "
            'the start, or use thermal = "full" in [march] for both'
        )
    steps = [] if start is not None else [at_rest(ready.machine, inputs(0.0))]
    probes = [ready.probe_rows @ step.state.temperature for step in steps]
    outputs = [outputs_of(ready, step) for step in steps]
    count = step_count(case.march) - first.index
    if len(steps) + count < 2:
        raise InputError(
            f"march: the saved state is at {first.index * case.march.step_s:g} s already, less "
            "than two steps before the end; make march.duration_min longer"
        )
    state = first
    marching = march(ready.machine, inputs, COUPLINGS[case.march.coupling], first)
    # A step is many small dense products: threads would only wait for each other.
    with threadpool_limits(limits=1):
        for done, step in enumerate(islice(marching, count), start=1):
            state = step.state
            # The temperature field is the one large thing in a step: keep the probes only.
            probes.append(ready.probe_rows @ state.temperature)
            outputs.append(outputs_of(ready, step))
            steps.append(replace(step, state=replace(state, temperature=np.empty(0))))
            if on_step is not None:
                on_step(step)
            if progress is not None:
                progress(done, count)
    response = _response(case, ready, steps, np.array(probes), np.array(outputs))
    return Simulation(response, state)


def case_in(response: xr.Dataset, where: str, otherwise: str) -> Case:
    """Return the case that a simulated response carries.

    Parameters
    ----------
    response : xarray.Dataset
        Simulated or measured.
    where : str
        For error messages.
    otherwise : str
        What to say, and to do, where there is no case.

    Raises
    ------
    InputError
        There is none, or it is unusable.
    """
    try:
        data = json.loads(response.attrs["case"])
    except (KeyError, ValueError, TypeError):
        raise InputError(f"{where}: holds no case, {otherwise}") from None
    return case_from_data(data, f"{where}, case", Path())


def at_rest(machine: CondensedMachine, inputs: np.ndarray | None = None) -> Step:
    """Row zero of a response: the machine at its preload, then its first temperatures and loads.

    Parameters
    ----------
    machine : CondensedMachine
        What will march.
    inputs : ndarray, shape (k + l,), optional
        At time zero; as for `fesim.march.stepping.initial_state`. Default: none.
    """
    if inputs is None:
        loads = 0 if machine.loads is None else machine.loads.gap.shape[1]
        inputs = np.zeros(machine.thermal.inputs.shape[1] + loads)
    state, elastic = initial_state(machine, inputs), machine.elastic
    displacement = elastic.probe_thermal @ machine.strained(state.temperature)
    remainder = np.zeros(3 * machine.contacts)
    if state.gap.any():
        value = machine.traction(state.gap, state.slip).value
        remainder = value.ravel() + elastic.reference * state.gap.ravel()
        displacement = displacement + elastic.probe_compliance @ (elastic.area * remainder)
    driven = np.zeros(len(inputs))
    if machine.loads is not None:
        factors = load_factors(machine, inputs)
        driven[machine.thermal.inputs.shape[1] :] = factors
        displacement = displacement + machine.loads.probes @ factors
    conductance = machine.conductance_in(state)
    jump = machine.thermal.jump @ state.temperature
    return Step(
        state=state,
        inputs=driven,
        conductance=conductance,
        heat_flow=conductance * elastic.area[: machine.contacts] * jump,
        displacement=displacement,
        remainder=remainder,
        residual=0.0,
        iterations=0,
        cuts=0,
        heat_balance=0.0,
    )


def _response(
    case: Case, setup: Setup, steps: list[Step], probes: np.ndarray, outputs: np.ndarray
) -> xr.Dataset:
    machine = setup.machine
    names = [joint.name for joint in setup.joints for _ in joint.area]
    times = machine.thermal.step * np.array([step.state.index for step in steps])
    inputs, layout = np.array([step.inputs for step in steps]), input_layout(case)
    values = {
        "heat_input": _heat_input(case, times, inputs[:, layout.source_columns]),
        "source_power": inputs[:, layout.source_columns],
        "ambient": inputs[:, layout.ambient],
        "temperature": probes,
        "displacement": np.array([step.displacement for step in steps]),
        "probe_position": np.array([probe.position for probe in setup.probes.values()]),
        "pressure": np.array([step.state.pressure for step in steps]),
        "conductance": np.array([step.conductance for step in steps]),
        "heat_flow": np.array([step.heat_flow for step in steps]),
        "opening": np.array([step.state.gap[0] for step in steps]),
        "slip": np.array([step.state.slip.T for step in steps]),
        "contact_position": np.concatenate(
            [np.empty((0, 3)), *(joint.centre for joint in setup.joints)]
        ),
        "contact_area": np.concatenate([np.empty(0), *(joint.area for joint in setup.joints)]),
        "contact_joint": np.array(names, dtype=str),
        "gap_residual": np.array([step.residual for step in steps]),
        "iterations": np.array([step.iterations for step in steps]),
        "cuts": np.array([step.cuts for step in steps]),
        "heat_balance": np.array([step.heat_balance for step in steps]),
    }
    if case.loads:
        values["load_factor"] = inputs[:, layout.count :]
    if machine.variable is not None:
        values["secant_residual"] = np.array([step.secant_residual for step in steps])
    coords: dict[str, np.ndarray | list[str]] = {
        "time": times,
        "source": list(case.sources),
        "probe": list(setup.probes),
        "axis": list(DIRECTIONS),
        "space": list(DIRECTIONS),
        "tangent": ["along", "across"],
        "contact": np.arange(1, machine.contacts + 1),
    }
    if case.loads:
        coords["load"] = list(case.loads)
    forces, places = mechanical_values(case, setup, steps, outputs)
    values, coords = values | forces, coords | places
    attrs: dict[str, str | float | int] = {
        "title": case.title,
        "reference_power_W": _reference_power(case),
        "case": case.model_dump_json(),
        "versions": json.dumps(
            {name: version(name) for name in ("thermojoint", "scikit-fem", "numpy", "scipy")}
        ),
        "linear_solver": case.march.solver or default_solver(),
        "thermal_model": "full" if setup.modes is None else "reduced",
        "thermal_unknowns": int(setup.spaces.heat.N),
        "thermal_modes": 0 if setup.modes is None else int(setup.modes.rates.size),
        "reduction_error": 0.0 if setup.modes is None else setup.modes.error,
        "displacement_unknowns": int(setup.spaces.displacement_size),
        "displacement_of": " relative to ".join(measured_points(case)),
        "covered_area_m2": json.dumps(
            covered_areas(setup.structure, surfaces_with_films(case), setup.joints)
        ),
        "friction": ", ".join(f"{law.friction.coefficient:g}" for law, _ in machine.laws),
    }
    return make_response(values, coords, attrs)


def _reference_power(case: Case) -> float:
    """Return the heat of the reference step as the case states it, W; of all sources if several."""
    if len(case.sources) == 1:
        return next(iter(case.sources.values())).reference_power_W
    return sum(source_power(source) for source in case.sources.values())


def _heat_input(case: Case, times: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Return the case's heat input; of sources with their own ones the mean weighted by power."""
    own = [source for source in case.sources.values() if source.heat_input is not None]
    if case.heat_input is not None and not own:
        # Not from the powers: 590 W x 1.5 / 590 W is 1.5 but for rounding.
        return np.where(times > 0.0, heat_history(case.heat_input)(times), 0.0)
    total = sum(source_power(source) for source in case.sources.values())
    return powers.sum(axis=1) / total if total else np.zeros(len(times))
