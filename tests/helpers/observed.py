"""A coarse machine on its reduced model and its observer, for the tests of the latter."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.calibration import calibrated_range
from calibrate.joint_aware.physics_fit import fit_physics
from calibrate.joint_aware.readings import run_in
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.readings import samples_in
from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from thermojoint.reduced.machine import along

SENSORS = ("s", "b", "T1", "T2")
#: A thermometer on the source and on four faces, by body; the step of the march there, s.
PLACES = {
    "s": ("column", [550.0, 700.0, 100.0]),
    "rear": ("column", [0.0, 600.0, 150.0]),
    "top": ("column", [300.0, 1150.0, 150.0]),
    "table": ("table", [1050.0, 350.0, 150.0]),
    "screw": ("screw", [1025.0, 175.0, 225.0]),
}
MINUTE = 60.0
ONSET = 60  # sample at which a fault begins
FAULTS = {
    "stuck": lambda values: np.full_like(values, values[0]),
    "5 K more": lambda values: values + 5.0,
    "5 K less": lambda values: values - 5.0,
    "3 K more": lambda values: values + 3.0,
    "broken": lambda values: np.full_like(values, -220.0),
    "fahrenheit": lambda values: 1.8 * values + 32.0 + 0.8 * 20.0,
    "away": lambda values: np.full_like(values, np.nan),
    "spikes": lambda values: values + 30.0 * (np.arange(values.size) % 15 == 0),
}


def observed_data(coarse_data):
    """The coarse machine with a sensor on the source, as data of a case."""
    found = copy.deepcopy(coarse_data)
    found["march"] |= {"thermal": "reduced", "duration_min": 10.0}
    found["probes"]["s"] = {"position_mm": [550.0, 700.0, 100.0], "body": "column"}
    return found


def run(data, setup, heat, minutes=10.0):
    given = copy.deepcopy(data)
    given["heat_input"] = heat
    given["march"]["duration_min"] = minutes
    return simulate(case_from_data(given, "case", Path()), setup=setup).response


def step(level):
    return {"kind": "step", "level": level}


def observer(machine, responses, axes=("x", "y")):
    """No parameter changed; its own responses leave nothing for the remainder."""
    machine = along(machine, axes)
    fit = fit_physics(machine, [run_in(one, machine, "step") for one in responses.values()], [])
    return JointAware(make_observer(machine, fit, calibrated_range(machine, responses)))


def estimates(estimator, samples, state=None):
    """The state at the end and the estimates."""
    found = list(follow(estimator, samples, estimator.initial_state() if state is None else state))
    return found[-1][0], [estimate for _, estimate in found]


def assert_goes_on(estimator, samples):
    """A run that is continued from its state is the uninterrupted one."""
    _, whole = estimates(estimator, samples)
    state, _ = estimates(estimator, samples[:40])
    _, rest = estimates(estimator, samples[40:], state)
    for one, other in zip(whole[40:], rest, strict=True):
        assert np.array_equal(one.displacement, other.displacement)
        assert np.array_equal(one.details, other.details)


def errors(estimator, response, found):
    actual = response["displacement"].sel(axis=list(estimator.axes)).to_numpy()
    return np.array([estimate.displacement for estimate in found]) - actual


def faulty(response, sensor, change, until=None):
    """Samples of which a sensor's readings, from `ONSET` on, are something else."""
    samples = np.array(list(samples_in(response, SENSORS)))
    part = slice(ONSET, until)
    samples[part, 1 + sensor] = change(samples[part, 1 + sensor])
    return samples.tolist()


def heated_through(machine, names):
    """A machine of `PLACES` with sources of 1 W on some of its faces, after its own."""
    faces = machine.faces[:, [list(PLACES).index(name) for name in names]]
    return replace(
        machine,
        sources=np.hstack([machine.sources, faces]),
        power=np.append(machine.power, np.ones(len(names))),
        source_names=(*machine.source_names, *names),
    )


def that_is_surprised(estimator, surprise=1e-12):
    """An observer with a band that is wider where innovations last, m2/K2 of each reading."""
    band = estimator.model.band
    wide = replace(band, surprise=np.full(band.surprise.shape, surprise))
    return JointAware(replace(estimator.model, band=wide))


def that_knows_days(estimator):
    """An observer with what recorded days may tell: a part of its innovations, on both axes."""
    band, rng = estimator.model.band, np.random.default_rng(1)
    axes, draws, twice = band.open.shape
    seen = np.full(3 * band.surprise.shape[1], 0.1)
    opened = np.zeros((axes, draws + 2, twice + seen.size))
    opened[:, :draws, :twice] = band.open
    opened[:, draws:, twice:] = 2e-6 * rng.normal(size=(axes, 2, seen.size))
    told = replace(
        band,
        open=opened,
        surprise=np.full(band.surprise.shape, 1e-12),
        seen=seen,
        told=1e-5 * rng.normal(size=(axes, seen.size)),
        allowed=np.array(0.5),
    )
    return JointAware(replace(estimator.model, band=told))
