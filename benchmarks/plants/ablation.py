"""Which difference in structure the error of a day comes from.

    python -m benchmarks.plants.ablation --seed 101 --number 0 --out ablation.json

A plant of the structural family, whole and then without one of its differences, in the calibration
and in the day alike: what its error falls by is what this difference costs. Four sensors, steps and
a cool-down, everything on steps of 20 s, as the bands are drawn; the fit ends sooner than a user's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from benchmarks.plants.drawing import PARTS, Plant, Unlike, draw_unlike
from benchmarks.plants.judging import (
    CALIBRATIONS,
    Machines,
    exact_answers,
    judged_run,
    shown,
    with_sensors,
)
from benchmarks.plants.preparing import prepared
from benchmarks.plants.responding import Answer
from benchmarks.study import case_file, options_of, write_rows
from calibrate.joint_aware.assembling import observer_from_rest
from calibrate.joint_aware.calibration import calibrated_range
from calibrate.joint_aware.misfit import fewer
from calibrate.joint_aware.open_band import HEALTHY
from calibrate.joint_aware.physics_fit import Fit, Search, fit_physics
from calibrate.joint_aware.readings import run_in
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_model import Calibrated, ObserverModel
from estimator.joint_aware.readings import samples_in
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA
from thermojoint.reduced.machine import ReducedMachine

#: Of plants and model, s; sensors; what the fit takes.
STEP, SENSORS, LABEL = 20.0, 4, "steps and cool-down"
SEARCH = Search(starts=0, rounds=2, evaluations=8, close=1e-3)
CASES = ("day", "step-3.0")


def _without_friction(unlike: Unlike) -> Unlike:
    return replace(unlike, friction=dict.fromkeys(unlike.friction, 0.0))


def _with_a_closed_door(unlike: Unlike) -> Unlike:
    return replace(unlike, door=1.0)


def _with_even_air(unlike: Unlike) -> Unlike:
    return replace(unlike, gradient=0.0)


def _without_unknown_heat(unlike: Unlike) -> Unlike:
    return _with_even_air(_with_a_closed_door(_without_friction(unlike)))


def _with_the_model_s_films(unlike: Unlike) -> Unlike:
    """One film outside, beside those of rear and interior that the model has, too."""
    outside = {name: unlike.films["column"] for name in PARTS if name != "rear"}
    return replace(unlike, films=unlike.films | outside)


def _with_exact_sensors(unlike: Unlike) -> Unlike:
    return replace(unlike, lag=np.full_like(unlike.lag, 1e-3), place=np.zeros_like(unlike.place))


def _with_sensors_in_place(unlike: Unlike) -> Unlike:
    return replace(unlike, place=np.zeros_like(unlike.place))


#: What a plant is without, to the plant without it.
WITHOUT: dict[str, Callable[[Unlike], Unlike]] = {
    "nothing": lambda unlike: unlike,
    "friction heat": _without_friction,
    "open door": _with_a_closed_door,
    "warmer air": _with_even_air,
    "unknown heat, all three": _without_unknown_heat,
    "films of top and table": _with_the_model_s_films,
    "unknown heat, films of top and table": lambda unlike: _with_the_model_s_films(
        _without_unknown_heat(unlike)
    ),
    "temperature-dependent material": lambda unlike: replace(unlike, conduction=0.0, expansion=0.0),
    "elastic feet": lambda unlike: replace(unlike, feet=(1e6, 1e6)),
    "lags and places of sensors": _with_exact_sensors,
    "places of sensors": _with_sensors_in_place,
}


def main(arguments: list[str] | None = None) -> None:
    """Print a row for every difference, and write them."""
    parser = options_of(__doc__, "ablation.json")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, default=0)
    parser.add_argument("--without", action="append", choices=list(WITHOUT), default=[])
    parser.add_argument("--case", type=Path, default=case_file("reference"))
    options = parser.parse_args(arguments)
    case, machines = prepared(options.case, more=True)
    machines = on_steps_of(machines, STEP)
    plant = draw_unlike(case, machines.model.sensor_names, options.seed, options.number)
    write_rows(_rows(machines, plant, options.without or list(WITHOUT)), options.out)


def on_steps_of(machines: Machines, step: float) -> Machines:
    """Return the machines of a study on steps of another length, s."""
    return replace(
        machines,
        model=replace(machines.model, step=step),
        plant=replace(machines.plant, step=step),
        data=machines.data | {"march": machines.data["march"] | {"step_s": step}},
    )


def without(plant: Plant, difference: str) -> Plant:
    """Return a plant without one of its differences in structure (`WITHOUT`)."""
    assert plant.unlike is not None
    return replace(plant, unlike=WITHOUT[difference](plant.unlike))


def _rows(machines: Machines, plant: Plant, differences: list[str]) -> Iterator[dict[str, Any]]:
    for difference in differences:
        with threadpool_limits(limits=1):
            found = _calibrated(machines, without(plant, difference))
        yield {"plant": plant.number, "without": difference} | found


def _calibrated(machines: Machines, plant: Plant) -> dict[str, Any]:
    """Doubt and films of a fit, and its largest errors along every axis, um."""
    exact = exact_answers(machines, plant)
    machine, fit, known = fitted(machines, plant, exact, SENSORS)[:3]
    model = observer_from_rest(machine, fit, known)
    errors = largest_errors(model, machines, plant, exact)
    films = {
        parameter.name: parameter.factor(float(value))
        for parameter, value in zip(fit.parameters, fit.coordinates, strict=True)
        if parameter.name.startswith("film")
    }
    return errors | {"doubt": fit.doubt, "films": films}


class Fitted(NamedTuple):
    """A machine with some sensors, what it was fitted to, and the largest displacement there, m."""

    machine: ReducedMachine
    fit: Fit
    known: Calibrated
    largest: Array


def fitted(
    machines: Machines,
    plant: Plant,
    exact: Mapping[str, Answer],
    sensors: int,
    parameters: Sequence[str] | None = None,
) -> Fitted:
    """Return the fit of the model with its first sensors to a plant's steps and cool-down.

    `parameters`: those that are fitted; default all.
    """
    responses = shown(machines, plant, exact, CALIBRATIONS[LABEL])
    machine = with_sensors(machines.model, machines.model.sensor_names[:sensors])
    runs = [fewer(run_in(response, machine, name)) for name, response in responses.items()]
    fit = fit_physics(machine, runs, parameters, SEARCH)
    largest = np.max([np.abs(run.displacement).max(axis=0) for run in runs], axis=0)
    return Fitted(machine, fit, calibrated_range(machine, responses), largest)


def largest_errors(
    model: ObserverModel, machines: Machines, plant: Plant, exact: Mapping[str, Answer]
) -> dict[str, list[float]]:
    """Return the largest errors of an observer along every axis in every case, um."""
    return {
        f"{name}_um": largest_error(model, judged_run(machines, plant, exact, name)[0]).tolist()
        for name in CASES
    }


def largest_error(model: ObserverModel, run: xr.Dataset) -> Array:
    """Return the largest error of an observer along every axis of a run, um, (axes,).

    No onset of heat counts as a fault: steps of 20 s do not resolve it.
    """
    samples = np.array(list(samples_in(run, model.sensors)))
    found = JointAware(model, thresholds=HEALTHY).displacements(samples)
    size: Array = MEGA * np.abs(found - columns_of(run, "displacement", model.axes)).max(axis=0)
    return size


if __name__ == "__main__":
    main()
