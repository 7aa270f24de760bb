"""The joint laws that a case asks for, in SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fesim.case.schema import Case, JointSection
from fesim.joint.law import (
    BackBurdekinLaw,
    Friction,
    JointLaw,
    SurfaceNormalLaw,
    exact_conductance,
    harmonic_conductivity,
    power_law_conductance,
)
from fesim.solid.heat import by_cell
from fesim.solid.materials import Material
from meshes.pairing import PairedJoint
from meshes.structure import Structure

#: C and n of Eq. 11 by law.
CONDUCTANCE_CONSTANTS = {"cmy-1969": (1.45, 0.985), "yovanovich-1982": (1.25, 0.95)}


def joint_laws(
    case: Case,
    structure: Structure,
    materials: dict[str, Material],
    joints: Sequence[PairedJoint],
) -> list[tuple[JointLaw, int]]:
    """Return the law of each joint and how many contact elements it has."""
    return [
        (joint_law(case.joints[joint.name], structure, materials, joint), len(joint.area))
        for joint in joints
    ]


def joint_law(
    section: JointSection,
    structure: Structure,
    materials: dict[str, Material],
    joint: PairedJoint,
) -> JointLaw:
    """Law of one joint; its harmonic conductivity comes from the bodies on the two sides."""
    return law_of(section, joint_conductivity(structure, materials, joint))


def joint_conductivity(
    structure: Structure, materials: dict[str, Material], joint: PairedJoint
) -> NDArray[np.float64]:
    """k_h of Eq. 11 at the contact elements of a joint, W/(m K), shape (m,)."""
    return harmonic_conductivity(
        *(
            element_means(joint, conducted[cells])
            for conducted in [
                by_cell(structure, {name: m.conductivity for name, m in materials.items()})
            ]
            for cells in (joint.cells_a, joint.cells_b)
        )
    )


def law_of(section: JointSection, conductivity: NDArray[np.float64]) -> JointLaw:
    """Law of a joint whose contact elements have the harmonic conductivity (m,), W/(m K)."""
    hardness, roughness = 1e9 * section.hardness_GPa, 1e-6 * section.roughness_um
    preload = 1e6 * section.preload_MPa
    slope = section.asperity_slope
    normal: SurfaceNormalLaw | BackBurdekinLaw
    given = section.back_burdekin
    if section.normal_law == "surface" or given is None:
        normal = SurfaceNormalLaw(hardness, roughness, preload)
    else:
        coefficient = 1e-6 * given.coefficient_um / 1e6**given.exponent
        normal = BackBurdekinLaw(coefficient, given.exponent, preload)
    stiffness = -float(normal.slope(np.zeros(1))[0])
    chosen = section.conductance
    if chosen.law == "cmy-exact":
        conductance = exact_conductance(slope, roughness, conductivity, hardness)
    else:
        constant, exponent = CONDUCTANCE_CONSTANTS.get(
            chosen.law, (chosen.constant or 0.0, chosen.exponent or 0.0)
        )
        conductance = power_law_conductance(
            constant, exponent, slope, roughness, conductivity, hardness
        )
    friction = Friction(
        section.friction_coefficient, section.tangential_stiffness_ratio * stiffness
    )
    return JointLaw(normal, friction, conductance)


def element_means(joint: PairedJoint, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means (m,) over each contact element of values (nq,) at its quadrature points."""
    return np.bincount(joint.element, joint.weights * values) / joint.area
