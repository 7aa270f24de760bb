"""Staggered time stepping without condensation: full matrices, factorised in every step.

This march shares only operators and joint laws with the simulator: the unknowns are all
temperatures and displacements, and Newton's method is applied to the forces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import block_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from fesim.joint.law import tangent_matrix
from fesim.march.machine import CondensedMachine
from fesim.march.stepping import Inputs
from fesim.solid.elasticity import ElasticOperators
from fesim.solid.heat import HeatOperators
from fesim.solid.joint_operators import JointOperators
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

MAX_ITERATIONS, SHORTEST_STEP = 60, 2.0**-10
#: Upper limit of the last step of Newton's method, m: micrometres are compared, and a solve has a
#: rounding error of 1e-17 of them.
SETTLED = 1e-15


@dataclass(frozen=True)
class PlainStep:
    """One step of `plain_march`."""

    #: Values of all unknowns, K and m.
    temperature: Array
    displacement: Array
    #: Shapes (m,) and (2, m): values of the contact elements, Pa and m.
    pressure: Array
    slip: Array


def plain_march(
    heat: HeatOperators,
    elastic: ElasticOperators,
    joints: JointOperators,
    machine: CondensedMachine,
    inputs: Inputs,
) -> Iterator[PlainStep]:
    """Yield the steps of the staggered scheme with full matrices, factorised each time.

    Only the joint laws and the time step of `machine` are used. No surface may have a held
    temperature.
    """
    free, step = elastic.free, machine.thermal.step
    jump, gap = joints.jump, csr_array(joints.gap[:, free])
    stiffness = elastic.stiffness[free][:, free]
    area, area3, count = joints.area, np.tile(joints.area, 3), machine.contact.count
    rate = heat.capacity / step
    temperature, pressure = np.zeros(heat.inputs.shape[0]), machine.contact.preload
    u, slip = np.zeros(free.size), np.zeros((2, count))
    index = 0
    while True:
        index += 1
        joint = jump.T @ diags_array(machine.contact.conductance(pressure) * area) @ jump
        temperature = _solve(
            rate + heat.conduction + heat.convection + joint,
            rate @ temperature + heat.inputs @ inputs(index * step),
        )
        load = (elastic.thermal_load @ temperature)[free]
        before = slip
        law = machine.contact.traction((gap @ u).reshape(3, count), before)
        forces = stiffness @ u - load - gap.T @ (area3 * law.value.ravel())
        for _ in range(MAX_ITERATIONS):
            tangent = tangent_matrix(law.tangent)
            blocks = [[diags_array(area * tangent[i, j]) for j in range(3)] for i in range(3)]
            move = -_solve(stiffness - gap.T @ block_array(blocks) @ gap, forces)
            length, norm = 1.0, np.linalg.norm(forces)
            while True:
                trial = u + length * move
                law = machine.contact.traction((gap @ trial).reshape(3, count), before)
                forces = stiffness @ trial - load - gap.T @ (area3 * law.value.ravel())
                if np.linalg.norm(forces) < norm or length < SHORTEST_STEP:
                    break
                length /= 2.0
            u = trial
            if np.abs(move).max() < SETTLED:
                break
        else:
            raise ConvergenceError(
                f"plain march: step to t = {index * step:g} s: Newton's last step is still "
                f"{np.abs(move).max():.1e} m"
            )
        slip, pressure = law.slip, machine.contact.preload + law.value[0]
        displacement = np.zeros(elastic.stiffness.shape[0])
        displacement[free] = u
        yield PlainStep(temperature, displacement, pressure, slip)


def _solve(matrix: csr_array, load: Array) -> Array:
    """Solve a system whose matrix has a symmetric pattern."""
    factor = splu(csc_array(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return np.asarray(factor.solve(load), dtype=np.float64)
