"""Errors of a case's mesh in its displacement: rows on temperatures, tractions and loads.

With the dual solutions of the displacement (`fesim.solid.recovery`) they cost six right-hand sides
more than the condensation, and two products in a march.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, diags_array

from fesim.march.contact import ContactProblem
from fesim.setup.discretised import Discretised, relative_rows
from fesim.solid.condensation import DisplacementField, ElasticCondensation, eliminate_held
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.heat import by_cell, capacity_form
from fesim.solid.linear_solver import checked_solve, factorise
from fesim.solid.recovery import heat_error_rows, stress_error_rows
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class StressErrors:
    """Error of the displacement by the mesh of the displacements, along three axes.

    Attributes
    ----------
    temperature : ndarray, shape (3, n_heat)
        m/K.
    remainder : ndarray, shape (3, 3 m)
        m/Pa.
    forces : ndarray, shape (3, l + b)
        Per factor of each load and N of each bolt, m.
    """

    temperature: Array
    remainder: Array
    forces: Array


@dataclass(frozen=True)
class MeshErrors:
    """Both errors of the mesh.

    Attributes
    ----------
    heat : ndarray, shape (3, n_heat)
        Of the displacement by the mesh of the temperatures, m/K.
    stored : ndarray, shape (3, n_heat)
        By heat capacities that are lumped at its nodes, per change of temperature in time, m s/K.
    stress : StressErrors
        By that of the displacements.
    """

    heat: Array
    stored: Array
    stress: StressErrors


def stress_errors(whole: Discretised, field: DisplacementField, forces: Array) -> StressErrors:
    """Return the rows of a case by the displacements (n,) under its probes' rows and `forces`."""
    structure, axes = whole.parts.structure, len(DIRECTIONS)
    duals = field.respond(relative_rows(whole)[:axes].toarray().T, "displacement's dual")
    moved, heated = stress_error_rows(structure, whole.spaces, whole.materials, duals)
    answers = field.respond(moved, "displacement's dual")
    return StressErrors(
        (heated + field.structure.thermal_load.T @ answers).T,
        (field.gap @ answers).T * field.area,
        answers.T @ forces,
    )


def heat_errors(
    whole: Discretised, condensed: ElasticCondensation, contact: ContactProblem, conducts: Array
) -> tuple[Array, Array]:
    """Return both rows of heat, with joints that stick and conduct as given, W/(m2 K).

    The dual temperatures are those after one step as long as the march, against the time.
    """
    problem, axes = contact.gap_problem, len(DIRECTIONS)
    tied = condensed.area * (condensed.reference - problem.springs)
    closing = (condensed.probe_compliance[:axes] * tied) @ problem.exchange
    rows = condensed.probe_thermal[:axes] + closing @ condensed.thermal_gap
    jump = whole.operators.jump
    through = csr_array(jump.T @ diags_array(whole.operators.area * conducts) @ jump)
    heat = replace(whole.heat, conduction=csr_array(whole.heat.conduction + through))
    system, _ = eliminate_held(heat, 60.0 * whole.case.march.duration_min)
    rows[:, heat.held] = 0.0
    factor = factorise(system, "heat equation's dual", whole.case.march.solver)
    duals = checked_solve(factor, rows.T, "heat equation's dual")
    structure, basis = whole.parts.structure, whole.spaces.heat
    stored = {name: m.density * m.heat_capacity for name, m in whole.materials.items()}
    per_cell = np.tile(by_cell(structure, stored)[:, None], (1, basis.X.shape[-1]))
    spread = capacity_form.assemble(basis, value=per_cell)
    return (
        heat_error_rows(structure, whole.spaces, whole.materials, duals).T,
        (whole.heat.capacity @ duals - spread @ duals).T,
    )
