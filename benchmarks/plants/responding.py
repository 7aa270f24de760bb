"""Responses of a plant, as measured by its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from benchmarks.plants.drawing import Plant
from benchmarks.plants.driving import Drive
from calibrate.joint_aware.misfit import physics_with
from estimator.noise import sensor_noise
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import make_response
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.physics import simulate_known

#: Of temperatures, K peak to peak, and of displacements in calibration, m.
TEMPERATURE_NOISE, DISPLACEMENT_NOISE = 0.12, 5e-8
#: Constant parts of a response: positions, for estimators that need them.
KEPT = ("probe_position", "contact_position", "contact_area", "contact_joint")


@dataclass(frozen=True, eq=False)
class Answer:
    """A run of a plant, exactly."""

    #: Its inputs.
    drive: Drive
    #: Shape (n + 1, p): from rest, K.
    temperature: Array
    #: Shape (n + 1, axes): m.
    displacement: Array


def answers(machine: ReducedMachine, plant: Plant, runs: dict[str, Drive]) -> dict[str, Answer]:
    """March a plant through runs."""
    physics = physics_with(machine, plant.factors)
    found = {}
    for name, drive in runs.items():
        heat = drive.heat[:, None] * machine.power
        marched = simulate_known(physics, np.column_stack([heat, drive.ambient]), machine.step)
        found[name] = Answer(drive, *(np.vstack([np.zeros(one.shape[1]), one]) for one in marched))
    return found


def measured(
    answer: Answer,
    machine: ReducedMachine,
    places: xr.Dataset,
    offset: Array,
    noise: tuple[float, float],
    seed: int,
) -> xr.Dataset:
    """Return a run as a response with offset sensors and noise; the power in W is not known.

    `answer`: the run. `machine`: names sensors and axes. `places`: a response of the machine, of
    any length. `offset` (p,): of the sensors, K. `noise`: of temperatures, K peak to peak, and
    standard deviation of displacements, m. `seed`: of the noise.
    """
    times = machine.step * np.arange(len(answer.temperature))
    temperature, displacement = answer.temperature + offset, answer.displacement
    if noise[0] > 0.0:
        temperature = temperature + sensor_noise(times, noise[0], seed, offset.size)
    rng = np.random.default_rng(seed)
    displacement = displacement + noise[1] * rng.standard_normal(displacement.shape)
    heat = np.append(answer.drive.heat[0], answer.drive.heat)
    return make_response(
        {
            "heat_input": heat,
            "ambient": np.append(0.0, answer.drive.ambient),
            "temperature": temperature,
            "displacement": displacement,
        }
        | {name: places[name].to_numpy() for name in KEPT},
        {name: places[name].to_numpy() for name in ("probe", "axis", "space", "contact")}
        | {"time": times},
        {str(name): value for name, value in places.attrs.items()},
    )
