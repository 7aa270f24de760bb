"""Random parts of a plant: physics unknown to its model, and errors of its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
#: Differences in structure: lengths, whole mm; laws; preload at the strips' upper end, relative;
#: stiffness of a foot, N/um; factor of an open door; heat in a body, W; change of conductivity and
#: expansion, 1/K; warmer air at the top, K; lag of a sensor, s; its displacement either way, mm.
DIMENSIONS = {"wall": (48, 53), "source_top": (695, 725), "screw_x": (685, 715)}
LAWS = (("surface", "back-burdekin"), ("cmy-1969", "yovanovich-1982"))
UNEVEN_PRELOAD, FOOT, DOOR = 0.3, (500.0, 5000.0), (1.2, 2.0)
FRICTION_HEAT, CONDUCTION, EXPANSION = (0.0, 50.0), (-1e-3, 0.0), (0.0, 1e-3)
GRADIENT, LAG, DISPLACED = (0.0, 3.0), (5.0, 60.0), 10.0
#: Parts of the surface with a film of their own, evenly in the logarithm within `UNEVEN`.
PARTS = ("column", "top", "table", "rear")


@dataclass(frozen=True, eq=False)
class Unlike:
    """What a plant has and its model cannot have by any parameter."""

    #: Of the structure, mm.
    dimensions: dict[str, float]
    #: Of the joint and of its conductance.
    laws: tuple[str, str]
    #: Preload at the upper end of the strips relative to the mean, less 1; linear along them.
    uneven: float
    #: Stiffness under the column and under the screw, N/um along every axis.
    feet: tuple[float, float]
    #: Of every part of the surface, W/(m2 K).
    films: dict[str, float]
    #: Factor on all films while a door is open.
    door: float
    #: Largest heat in a body that the model does not know of, W.
    friction: dict[str, float]
    #: Change of conductivity and expansion, 1/K.
    conduction: float
    expansion: float
    #: Air at the top is warmer by this after hours, K.
    gradient: float
    #: Shape (p,): time constant of every sensor, s.
    lag: Array
    #: Shape (p, 2): displacement of every sensor along the surface it is on, mm.
    place: Array


@dataclass(frozen=True, eq=False)
class Plant:
    """One drawn machine."""

    #: Of the plant; with the seed of the study it says all the rest.
    number: int
    #: On the case's parameters (`thermojoint.reduced.parameters`).
    factors: dict[str, float]
    #: Shape (p,): of every sensor, K.
    offset: Array
    #: Of its noise and of its day.
    seed: int
    #: Differences in structure.
    unlike: Unlike | None = None


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
    outside, rear = _spread(rng, 2)
    inside = rng.uniform(*INSIDE)
    if number < len(FIRST):
        outside, rear, inside = FIRST[number]
    factors = {
        "film": outside / film,
        "film rear": rear / outside,
        "film interior, W/m2K": inside,
    }
    return _with_sensors(rng, number, factors, len(sensors))


def _spread(rng: np.random.Generator, count: int) -> Array:
    """Draw films, W/(m2 K), evenly in their logarithms."""
    low, high = np.log(UNEVEN)
    return np.exp(rng.uniform(low, high, count))


def draw_unlike(case: Case, sensors: Sequence[str], seed: int, number: int) -> Plant:
    """Return plant `number` of those that differ from the case in structure, and in parameters."""
    plant = draw_plant(case, sensors, seed, number)
    rng = np.random.default_rng((seed, number, 1))
    films = dict(zip(PARTS, _spread(rng, len(PARTS)), strict=True))
    unlike = Unlike(
        dimensions={
            name: float(rng.integers(*ends, endpoint=True)) for name, ends in DIMENSIONS.items()
        },
        laws=(str(rng.choice(LAWS[0])), str(rng.choice(LAWS[1]))),
        uneven=rng.uniform(-UNEVEN_PRELOAD, UNEVEN_PRELOAD),
        feet=(np.exp(rng.uniform(*np.log(FOOT))), np.exp(rng.uniform(*np.log(FOOT)))),
        films=films | {"interior": rng.uniform(*INSIDE)},
        door=rng.uniform(*DOOR),
        friction={body: rng.uniform(*FRICTION_HEAT) for body in ("table", "base")},
        conduction=rng.uniform(*CONDUCTION),
        expansion=rng.uniform(*EXPANSION),
        gradient=rng.uniform(*GRADIENT),
        lag=rng.uniform(*LAG, size=len(sensors)),
        place=rng.uniform(-DISPLACED, DISPLACED, size=(len(sensors), 2)),
    )
    factors = {name: one for name, one in plant.factors.items() if name != "film"}
    return replace(plant, factors=factors, unlike=unlike)


def _with_sensors(
    rng: np.random.Generator, number: int, factors: dict[str, float], sensors: int
) -> Plant:
    offset = rng.uniform(-OFFSET, OFFSET, size=sensors)
    own = int(rng.integers(2**31))
    return Plant(number, {name: float(one) for name, one in factors.items()}, offset, own)


#: Random parameters of the plants of a study.
FAMILIES = {
    "parameters": draw_plant,
    "films": draw_uneven_films,
    "structural": draw_unlike,
}
