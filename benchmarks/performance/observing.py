"""A sample of the joint-aware estimator, and the calibration of its model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from time import perf_counter_ns, process_time

import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from benchmarks.performance.cases import calibrated, reference_machine
from benchmarks.performance.streaming import INTERVAL, SHORT, Measured, stream_times
from benchmarks.performance.timing import Row
from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.calibration import calibrate_machine, calibrated_range
from calibrate.joint_aware.physics_fit import fit_physics
from calibrate.joint_aware.readings import run_in
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.readings import samples_in
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.arrays import Array
from thermojoint.models.assembly import assemble
from thermojoint.models.sensors import readings, roles_in
from thermojoint.paper.inputs import CALIBRATION
from thermojoint.paper.observers import observer_case
from thermojoint.reduced.machine import ReducedMachine, along, reduce_machine

REPEATS = 20
LEVEL = "step-2.0"
#: Wanted of a calibration, s.
CALIBRATED_IN = 8.0


def rows(repeats: int = REPEATS) -> Iterator[Row]:
    """Yield the rows of the joint-aware estimator, with the equal-heights machine."""
    found, responses = calibrated()
    case, model, response = reference_machine(), found.model, responses[LEVEL]
    setup = set_up(case)
    roles = {} if found.placement is None else found.placement.roles
    known = observer_case(case, {role: setup.probes[name] for role, name in roles.items()})
    machine = along(reduce_machine(known, set_up(known), tuple(roles)), ["x", "y"])
    runs = [run_in(responses[name], machine, name) for name in CALIBRATION]
    fit = fit_physics(machine, runs, [])
    estimator = JointAware(make_observer(machine, fit, calibrated_range(machine, responses)))
    seen = readings(response, tuple(model.linear.direct), roles_in(response, model))
    measured = Measured(np.column_stack((seen.delta_T, seen.temperatures))[1:])
    assembled, count = assemble(model, INTERVAL, SHORT), round(SHORT / INTERVAL)
    marched = case.model_copy(
        update={"march": case.march.model_copy(update={"thermal": "reduced"})}
    )
    reduced = set_up(marched)
    samples = list(samples_in(response, tuple(roles)))
    ours, stream, steps = [], [], []
    with threadpool_limits(limits=1):
        # Machine code is made before anything is timed.
        simulate(marched, setup=reduced)
        sample_times(estimator, samples)
        for _ in range(repeats):
            ours.append(sample_times(estimator, samples))
            stream.append(stream_times(assembled, measured, count)[1:])
            begun = perf_counter_ns()
            simulate(marched, setup=reduced)
            steps.append(1e-3 * (perf_counter_ns() - begun) / count)
    physics = estimator.observer.physics
    note = (
        f"a sample of the joint-aware estimator ({physics.modes.rates.size} modes, "
        f"{physics.contacts} contact elements, {len(roles)} sensors, step 2.0) against {{}}; "
        f"{repeats} runs"
    )
    fchs = note.format("a sample of FCHS")
    yield _row("joint-aware-sample", ours, [float(np.mean(one)) for one in stream], fchs)
    every, other = np.concatenate(ours), float(np.percentile(np.concatenate(stream), 99.9))
    most = float(np.percentile(every, 99.9))
    yield Row("joint-aware-percentile", most, other, other / most, "µs", f"{fchs}; 99.9 %")
    yield _row("joint-aware-simulate", ours, steps, note.format("a step of the simulation"))
    yield calibration(machine, {name: responses[name] for name in CALIBRATION})


def calibration(machine: ReducedMachine, responses: Mapping[str, xr.Dataset]) -> Row:
    """Return the row of a calibration by some runs, on one thread."""
    begun = process_time()
    with threadpool_limits(limits=1):
        fit = calibrate_machine(machine, responses).fit
    ours = process_time() - begun
    return Row(
        "joint-aware-calibration",
        ours,
        CALIBRATED_IN,
        CALIBRATED_IN / ours,
        "s",
        f"processor time: {len(fit.parameters)} parameters from {len(responses)} steps, with the "
        f"band; {fit.evaluations} evaluations of all runs; set up before; measured once",
    )


def sample_times(estimator: JointAware, samples: list[tuple[float, ...]]) -> Array:
    """Return what every sample takes, µs; the first is left out."""
    state, taken = estimator.initial_state(), np.empty(len(samples))
    for k, (time, *values) in enumerate(samples):
        begun = perf_counter_ns()
        state, _ = estimator.sample(state, time, values)
        taken[k] = perf_counter_ns() - begun
    return 1e-3 * taken[1:]


def _row(name: str, ours: list[Array], other: list[float], note: str) -> Row:
    mean, theirs = float(np.mean(np.concatenate(ours))), float(np.mean(other))
    return Row(name, mean, theirs, theirs / mean, "µs", f"{note}; means")
