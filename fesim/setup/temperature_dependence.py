"""Temperature-dependent terms of a case: constant part of the operators, and corrections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from skfem import CellBasis

from fesim.case.schema import Case
from fesim.case.thermal_sections import FactorSection
from fesim.solid.heat import (
    HeatOperators,
    capacity_form,
    cell_field,
    conduction_form,
    convection_matrix,
)
from fesim.solid.materials import Material
from fesim.solid.temperature_factor import TemperatureFactor, ThermalGrowth, thermal_growth
from fesim.solid.variable_heat import (
    VariableHeat,
    air_potential,
    conduction_potential,
    convection_potential,
    radiation_coefficient,
    radiation_potential,
)
from meshes.pairing import PairedJoint
from meshes.structure import Structure


def factor_of(section: FactorSection) -> TemperatureFactor:
    """Return the factor of a section."""
    return TemperatureFactor(np.array(section.rise_K), np.array(section.factor))


def reference_materials(case: Case, materials: dict[str, Material]) -> dict[str, Material]:
    """Return the bodies' materials with the middle of thermal properties that have a factor."""
    return _at_middle(case, materials, "conductivity", "heat_capacity")


def reference_moduli(case: Case, materials: dict[str, Material]) -> dict[str, Material]:
    """Return the bodies' materials with the middle of the moduli that have a factor."""
    return _at_middle(case, materials, "youngs_modulus")


def _at_middle(case: Case, materials: dict[str, Material], *names: str) -> dict[str, Material]:
    """The materials with the middle of these properties where they have a factor."""
    found = dict(materials)
    for name in names:
        for body, factor in _factors(case, materials, f"{name}_factor").items():
            own = found[body]
            found[body] = replace(own, **{name: factor.middle * getattr(own, name)})
    return found


def modulus_factors(case: Case, materials: dict[str, Material]) -> dict[str, TemperatureFactor]:
    """Return the factors on the moduli of the bodies that have one."""
    return _factors(case, materials, "youngs_modulus_factor")


def reference_coefficients(case: Case) -> dict[str, float]:
    """Return the constant coefficients by surface, W/(m2 K): convection and linear radiation."""
    coefficients = dict(case.convection_W_m2K)
    for name, section in case.convection_factor.items():
        coefficients[name] *= factor_of(section).middle
    for name, radiation in case.radiation.items():
        coefficient = radiation_coefficient(radiation.emissivity, radiation.ambient_degC)
        coefficients[name] = coefficients.get(name, 0.0) + coefficient
    for cavity in case.cavities.values():
        coefficients |= dict.fromkeys(cavity.surfaces, cavity.film_W_m2K)
    return coefficients


def variable_heat(
    case: Case,
    structure: Structure,
    basis: CellBasis,
    materials: dict[str, Material],
    joints: Sequence[PairedJoint],
    heat: HeatOperators,
) -> VariableHeat | None:
    """Return the terms that the constant operators `heat` do not include, or None."""
    terms = []
    for body, factor in _factors(case, materials, "conductivity_factor").items():
        own = {name: m.conductivity if name == body else 0.0 for name, m in materials.items()}
        matrix = conduction_form.assemble(basis, value=cell_field(structure, own, basis))
        terms.append((matrix, conduction_potential(factor)))
    for name, section in case.convection_factor.items():
        area = convection_matrix(structure, basis, name, joints)
        terms.append((area, convection_potential(case.convection_W_m2K[name], factor_of(section))))
    for name, radiation in case.radiation.items():
        area = convection_matrix(structure, basis, name, joints)
        given = radiation.emissivity, radiation.ambient_degC
        terms.append((area, radiation_potential(*given)))
    for cavity in case.cavities.values():
        parts = [convection_matrix(structure, basis, name, joints) for name in cavity.surfaces]
        area = sum(parts[1:], parts[0])
        walls = np.asarray(area.sum(axis=0)).ravel()
        terms.append((area, air_potential(cavity.film_W_m2K, walls)))
    capacities = []
    for body, factor in _factors(case, materials, "heat_capacity_factor").items():
        stored = {
            name: m.density * m.heat_capacity if name == body else 0.0
            for name, m in materials.items()
        }
        whole = capacity_form.assemble(basis, value=cell_field(structure, stored, basis))
        capacities.append((np.asarray(whole.sum(axis=1)).ravel(), factor))
    if not terms and not capacities:
        return None
    return VariableHeat(tuple(terms), heat.layout.ambient, heat.held, tuple(capacities))


def growth(case: Case, structure: Structure, basis: CellBasis) -> ThermalGrowth | None:
    """Return the temperature-dependent expansion of the bodies; None if it is constant."""
    unknowns = {
        name: np.unique(basis.element_dofs[:, cells]) for name, cells in structure.bodies.items()
    }
    sections = {body: case.materials[name].expansion_factor for body, name in case.bodies.items()}
    given = {body: factor_of(section) for body, section in sections.items() if section is not None}
    return thermal_growth(unknowns, given)


def convecting_surfaces(case: Case) -> list[str]:
    """Return the surfaces that convect or radiate, each once."""
    return list(reference_coefficients(case))


def _factors(case: Case, materials: dict[str, Material], key: str) -> dict[str, TemperatureFactor]:
    sections = {body: getattr(case.materials[case.bodies[body]], key) for body in materials}
    return {body: factor_of(section) for body, section in sections.items() if section is not None}
