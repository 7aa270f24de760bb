"""Uncertain parameters of a machine, their priors, and the machine with other values.

Every parameter is a factor on a value of the case; its logarithm has a normal prior. The film of a
surface that has none in the case is not a factor but W/(m2 K), with half a normal distribution as
prior: a film cannot be negative, and most likely there is none. The same holds for the lag of a
sensor, in s. All parameters reuse one condensation:

- conduction, capacity, film: K, M and H are scaled on the same modes, which are diagonalised again,
  and so is the part of H of every surface. The modes are those of the nominal machine;
  docs/joint-aware.md shows the error due to that.
- heat: the columns of the sources.
- expansion: thermal gap and probe rows.
- give of a fixed support, for a machine that is unlike its case: um/kN (`supports`).
- modulus: compliance falls, the reference springs rise (they follow the modulus), and so do bolts;
  the thermal gap stays.
- preload: of the joints, and the forces of the bolts.
- other parameters of the joint: the law alone.
- heat and film of an axis's screw, expansion and lag of its scale: its drive alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

from fesim.solid.bolts import BoltSprings
from fesim.solid.condensation import LoadInfluence
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.films import Film
from thermojoint.reduced.machine import Joint, ReducedMachine


@dataclass(frozen=True)
class Parameter:
    """A factor on the case's value."""

    #: Scaled quantity.
    name: str
    #: Standard deviation of the logarithm of the factor before any calibration.
    spread: float
    #: Lower bound of a coordinate, in units of `spread`.
    least: ClassVar[float] = -3.0

    def factor(self, coordinate: float) -> float:
        """Return the factor of a coordinate, its logarithm."""
        return math.exp(coordinate)


@dataclass(frozen=True)
class Added(Parameter):
    """A quantity that the case does not have: a surface's film, or a sensor's lag.

    Attributes
    ----------
    name : str
        With its unit at the end (`ABSOLUTE`).
    spread : float
        Of the normal distribution whose upper half is the prior, W/(m2 K) or s.
    """

    least: ClassVar[float] = 0.0

    def factor(self, coordinate: float) -> float:
        """Return the film or the lag of a coordinate, W/(m2 K) or s."""
        return max(coordinate, 0.0)


@dataclass(frozen=True)
class Give(Parameter):
    """The give of a support that the case fixes, along every axis."""

    def factor(self, coordinate: float) -> float:
        """Return the give of a coordinate, the logarithm of its ratio to the usual, um/kN."""
        return GIVE * math.exp(coordinate)


#: In this order everywhere.
PARAMETERS = (
    Parameter("friction", 0.4),
    Parameter("preload", 0.2),
    Parameter("roughness", 0.3),
    Parameter("normal compliance", 0.3),
    Parameter("tangential ratio", 0.4),
    Parameter("heat", 0.1),
    Parameter("film", 0.4),
    Parameter("conduction", 0.08),
    Parameter("capacity", 0.05),
    Parameter("expansion", 0.04),
    Parameter("modulus", 0.06),
)

#: Spreads for the drive of an axis, whose name follows: friction of a nut changes with its grease.
OF_DRIVE = {"screw heat": 0.4, "screw film": 0.4, "scale expansion": 0.1, "scale lag": 0.5}
#: Spread of the factor of one surface's film beside the common one, and of a film that the case
#: does not have, W/(m2 K): enclosed air, or an outside that was left out.
OF_SURFACE, ADDED = 0.7, 3.0
#: Spread of the time constant of a sensor in its mounting, s.
LAG = 30.0
#: Median of the give of a support, um/kN, and spread of its logarithm: feet of 350 to 8 000 N/um.
GIVE, OF_GIVE = 0.6, 0.8
#: Suffixes of the names of parameters that are not factors.
ABSOLUTE = (FILM_UNIT, LAG_UNIT, GIVE_UNIT) = (", W/m2K", ", s", ", um/kN")

#: Not parameters here, as they change the modes or the condensed stiffness as a whole.
NEW_CONDENSATION = (
    "geometry",
    "mesh",
    "Poisson's ratio",
    "material of one body alone",
    "supports that are not fixed",
)


def active(machine: ReducedMachine) -> tuple[Parameter, ...]:
    """Return the parameters that a machine has.

    The normal compliance is that of a measured coefficient (`BackBurdekinLaw`); with the surface
    law it follows from roughness and preload.
    """
    absent = set()
    sections = [joint.section for joint in machine.joints]
    if not any(section.normal_law == "back-burdekin" for section in sections):
        absent.add("normal compliance")
    if not sections:
        absent |= {"friction", "preload", "roughness", "tangential ratio"}
    if not any(section.preload_MPa for section in sections) and not bolted(machine):
        absent.add("preload")
    if not any(section.friction_coefficient > 0.0 for section in sections):
        absent |= {"friction", "tangential ratio"}
    if not machine.convection.any():
        absent.add("film")
    own = (parameter for parameter in PARAMETERS if parameter.name not in absent)
    read = (name for name in machine.sensor_names if name not in machine.held.names)
    lags = (Added(lag_name(name), LAG) for name in read)
    supports = () if machine.supports is None else machine.supports.names
    gives = (Give(give_name(name), OF_GIVE) for name in supports)
    films = (film_parameter(film) for film in machine.films)
    return (*own, *_of_drives(machine), *films, *gives, *lags)


def _of_drives(machine: ReducedMachine) -> Iterator[Parameter]:
    if (guide := machine.guide) is None:
        return
    for axis, drive in zip(guide.axes, guide.drives.each, strict=True):
        for what in () if drive is None else drive.scalable:
            yield Parameter(f"{what} {axis.name}", OF_DRIVE[what])


def lag_name(sensor: str) -> str:
    """Return the name of a sensor's lag among the parameters."""
    return f"lag {sensor}{LAG_UNIT}"


def give_name(support: str) -> str:
    """Return the name of a support's give among the parameters."""
    return f"give {support}{GIVE_UNIT}"


def bolted(machine: ReducedMachine) -> bool:
    """Whether a machine has bolts."""
    return machine.acting is not None and machine.acting.springs.flexibility.size > 0


def film_parameter(film: Film) -> Parameter:
    """Return the parameter of a surface's film."""
    if film.nominal:
        return Parameter(f"film {film.surface}", OF_SURFACE)
    return Added(f"film {film.surface}{FILM_UNIT}", ADDED)


def shown(name: str, factor: float, deviation: float) -> tuple[str, str]:
    """Return the texts of a parameter's factor and of its standard deviation."""
    if name.endswith((FILM_UNIT, LAG_UNIT)):
        return f"{factor:.2f}", f"{deviation:.2f}"
    return f"{factor:.3f}", f"{100.0 * deviation:.1f} %"


def with_factors(machine: ReducedMachine, factors: dict[str, float]) -> ReducedMachine:
    """Return the machine with `factors` (name to `Parameter.factor`) on its parameters."""
    by = {parameter.name: 1.0 for parameter in PARAMETERS} | factors
    acting = machine.acting
    if acting is not None:
        influence, springs, strengths = acting.influence, acting.springs, acting.factors.copy()
        strengths[strengths.size - springs.flexibility.size :] *= by["preload"]
        acting = replace(
            acting,
            influence=LoadInfluence(
                influence.gap / by["modulus"], influence.probes / by["modulus"]
            ),
            factors=strengths,
            springs=BoltSprings(
                springs.flexibility / by["modulus"], by["expansion"] * springs.growth
            ),
        )
    convection, ambient = by["film"] * machine.convection, by["film"] * machine.ambient
    for film in machine.films:
        more = by.get(film_parameter(film).name, film.nominal) - film.nominal
        more *= by["film"] if film.nominal else 1.0
        convection, ambient = convection + more * film.convection, ambient + more * film.ambient

    if (supports := machine.supports) is not None:
        gives = [by.get(give_name(name), GIVE) for name in supports.names]
        machine = replace(machine, elastic=supports.elastic(gives), supports=None)
    if (guide := machine.guide) is not None:
        scaled = guide.drives.scaled(
            [{what: by.get(f"{what} {axis.name}", 1.0) for what in OF_DRIVE} for axis in guide.axes]
        )
        machine = replace(machine, guide=replace(guide, drives=scaled))
    lags = [by.get(lag_name(sensor), 0.0) for sensor in machine.sensor_names]
    return replace(
        machine.strained(by["modulus"], by["expansion"]),
        lags=tuple(lags) if any(lags) else (),
        capacity=by["capacity"] * machine.capacity,
        conduction=by["conduction"] * machine.conduction,
        convection=convection,
        ambient=ambient,
        sources=by["heat"] * machine.sources,
        joints=tuple(joint_with_factors(joint, by) for joint in machine.joints),
        acting=acting,
    )


def factors_of(parameters: tuple[Parameter, ...], coordinates: Array) -> dict[str, float]:
    """Return the factors (by name) of coordinates, shape (parameters,); see `Parameter.factor`."""
    return {
        parameter.name: parameter.factor(float(value))
        for parameter, value in zip(parameters, coordinates, strict=True)
    }


def joint_with_factors(joint: Joint, factors: dict[str, float]) -> Joint:
    """Return a joint with those of the `factors` (name to factor, positive) that are a joint's."""
    by = {parameter.name: 1.0 for parameter in PARAMETERS} | factors
    section = joint.section
    power_law = section.back_burdekin
    return replace(
        joint,
        section=section.model_copy(
            update={
                "friction_coefficient": by["friction"] * section.friction_coefficient,
                "preload_MPa": by["preload"] * section.preload_MPa,
                "roughness_um": by["roughness"] * section.roughness_um,
                "tangential_stiffness_ratio": by["tangential ratio"]
                * section.tangential_stiffness_ratio,
                "back_burdekin": None
                if power_law is None
                else power_law.model_copy(
                    update={"coefficient_um": by["normal compliance"] * power_law.coefficient_um}
                ),
            }
        ),
        conductivity=by["conduction"] * joint.conductivity,
    )
