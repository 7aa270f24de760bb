"""The runs of a plant: heat relative to the reference and ambient, on the steps of the march."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Lengths, s.
RUN, COOL_DOWN, DAY = 35 * 60.0, 4 * 3600.0, 8 * 3600.0
STEPS = (0.5, 1.0, 2.0)
#: The day: levels of heat, how long each lasts, s, and the ambient's range, K.
LEVELS, LASTS, AMBIENT = (0.0, 2.0), (300.0, 2400.0), 3.0
#: The triangle: its peak and how long it takes, s.
PEAK, TRIANGLE = 2.0, 600.0


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs of a run."""

    #: Shape (n,): at the end of each step, relative to the reference.
    heat: Array
    #: Shape (n,): above its initial value, K.
    ambient: Array


def drives(step: float, seed: int, days: int = 0) -> dict[str, Drive]:
    """Return every run by name, on steps of `step` (s); the day is drawn by `seed`.

    So are `days` further ones, each with other heat.
    """

    def times(length: float) -> Array:
        return step * np.arange(1.0, round(length / step) + 1.0)

    def still(heat: Array) -> Drive:
        return Drive(heat, np.zeros(len(heat)))

    short, long = times(RUN), times(COOL_DOWN)
    found = {f"step-{level}": still(np.full(short.size, level)) for level in (*STEPS, 1.5, 3.0)}
    return found | {
        "triangle": still(
            np.interp(short, [0.0, TRIANGLE / 2.0, TRIANGLE], [0.0, PEAK, 0.0], right=0.0)
        ),
        "cool-down": still(np.where(long <= RUN, max(STEPS), 0.0)),
        "day": _day(times(DAY), seed),
        **{f"day-{k}": _day(times(DAY), seed + k) for k in range(1, days + 1)},
    }


def switched(
    rng: np.random.Generator, times: Array, lasts: tuple[float, float], levels: tuple[float, float]
) -> Array:
    """Return random levels that last for random times, s, at `times` (n,)."""
    values, begun = np.empty(times.size), 0.0
    while begun < times[-1]:
        ends = begun + rng.uniform(*lasts)
        values[(times > begun) & (times <= ends)] = rng.uniform(*levels)
        begun = ends
    return values


def _day(times: Array, seed: int) -> Drive:
    rng = np.random.default_rng(seed)
    heat = switched(rng, times, LASTS, LEVELS)
    every = np.arange(0.0, times[-1] + 600.0, 600.0)
    walk = np.cumsum(rng.normal(size=every.size))
    walk = AMBIENT * (walk - walk[0]) / np.abs(walk - walk[0]).max()
    return Drive(heat, np.interp(times, every, walk))
