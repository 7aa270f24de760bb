"""The small dense solve of a step against the solvers that others would use for it.

A joint without friction whose pressure rises in proportion to the approach (Back and Burdekin's law
with an exponent of 1) is a linear complementarity problem, and so a quadratic program:

    min p^T H p / 2 + q^T p  with  p >= 0,   H = A (K + c I),   q = A (G - K p0 - c p0)

with the pressures p of the contact elements of the reference machine, K their compliance (gap per
pressure), their areas A, the gaps G without pressure, the law's c p = c p0 - gap, the preload p0.
Every solver has the same matrices and goes from one step of a march to the next: what it can keep
between them (a factor, its last answer) it keeps. All answers agree with that of the march to
`SAME` of the preload, where a solver can be as accurate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, eye_array

from benchmarks.performance.cases import reference_case, with_contacts
from benchmarks.performance.marching import driven
from benchmarks.performance.timing import Row, Skipped
from fesim.joint.blocks import one_block
from fesim.joint.compiled_gap import newton_work, solve_in_place, trial_at
from fesim.joint.frozen_tangent import frozen_tangents
from fesim.joint.law import BackBurdekinLaw, Friction, JointLaw
from fesim.joint.modified_newton import settle_near
from fesim.march.compiled_step import gap_kernel
from fesim.march.kernel import joint_kernel
from fesim.march.machine import CondensedMachine
from fesim.march.settling import initial_state
from fesim.march.stepping import march_along, staggered
from fesim.march.track import joined
from fesim.setup.machine import set_up
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Steps that are solved one after another, and how different answers may be, of the preload.
STEPS, SAME = 40, 1e-6
GRIDS = ((9, 3), (24, 8))
#: OSQP, proxsuite and Pinocchio stop here; in pressures over the preload.
ACCURACY = 1e-9


@dataclass(frozen=True, eq=False)
class Program:
    """The quadratic programs of a march, in pressures over the preload."""

    #: Whose joint it is.
    machine: CondensedMachine
    #: Shape (m, m): H, scaled.
    matrix: Array
    #: Shape (n, m): q of each step, scaled.
    vectors: Array
    #: Shape (n, 3 m): J0^-1 g_T of each step, m.
    free_gaps: Array
    #: Shape (n, m): pressures of the march.
    expected: Array


def rows() -> Iterator[Row | Skipped]:
    """Yield a row for each size and each solver."""
    for along, across in GRIDS:
        program = made(along, across)
        count = len(program.matrix)
        ours = timed(program, kept_inverse(program))
        for name, (package, start) in {
            "newton": ("numpy", newton),
            "daqp": ("daqp", daqp),
            "osqp": ("osqp", osqp),
            "proxsuite": ("proxsuite", proxsuite),
            "pinocchio": ("pin", pinocchio),
        }.items():
            label = f"dense-{name}-{count}"
            if name != "newton" and find_spec(name) is None:
                yield Skipped(label, f"{name} is not installed; pip install {package}")
                continue
            other = timed(program, start(program))
            yield Row(
                label,
                1e6 * ours[0],
                1e6 * other[0],
                other[0] / ours[0],
                "µs",
                f"{count} contact elements without friction, linear law, {STEPS} steps of a march "
                f"one after another, median; the march's stored factors against {name}; solutions "
                f"differ from the march by {ours[1]:.0e} and {other[1]:.0e} of the preload",
            )


def made(along: int, across: int) -> Program:
    """Return the programs of the first steps of the reference machine with a linear joint."""
    case = with_contacts(reference_case(), along, across)
    setup = set_up(case)
    preload = setup.machine.contact.preload[0]
    stiffness = setup.machine.contact.gap_problem.springs[0]
    # The stiffness of the machine's own law at its preload: c p = p / stiffness.
    normal = BackBurdekinLaw(1.0 / stiffness, 1.0, preload)
    law = setup.machine.contact.laws[0][0]
    linear = JointLaw(normal, Friction(0.0, law.friction.stiffness), law.conductance)
    contact = setup.machine.contact
    contact = replace(contact, laws=[(linear, contact.count)], constraints=None)
    machine = replace(setup.machine, contact=contact)
    inputs = driven(case)[1 : STEPS + 1]
    start = initial_state(machine, inputs[0])
    track = joined(list(march_along(machine, inputs, staggered, start)))
    problem, elastic, count = (
        machine.contact.gap_problem,
        machine.contact.elastic,
        machine.contact.count,
    )
    free_gaps = track.temperature @ problem.at_rest(elastic.thermal_gap).T
    # Without the joint's own springs: g = G + K z.
    bare = np.linalg.inv(np.eye(3 * count) - problem.compliance * problem.springs)
    compliance = (bare @ problem.compliance)[:count, :count]
    area = elastic.area[:count]
    scale = preload / stiffness * area.mean()
    matrix = area[:, None] * (compliance + np.eye(count) / stiffness) * preload / scale
    gaps = free_gaps @ bare.T[:, :count]
    vectors = area * (gaps - compliance.sum(axis=1) * preload - preload / stiffness) / scale
    symmetric = 0.5 * (matrix + matrix.T)
    return Program(machine, symmetric, vectors, free_gaps, track.pressure / preload)


Solve = Callable[[int], Array]


def timed(program: Program, solve: Solve) -> tuple[float, float]:
    """Median time of a step, s, and the largest error of a pressure, of the preload."""
    times, off = [], 0.0
    for step in range(STEPS):
        begun = perf_counter()
        found = solve(step)
        times.append(perf_counter() - begun)
        off = max(off, float(np.abs(found - program.expected[step]).max()))
    if not off <= SAME:
        raise ConvergenceError(f"dense-solvers: an answer is off by {off:.1e} of the preload")
    return median(times[2:]), off


def kept_inverse(program: Program) -> Solve:
    """The march's own way: a modified Newton method with a kept inverse."""
    return _gap_equations(program, kept=True)


def newton(program: Program) -> Solve:
    """Newton's method with a fresh factorisation in each iteration, as in earlier versions."""
    return _gap_equations(program, kept=False)


def _gap_equations(program: Program, kept: bool) -> Solve:
    machine, count = program.machine, program.machine.contact.count
    joint = joint_kernel(machine.contact, np.asarray(machine.thermal.jump), np.zeros(count))
    if joint is None:
        raise ConvergenceError("dense-solvers: the joint has no kernel")
    blocks = one_block(joint.springs, joint.compliance, joint.columns)
    anchors, slip, work = frozen_tangents(blocks), np.zeros((2, count)), newton_work(count)
    rest = np.zeros(3 * count)  # `free_gaps` are those at rest
    gaps = np.zeros((2, 3, count))  # of the last two steps

    def solve(step: int) -> Array:
        gap, free = 2.0 * gaps[1] - gaps[0], program.free_gaps[step]
        kernel, trial = gap_kernel(joint), trial_at(gap)
        if kept:
            settle_near(kernel, anchors, free, rest, slip, trial)
        else:
            solve_in_place(kernel, free, slip, trial, work)
        slip[:], gaps[0], gaps[1] = trial.moved, gaps[1], trial.gap
        return np.asarray(1.0 + trial.value[0] / joint.preload)

    return solve


def daqp(program: Program) -> Solve:
    """Dual active set, dense; from its last active set (Arnström, Bemporad & Axehill 2022)."""
    import daqp as library

    count = len(program.matrix)
    upper, lower = np.full(count, 1e30), np.zeros(count)
    sense = np.zeros(count, dtype=np.int32)
    model = library.Model()
    nothing = np.zeros((0, count))
    model.setup(program.matrix, program.vectors[0], nothing, upper, lower, sense)

    def solve(step: int) -> Array:
        model.update(f=program.vectors[step])
        return np.asarray(model.solve()[0])

    return solve


def osqp(program: Program) -> Solve:
    """ADMM; factor kept, warm start (Stellato et al. 2020)."""
    import osqp as library

    count = len(program.matrix)
    solver: Any = library.OSQP()
    solver.setup(
        csc_matrix(np.triu(program.matrix)),
        program.vectors[0],
        csc_matrix(eye_array(count)),
        np.zeros(count),
        np.full(count, np.inf),
        verbose=False,
        eps_abs=ACCURACY,
        eps_rel=ACCURACY,
        max_iter=100_000,
    )

    def solve(step: int) -> Array:
        solver.update(q=program.vectors[step])
        return np.asarray(solver.solve().x)

    return solve


def proxsuite(program: Program) -> Solve:
    """Proximal augmented Lagrangian, dense; warm start (Bambade et al. 2022)."""
    from proxsuite import proxqp

    count = len(program.matrix)
    solver = proxqp.dense.QP(count, 0, 0, True)
    solver.settings.eps_abs, solver.settings.eps_rel = ACCURACY, 0.0
    bounds = np.zeros(count), np.full(count, 1e20)
    solver.init(program.matrix, program.vectors[0], None, None, None, None, None, *bounds)

    def solve(step: int) -> Array:
        solver.update(g=program.vectors[step])
        solver.solve()
        # Only now: it would start from a result that it does not have yet.
        solver.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        return np.array(solver.results.x)

    return solve


def pinocchio(program: Program) -> Solve:
    """Proximal ADMM for contact with friction, here without any; warm start (pin 4 or later)."""
    import pinocchio as library

    count = len(program.matrix)
    normal = np.arange(2, 3 * count, 3)
    matrix, vector = np.eye(3 * count), np.zeros(3 * count)
    matrix[np.ix_(normal, normal)] = program.matrix
    operator = library.DelassusOperatorDense(matrix)
    # Only what kind of contact it is counts: one between the ground and some body.
    model = library.Model()
    body = model.addJoint(0, library.JointModelFreeFlyer(), library.SE3.Identity(), "body")
    contacts, data = library.StdVec_ConstraintModel(), library.StdVec_ConstraintData()
    for _ in range(count):
        place = library.SE3.Identity()
        contact = library.PointContactConstraintModel(model, 0, place, body, place)
        contact.setFriction(0.0)
        contacts.append(library.ConstraintModel(contact))
        data.append(contacts[len(contacts) - 1].createData())
    settings, result = library.ADMMSolverSettings(), library.ADMMSolverResult()
    settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = ACCURACY
    settings.relative_feasibility_tol = settings.relative_complementarity_tol = 0.0
    settings.max_iterations = 100_000
    settings.warmstart_rho_with_previous_result = True
    solver = library.ADMMConstraintSolver(3 * count)

    def solve(step: int) -> Array:
        vector[normal] = program.vectors[step]
        solver.solve(operator, vector, contacts, data, settings, result)
        found = np.array(result.retrieveConstraintImpulses())
        result.setConstraintImpulseGuess(found)
        return found[normal]

    return solve
