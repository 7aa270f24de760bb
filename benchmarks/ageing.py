"""A preload that falls by 30 % in the middle of two days, and an estimator that learns it.

The model stands on a 50/25 mm mesh, the plants on a 40/20 mm mesh: one with the parameters of the
case, one with parameters drawn from their priors. Each is calibrated from its steps of 0.5, 1 and
2, runs through two days of random heat, and loses 30 % of its preload in the middle. It is followed
by temperatures alone: by the estimator as calibrated, with the preload learnt, with all that can
age learnt. The measure of it all is a plant that had no more than the 70 % from the beginning,
followed by an estimator that was calibrated with that one.

    python -m benchmarks.ageing --out ageing.json       # about 10 minutes
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from benchmarks.hand_placed import MODEL, PLACES, PLANT
from benchmarks.plants.judging import with_sensors
from benchmarks.sensor_count import CALIBRATED, STEP, Plant, candidates_on, drawn
from benchmarks.study import options_of, write_json
from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.physics_fit import fit_physics
from estimator.interface import Estimator, follow
from estimator.joint_aware.ageing import AgeingJointAware
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_model import Calibrated
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import ReducedMachine, diagonal_modes
from thermojoint.reduced.parameters import with_factors
from thermojoint.reduced.physics import conduct, make_physics, settle_joint

#: Of heat and plant; the constants of `estimator.joint_aware.ageing` were found with another one.
SEED = 21
DURATION, FALL, LEFT = 2 * 86400.0, 86400.0, 0.7
#: How long a level of heat lasts, s, and the highest.
LASTS, HIGHEST = (300.0, 2400.0), 2.0
#: Where errors are judged, s from the fall.
SPANS = {
    "before": (-FALL, 0.0),
    "0-2 h after": (0.0, 7200.0),
    "2-6 h": (7200.0, 21600.0),
    "6-24 h": (21600.0, 86400.0),
}


def inputs_of(machine: ReducedMachine, rng: np.random.Generator) -> Array:
    """Random levels of heat over the whole run; the ambient stays."""
    inputs = np.zeros((round(DURATION / STEP), machine.power.size + 1))
    at = 0
    while at < len(inputs):
        lasts = round(rng.uniform(*LASTS) / STEP)
        inputs[at : at + lasts, :-1] = rng.uniform(0.0, HIGHEST) * machine.power
        at += lasts
    return inputs


def falling(machine: ReducedMachine, inputs: Array, left: float) -> tuple[Array, Array]:
    """March a plant whose preload is multiplied by `left` in the middle; gaps and slips stay."""
    held = machine.at_preload
    modes = diagonal_modes(machine, held)
    physics = make_physics(modes, machine.joints, held)
    amplitudes, joint = np.zeros(modes.rates.size), physics.at_rest()
    temperatures, displacements = [], []
    for k, given in enumerate(inputs):
        if k == round(FALL / STEP):
            physics = make_physics(modes, with_factors(machine, {"preload": left}).joints, held)
            joint, _ = settle_joint(physics, joint, amplitudes, modes.factors)
        amplitudes = conduct(physics, amplitudes, given, joint, STEP)
        joint, displacement = settle_joint(physics, joint, amplitudes, modes.factors)
        temperatures.append(modes.sensors @ amplitudes)
        displacements.append(displacement)
    return np.array(temperatures), np.array(displacements)


def calibrated(model: ReducedMachine, plant: ReducedMachine) -> JointAware:
    """Return the observer of a plant from its own steps."""
    names = list(PLACES)
    runs = Plant(plant, np.zeros((1, plant.power.size + 1))).seen(names)
    fit = fit_physics(model, runs)
    known = Calibrated(CALIBRATED, HIGHEST, dict.fromkeys(names, (0.0, 100.0)))
    return JointAware(make_observer(model, fit, known))


def judged(estimator: Estimator, answers: tuple[Array, Array]) -> tuple[dict[str, Any], list[Any]]:
    """Largest errors in every span, µm, and what was learnt at the end."""
    begun = time.process_time()
    samples = ((STEP * (k + 1), *row, 0.0) for k, row in enumerate(answers[0]))
    found = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    wrong = 1e6 * np.abs(np.array([one.displacement for one in found]) - answers[1])
    at = STEP * np.arange(1, len(wrong) + 1) - FALL
    spans = {
        name: wrong[(at > low) & (at <= high)].max(axis=0).tolist()
        for name, (low, high) in SPANS.items()
    }
    taken = 1e3 * (time.process_time() - begun) / len(wrong)
    names = [channel.name for channel in estimator.details]
    hourly = [
        {name: float(value) for name, value in zip(names, one.details, strict=True) if "_f" in name}
        for one in found[359::360]
    ]
    return spans | {"ms_a_sample": taken}, hourly


def study() -> dict[str, Any]:
    """Return all figures."""
    names = list(PLACES)
    model = with_sensors(candidates_on(MODEL), names)
    other = with_sensors(candidates_on(PLANT), names)
    rng = np.random.default_rng(SEED)
    inputs = inputs_of(model, rng)
    plants = {"other mesh": other, "other mesh, drawn": drawn(other, rng)}
    rows = []
    for label, plant in plants.items():
        loose = with_factors(plant, {"preload": LEFT})
        before = calibrated(model, plant)
        aged = falling(plant, inputs, LEFT)
        same = falling(plant, inputs, 1.0)
        anew = calibrated(model, loose)
        everything = ("preload", "friction", "film")
        for how, estimator, answers in (
            ("nothing falls", before, same),
            ("nothing falls, preload learnt", AgeingJointAware(before, ("preload",)), same),
            ("as calibrated", before, aged),
            ("preload learnt", AgeingJointAware(before, ("preload",)), aged),
            ("all learnt", AgeingJointAware(before, everything), aged),
            ("calibrated anew", anew, falling(loose, inputs, 1.0)),
        ):
            spans, hourly = judged(estimator, answers)
            rows.append({"plant": label, "how": how, "hourly": hourly} | spans)
            print(label, how, {k: v for k, v in rows[-1].items() if k != "hourly"}, flush=True)
            print([{k: round(v, 2) for k, v in one.items()} for one in hourly[1::4]], flush=True)
    return {"seed": SEED, "left": LEFT, "rows": rows}


def main() -> None:
    """Run the study."""
    parser = options_of(__doc__, "ageing.json")
    options = parser.parse_args()
    with threadpool_limits(limits=1):
        found = study()
    write_json(options.out, found)
    table = Table(title="Largest error along x/y, µm")
    for name in ("plant", "estimator", *SPANS):
        table.add_column(name)
    for row in found["rows"]:
        cells = ["/".join(f"{value:.2f}" for value in row[name]) for name in SPANS]
        table.add_row(row["plant"], row["how"], *cells)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
