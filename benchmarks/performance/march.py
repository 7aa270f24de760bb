"""The condensed march against one that assembles the joint and factorises in every step."""

from __future__ import annotations

import time
from collections.abc import Iterator
from importlib.util import find_spec

import numpy as np
from scipy.sparse import block_array, csr_array, csr_matrix, diags_array

from benchmarks.performance.cases import reference_case
from benchmarks.performance.timing import Row, Skipped, medians, seconds
from fesim.case.schema import Case
from fesim.joint.law import tangent_matrix
from fesim.march.contact import ContactProblem
from fesim.setup.laws import joint_law
from fesim.setup.loads import heat_sources, thermal_inputs
from fesim.setup.structure import body_materials, build_structure
from fesim.simulate import simulate
from fesim.solid.elasticity import elastic_operators
from fesim.solid.heat import ThermalLoads, heat_operators
from fesim.solid.joint_operators import joint_operators
from fesim.solid.linear_solver import factorise
from fesim.solid.spaces import make_spaces
from meshes.pairing import pair_joint
from thermojoint.artefacts.errors import ConvergenceError

#: Steps of a full run, and how many the slow side is measured on.
STEPS, MEASURED = 1050, 6
REPEATS = 3


class Refactoring:
    """The same machine without condensation: every step assembles, factorises and solves it whole.

    Newton's method in the displacements with the consistent tangent, which is not symmetric once
    the joint slides; PARDISO's solver for such matrices. Heat: symmetric, the product's own seam.
    """

    def __init__(self, case: Case) -> None:
        structure = build_structure(case)
        materials = body_materials(case, structure)
        spaces = make_spaces(structure.mesh)
        joints = [
            pair_joint(structure, name, section.along, section.across)
            for name, section in case.joints.items()
        ]
        self.operators = joint_operators(joints, spaces)
        self.heat = heat_operators(
            structure,
            spaces.heat,
            materials,
            ThermalLoads(case.convection_W_m2K, heat_sources(case, structure)),
        )
        self.elastic = elastic_operators(
            structure, spaces, materials, case.supports.fixed, dict(case.supports.symmetry)
        )
        self.laws = [
            (joint_law(case.joints[joint.name], structure, materials, joint), len(joint.area))
            for joint in joints
        ]
        self.step, self.inputs = case.march.step_s, thermal_inputs(case)

    def run(self, count: int) -> np.ndarray:
        """March; return the pressures at the end, Pa."""
        from pypardiso import PyPardisoSolver

        heat, jump, free = self.heat, self.operators.jump, self.elastic.free
        gap = csr_array(self.operators.gap[:, free])
        stiffness = csr_array(self.elastic.stiffness[free][:, free])
        area, area3 = self.operators.area, np.tile(self.operators.area, 3)
        # Only its laws are used: nothing of the condensation.
        law = ContactProblem(None, self.laws)  # type: ignore[arg-type]
        contacts = area.size
        rate = csr_array(heat.capacity / self.step)
        temperature, pressure = np.zeros(heat.inputs.shape[0]), law.preload
        u, slip = np.zeros(free.size), np.zeros((2, contacts))
        solver = PyPardisoSolver(mtype=11)
        for n in range(1, count + 1):
            joint = jump.T @ diags_array(law.conductance(pressure) * area) @ jump
            system = factorise(rate + heat.conduction + heat.convection + joint, "heat")
            temperature = system.solve(
                rate @ temperature + heat.inputs @ self.inputs(n * self.step)
            )
            load = (self.elastic.thermal_load @ temperature)[free]
            for _ in range(40):
                traction = law.traction((gap @ u).reshape(3, contacts), slip)
                forces = stiffness @ u - load - gap.T @ (area3 * traction.value.ravel())
                blocks = [
                    [diags_array(area * tangent_matrix(traction.tangent)[i, j]) for j in range(3)]
                    for i in range(3)
                ]
                tangent = csr_matrix(stiffness - gap.T @ block_array(blocks) @ gap)
                tangent.sort_indices()
                move = solver.solve(tangent, -forces)
                u = u + move
                if np.abs(gap @ move).max() < 1e-12:
                    break
            else:
                raise ConvergenceError("the refactoring march does not converge")
            slip = law.traction((gap @ u).reshape(3, contacts), slip).slip
            pressure = law.preload + traction.value[0]
        solver.free_memory(everything=True)
        return pressure


def rows() -> Iterator[Row | Skipped]:
    """Yield march-vs-refactor."""
    if find_spec("pypardiso") is None:
        reason = "pypardiso is not installed; pip install -e '.[pardiso]'"
        yield Skipped("march-vs-refactor", reason)
        return
    case = reference_case()
    found: dict[str, np.ndarray] = {}

    times = []
    for _ in range(REPEATS):
        mine = seconds(lambda: found.update(ours=simulate(case).response["pressure"].to_numpy()))
        begun = time.perf_counter()
        plain = Refactoring(case)
        between = time.perf_counter()
        found["other"] = plain.run(MEASURED)
        marching = time.perf_counter() - between
        times.append((mine, between - begun + marching * STEPS / MEASURED))
    difference = np.abs(found["ours"][MEASURED] - found["other"]).max()
    yield Row(
        "march-vs-refactor",
        *medians(times),
        "s",
        f"{STEPS} coupled steps of the equal-heights machine, {case.march.thermal} thermal model, "
        "set-up included, against assembling and factorising in every step with the same library, "
        "all nodes and a solver for unsymmetric matrices (the tangent of a joint that slides), "
        f"measured on {MEASURED} steps and scaled; pressures differ by {difference:.1e} Pa at the "
        "last of them",
    )
