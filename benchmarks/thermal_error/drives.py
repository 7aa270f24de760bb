"""Inputs of the simulated machines: steps from rest, and days of speed and ambient."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Between samples, and steps of the march, s.
INTERVAL = 10.0
#: Heat grows with the speed as n^1.5; 3000 rpm is the reference step.
REFERENCE_RPM, EXPONENT = 3000.0, 1.5
STEP_S, DAY_S = 35 * 60.0, 8 * 3600.0
AMBIENT_DEGC = 20.0


@dataclass(frozen=True, eq=False)
class Drive:
    """Speed and room of a run; speed holds over the interval that ends at its sample."""

    #: Shape (k,): s, from 0 in intervals of `INTERVAL`.
    times: Array
    #: Shape (k,): 1/min, °C.
    rpm: Array
    ambient: Array


def heat_input(rpm: Array) -> Array:
    """Return the heat input at a speed, relative to the reference step, of the same shape."""
    return np.asarray((np.abs(rpm) / REFERENCE_RPM) ** EXPONENT)


def step(level: float) -> Drive:
    """Return a step of the heat input from rest in a still room."""
    times = INTERVAL * np.arange(round(STEP_S / INTERVAL) + 1.0)
    rpm = np.full(times.size, round(REFERENCE_RPM * level ** (1.0 / EXPONENT), 1))
    rpm[0] = 0.0
    return Drive(times, rpm, np.full(times.size, AMBIENT_DEGC))


def day(seed: int) -> Drive:
    """Return a day: speeds that last 5 to 40 min, a third of them zero, a room within 3 K."""
    rng = np.random.default_rng(seed)
    times = INTERVAL * np.arange(round(DAY_S / INTERVAL) + 1.0)
    rpm, now = np.zeros(times.size), 0.0
    while now < DAY_S:
        speed, lasts = 100.0 * np.floor(45.0 * rng.random()), 60.0 * (5.0 + 35.0 * rng.random())
        running = rng.random() > 1.0 / 3.0
        rpm[(times > now) & (times <= now + lasts)] = speed if running else 0.0
        now += lasts
    slow, fast = 2.0 * np.pi * rng.random(2)
    wave = 2.0 * np.sin(2.0 * np.pi * times / DAY_S + slow)
    wave += np.sin(2.0 * np.pi * times / 5400.0 + fast)
    return Drive(times, rpm, AMBIENT_DEGC + wave - wave[0])
