"""Random parts of a plant: physics unknown to its model, and errors of its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fesim.case.schema import Case
from thermojoint.artefacts.arrays import Array

#: Ranges of absolute values, and of factors on the case's.
FRICTION, TANGENTIAL_RATIO, FILM = (0.2, 0.8), (0.3, 1.0), (4.0, 10.0)
FACTORS = {
    "preload": (0.8, 1.2),
    "roughness": (0.7, 1.3),
    "conduction": (0.92, 1.08),
    "capacity": (0.95, 1.05),
    "modulus": (0.94, 1.06),
    "expansion": (0.96, 1.04),
    "heat": (0.9, 1.1),
}
#: Sensor offsets, K, either way.
OFFSET = 0.2
#: Films of the family with uneven films, W/m2K: outside and at the rear (evenly in the logarithm),
#: and inside, where the case has none.
UNEVEN, INSIDE = (2.0, 15.0), (0.0, 5.0)
#: Outside, rear and inside of its first plants: the case's, and those of docs/joint-aware.md.
FIRST = ((6.0, 6.0, 0.0), (5.0, 19.0, 3.0))


@dataclass(frozen=True, eq=False)
class Plant:
    """One drawn machine.

    Attributes
    ----------
    number : int
        Of the plant; with the seed of the study it says all the rest.
    factors : dict of str to float
        On the case's parameters (`thermojoint.reduced.parameters`).
    offset : ndarray, shape (p,)
        Of every sensor, K.
    seed : int
        Of its noise and of its day.
    """

    number: int
    factors: dict[str, float]
    offset: Array
    seed: int


def draw_plant(case: Case, sensors: Sequence[str], seed: int, number: int) -> Plant:
    """Return plant `number` of the study with `seed`; every range is drawn from evenly."""
    rng = np.random.default_rng((seed, number))
    (section,) = case.joints.values()
    (film,) = case.convection_W_m2K.values()
    factors = {
        "friction": rng.uniform(*FRICTION) / section.friction_coefficient,
        "tangential ratio": rng.uniform(*TANGENTIAL_RATIO) / section.tangential_stiffness_ratio,
        "film": rng.uniform(*FILM) / film,
    }
    factors |= {name: rng.uniform(*ends) for name, ends in FACTORS.items()}
    return _with_sensors(rng, number, factors, len(sensors))


def draw_uneven_films(case: Case, sensors: Sequence[str], seed: int, number: int) -> Plant:
    """Return plant `number` whose films differ from surface to surface; all else is the case's."""
    rng = np.random.default_rng((seed, number))
    (film,) = case.convection_W_m2K.values()
    outside, rear = np.exp(rng.uniform(*np.log(UNEVEN), size=2))
    inside = rng.uniform(*INSIDE)
    if number < len(FIRST):
        outside, rear, inside = FIRST[number]
    factors = {
        "film": outside / film,
        "film rear": rear / outside,
        "film interior, W/m2K": inside,
    }
    return _with_sensors(rng, number, factors, len(sensors))


def _with_sensors(
    rng: np.random.Generator, number: int, factors: dict[str, float], sensors: int
) -> Plant:
    offset = rng.uniform(-OFFSET, OFFSET, size=sensors)
    own = int(rng.integers(2**31))
    return Plant(number, {name: float(one) for name, one in factors.items()}, offset, own)


#: Random parameters of the plants of a study.
FAMILIES = {"parameters": draw_plant, "films": draw_uneven_films}
