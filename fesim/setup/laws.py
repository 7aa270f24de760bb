"""Joint laws of a case in SI."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fesim.case.joint_sections import ConductanceSection, GapSection, JointSection
from fesim.case.schema import Case
from fesim.joint.conductance import (
    ConductanceTable,
    FixedConductance,
    GapConductance,
    exchange_factor,
)
from fesim.joint.law import (
    BackBurdekinLaw,
    Friction,
    JointLaw,
    SurfaceNormalLaw,
    exact_conductance,
    harmonic_conductivity,
    power_law_conductance,
)
from fesim.joint.opening import OpenLaw, touching_distance, touching_opening
from fesim.solid.materials import Material, by_cell
from meshes.pairing import PairedJoint
from meshes.structure import Structure
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.columns import read_columns
from thermojoint.artefacts.units import MEGA, MICRO

#: C and n of Eq. 11 by law.
CONDUCTANCE_CONSTANTS = {"cmy-1969": (1.45, 0.985), "yovanovich-1982": (1.25, 0.95)}


def joint_laws(
    case: Case,
    structure: Structure,
    materials: dict[str, Material],
    joints: Sequence[PairedJoint],
) -> list[tuple[JointLaw, int]]:
    """Return the law of each joint and its number of contact elements."""
    return [
        (
            joint_law(as_walled(case, case.joints[joint.name]), structure, materials, joint),
            len(joint.area),
        )
        for joint in joints
    ]


def as_walled(case: Case, section: JointSection) -> JointSection:
    """Return a joint's section, without heat flow if its wall has no temperature."""
    adiabatic = set(case.walls) - set(case.held_temperatures)
    if adiabatic.isdisjoint({section.side_a, section.side_b}):
        return section
    return section.model_copy(update={"conductance": ConductanceSection(law="none"), "gap": None})


def joint_law(
    section: JointSection,
    structure: Structure,
    materials: dict[str, Material],
    joint: PairedJoint,
) -> JointLaw:
    """Law of one joint; its harmonic conductivity comes from the bodies on the two sides."""
    conductivity = joint_conductivity(structure, materials, joint)
    return law_of(section, conductivity, initial_opening(section, joint), table_of(section))


def table_of(section: JointSection) -> ConductanceTable | None:
    """Return the conductance table of a joint; None if it has another law."""
    path = section.conductance.file
    return None if path is None else read_conductance_table(path)


def joint_conductivity(
    structure: Structure, materials: dict[str, Material], joint: PairedJoint
) -> NDArray[np.float64]:
    """k_h of Eq. 11 at the contact elements of a joint, W/(m K), shape (m,)."""
    conducted = by_cell(structure, {name: m.conductivity for name, m in materials.items()})
    return harmonic_conductivity(
        element_means(joint, conducted[joint.cells_a]),
        element_means(joint, conducted[joint.cells_b]),
    )


def initial_opening(section: JointSection, joint: PairedJoint) -> NDArray[np.float64] | None:
    """Opening of the contact elements at the start, m, shape (m,); None for a preloaded joint.

    Raises
    ------
    InputError
        The sides of a joint overlap in the mesh.
    """
    given = section.initial_opening_um
    if given is None:
        return None
    if given != "mesh":
        return np.full(len(joint.area), MICRO * given)
    apart = (joint.points_b - joint.points_a).T
    separation = element_means(joint, (apart * joint.normal[joint.element]).sum(axis=1))
    # Coordinates in a mesh file are accurate to about this fraction of its size.
    if separation.min() < -1e-6 * np.sqrt(joint.area.sum()):
        raise InputError(
            f"joints.{joint.name}: its sides overlap by {-MEGA * separation.min():.4g} um in the "
            "mesh; correct the mesh, or give initial_opening_um"
        )
    return np.maximum(separation, 0.0)


def law_of(
    section: JointSection,
    conductivity: NDArray[np.float64],
    opening: NDArray[np.float64] | None = None,
    table: ConductanceTable | None = None,
) -> JointLaw:
    """Law of a joint from its section, `joint_conductivity`, `initial_opening` and `table_of`."""
    closed = _closed_law(section)
    stiffness = -float(closed.slope(np.zeros(1))[0])
    friction = Friction(
        section.friction_coefficient, section.tangential_stiffness_ratio * stiffness
    )
    return JointLaw(
        closed if opening is None else OpenLaw(closed, opening),
        friction,
        table or _conductance(section, conductivity),
        reference=None if opening is None else closed,
        gap=None if section.gap is None else _gap(section, section.gap, closed, opening),
    )


def _closed_law(section: JointSection) -> SurfaceNormalLaw | BackBurdekinLaw:
    """Return the normal law at its preload, or at its reference pressure if it has none."""
    pressure = MEGA * (section.preload_MPa or section.reference_pressure_MPa or 0.0)
    given = section.back_burdekin
    if section.normal_law == "surface" or given is None:
        return SurfaceNormalLaw(1e9 * section.hardness_GPa, MICRO * section.roughness_um, pressure)
    coefficient = MICRO * given.coefficient_um / MEGA**given.exponent
    return BackBurdekinLaw(coefficient, given.exponent, pressure)


def _conductance(
    section: JointSection, conductivity: NDArray[np.float64]
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    chosen, slope = section.conductance, section.asperity_slope
    roughness, hardness = MICRO * section.roughness_um, 1e9 * section.hardness_GPa
    if chosen.law in ("fixed", "none"):
        return FixedConductance(chosen.value_W_m2K or 0.0)
    if chosen.law == "cmy-exact":
        return exact_conductance(slope, roughness, conductivity, hardness)
    constant, exponent = CONDUCTANCE_CONSTANTS.get(
        chosen.law, (chosen.constant or 0.0, chosen.exponent or 0.0)
    )
    return power_law_conductance(constant, exponent, slope, roughness, conductivity, hardness)


def read_conductance_table(path: Path) -> ConductanceTable:
    """Read a table of conductances: a CSV with a row for each pressure at each temperature.

    Raises
    ------
    UnreadableError
        The file is missing or cannot be opened.
    InputError
        A column is missing, or the rows are not such a table.
    """
    columns = read_columns(
        path, ("pressure_MPa", "conductance_W_m2K"), "conductance table", ("rise_K",)
    )
    pressure, value = MEGA * columns["pressure_MPa"], columns["conductance_W_m2K"]
    rise = columns.get("rise_K", np.zeros(len(pressure)))
    # Blocks of equal temperature, in the order of the file.
    starts = np.flatnonzero(np.append(len(rise) > 0, np.diff(rise) != 0.0))
    blocks = np.split(np.arange(len(rise)), starts[1:])
    if any(not np.array_equal(pressure[block], pressure[blocks[0]]) for block in blocks):
        raise InputError(
            f"{path}: every rise_K needs the same pressures; give a row for each of them"
        )
    try:
        return ConductanceTable(
            pressure[blocks[0]], rise[starts], np.array([value[block] for block in blocks])
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _gap(
    section: JointSection,
    given: GapSection,
    closed: SurfaceNormalLaw | BackBurdekinLaw,
    opening: NDArray[np.float64] | None,
) -> GapConductance:
    exchange, mean = 0.0, given.mean_temperature_degC
    if given.emissivity_a is not None and given.emissivity_b is not None:
        exchange = exchange_factor(given.emissivity_a, given.emissivity_b)
    return GapConductance(
        conductivity=given.gas_conductivity_W_mK,
        jump=MICRO * given.temperature_jump_um,
        radiation=0.0 if mean is None else 4.0 * exchange * (mean + 273.15) ** 3,
        touching=touching_distance(MICRO * section.roughness_um),
        opening=-touching_opening(closed) if opening is None else opening,
        follows=isinstance(closed, SurfaceNormalLaw),
        exchange=exchange if mean is None else 0.0,
        ambient=273.15 + (given.ambient_degC or 0.0),
    )


def element_means(joint: PairedJoint, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means (m,) over each contact element of values (nq,) at its quadrature points."""
    return np.bincount(joint.element, joint.weights * values) / joint.area
