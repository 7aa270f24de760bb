"""Runs one problem on both sides and compares temperatures, displacements and pressures."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from skfem import CellBasis
from threadpoolctl import threadpool_limits

from benchmarks.against_calculix.deck import Choices, write_deck
from benchmarks.against_calculix.laws import exponential, with_law
from benchmarks.against_calculix.problem import Problem, problem_of
from benchmarks.against_calculix.run import Run, run_deck
from fesim.axes.setup import axis_inputs, set_up_axes
from fesim.case.schema import Case, step_count
from fesim.joint.law import BackBurdekinLaw, JointLaw
from fesim.march.machine import CondensedMachine, Step
from fesim.march.settling import initial_state
from fesim.march.stepping import march
from fesim.setup.loads import heat_sources, held_profiles, thermal_inputs
from fesim.setup.machine import Setup, set_up
from fesim.setup.structure import measured_points
from fesim.simulate import COUPLINGS, MOVING_COUPLINGS
from fesim.solid.condensation import condense_heat
from fesim.solid.heat import ThermalLoads, capacity_form, cell_field, heat_operators
from fesim.solid.joint_operators import joint_operators
from fesim.solid.spaces import interpolation, probe_rows
from meshes.pairing import PairedJoint, pair_joint
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: Parts of a contact element in each direction over which a pressure is averaged.
PARTS = 4


@dataclass(frozen=True)
class Ours:
    """Our side of a comparison."""

    #: The condensed case.
    setup: Setup
    #: The last one.
    step: Step
    #: Shape (nodes, 3): at the end, m, nodes as in the space of displacements.
    displacement: Array
    #: Wall time of set-up and march.
    seconds: float
    #: Wall time of the march alone.
    march_seconds: float


@dataclass(frozen=True)
class Agreement:
    """Largest differences at the end of a run, and the values that they are relative to."""

    #: Largest difference over the largest value: of nodal temperatures, nodal displacement vectors
    #: and mean pressures of the contact elements.
    temperature: float
    displacement: float
    pressure: float
    #: Difference of the case's recorded displacement over its size.
    probe: float
    #: Those values, K, m, Pa and m.
    temperature_scale: float
    displacement_scale: float
    pressure_scale: float
    probe_scale: float
    #: Difference of the joint's normal force over CalculiX's.
    normal_force: float
    #: The same of CalculiX's printed force and the one from its displacements by our law.
    force_check: float


def comparable(law: JointLaw) -> JointLaw:
    """Return the law that both sides can have: `law` itself if it is linear, else exponential."""
    normal = law.normal
    linear = isinstance(normal, BackBurdekinLaw) and normal.exponent == 1.0
    return law if linear else exponential(law)


def run_ours(case: Case, law: JointLaw, *, consistent: bool = False) -> Ours:
    """March a case on one thread with `law` at its joint.

    `case`: what to march. `law`: instead of the case's. `consistent`: take the consistent heat
    capacity, which CalculiX has, instead of the lumped one.
    """
    count = step_count(case.march)
    with threadpool_limits(limits=1):
        start = time.perf_counter()
        setup = set_up(case)
        machine = with_law(setup.machine, law)
        if consistent:
            machine = with_consistent_capacity(case, setup, machine)
        ready = time.perf_counter()
        steps = march(machine, thermal_inputs(case), COUPLINGS[case.march.coupling])
        step = next(islice(steps, count - 1, count))
        end = time.perf_counter()
        displacement = setup.field.solve(
            setup.nodal_temperature(step.state), step.remainder
        ).reshape(-1, 3)
    return Ours(setup, step, displacement, end - start, end - ready)


def ride_ours(case: Case, law: JointLaw) -> tuple[Setup, Step, float]:
    """March a case whose axes stand, with `law` at its joint; return the last step, and wall time.

    `case`: with axes that stand. `law`: instead of the case's.
    """
    begun = time.perf_counter()
    ready = set_up_axes(case)
    moving = replace(ready.moving, machine=with_law(ready.moving.machine, law))
    ends = case.march.step_s * np.arange(1.0, step_count(case.march) + 1.0)
    along, start = MOVING_COUPLINGS[case.march.coupling], initial_state(moving.machine)
    *_, last = along(moving, ready.axes, axis_inputs(case).at(ends), start)
    return ready.setup, last.step(-1), time.perf_counter() - begun


def with_consistent_capacity(
    case: Case, setup: Setup, machine: CondensedMachine
) -> CondensedMachine:
    """Return the machine with the consistent heat capacity."""
    structure, basis = setup.structure, setup.spaces.heat
    materials = problem_of(case).materials
    stored = {name: m.density * m.heat_capacity for name, m in materials.items()}
    heat = heat_operators(
        structure,
        basis,
        materials,
        ThermalLoads(case.convection_W_m2K, heat_sources(case, structure), held_profiles(case)),
    )
    capacity = capacity_form.assemble(basis, value=cell_field(structure, stored, basis))
    thermal = condense_heat(
        replace(heat, capacity=capacity),
        joint_operators(setup.joints, setup.spaces),
        case.march.step_s,
        case.march.solver,
    )
    return replace(machine, thermal=thermal)


def run_theirs(problem: Problem, choices: Choices, folder: Path, name: str, timeout: float) -> Run:
    """Run a problem by CalculiX."""
    return run_deck(write_deck(problem, choices).text, folder, name, timeout)


def agreement(case: Case, problem: Problem, ours: Ours, run: Run, basis: CellBasis) -> Agreement:
    """Compare the ends of two runs at the mesh's nodes and over the contact elements."""
    joint, setup = problem.joint, ours.setup
    heat, elastic = setup.spaces.heat.nodal_dofs[0], setup.spaces.elastic.nodal_dofs[0]
    theirs = basis.nodal_dofs[0]
    temperature = ours.step.state.temperature[heat], run.temperature[theirs]
    displacement = ours.displacement[elastic], run.displacement[theirs]
    pressure = ours.step.state.pressure, mean_pressures(problem, basis, run.displacement)
    recorded = recorded_displacement(case, problem, basis, run.displacement)
    probe = ours.step.displacement[None], recorded[None]
    force = [float(p @ joint.area) for p in pressure]
    parts = [
        _difference(first, second) for first, second in (temperature, displacement, pressure, probe)
    ]
    (t, t_scale), (u, u_scale), (p, p_scale), (r, r_scale) = parts
    return Agreement(
        temperature=t,
        displacement=u,
        pressure=p,
        probe=r,
        temperature_scale=t_scale,
        displacement_scale=u_scale,
        pressure_scale=p_scale,
        probe_scale=r_scale,
        normal_force=force[0] / run.normal_force - 1.0,
        force_check=force[1] / run.normal_force - 1.0,
    )


def recorded_displacement(
    case: Case, problem: Problem, basis: CellBasis, displacement: Array
) -> Array:
    """Return the displacement (3,) that the case records, m, of nodal ones (nodes, 3)."""
    probes = problem.structure.probes
    names = measured_points(case)
    rows = probe_rows(basis, problem.structure, {name: probes[name] for name in names})
    moved = rows @ displacement
    return moved[0] - moved[1] if len(names) == 2 else moved[0]


def values(case: Case, problem: Problem, basis: CellBasis, run: Run) -> dict[str, float]:
    """Return figures that do not depend on the mesh: see `our_values`."""
    recorded = recorded_displacement(case, problem, basis, run.displacement)
    probes = {name: problem.structure.probes[name] for name in case.probes}
    temperatures = probe_rows(basis, problem.structure, probes) @ run.temperature
    pressure = mean_pressures(problem, basis, run.displacement)
    return _figures(list(probes), temperatures, recorded, pressure)


def our_values(setup: Setup, step: Step) -> dict[str, float]:
    """Return temperatures at the probes (K), the recorded displacement and extreme pressures."""
    temperatures = setup.probe_rows @ step.state.temperature
    return _figures(list(setup.probes), temperatures, step.displacement, step.state.pressure)


def _figures(
    probes: list[str], temperatures: Array, displacement: Array, pressure: Array
) -> dict[str, float]:
    figures = {f"T {name}, K": float(t) for name, t in zip(probes, temperatures, strict=True)}
    figures |= {f"δ{axis}, µm": 1e6 * float(displacement[i]) for i, axis in enumerate("xy")}
    return figures | {
        "lowest p, MPa": 1e-6 * float(pressure.min()),
        "highest p, MPa": 1e-6 * float(pressure.max()),
    }


def mean_pressures(problem: Problem, basis: CellBasis, displacement: Array) -> Array:
    """Mean pressures (m,) over the contact elements of a law that holds at every point.

    The pressure may grow manifold within a contact element, so the means are taken over `PARTS` x
    `PARTS` parts of each.

    `problem`: joint and law. `basis`: scalar space of the displacement. `displacement` (nodes, 3):
    displacement, m. Raises `InputError`: a patch of the joint is no rectangle.
    """
    along, across = problem.grid
    fine = pair_joint(problem.structure, problem.joint.name, PARTS * along, PARTS * across)
    if fine.area.size != PARTS**2 * problem.joint.area.size:
        raise InputError("against_calculix: a patch of the joint is no rectangle")
    pressure = problem.law.normal.pressure(point_openings(fine, basis, displacement))
    force = np.bincount(fine.element, fine.weights * pressure)
    # Contact elements are counted along the joint, then across, then patch by patch.
    parts = force.reshape(-1, across, PARTS, along, PARTS).sum(axis=(2, 4))
    return parts.ravel() / problem.joint.area


def point_openings(joint: PairedJoint, basis: CellBasis, displacement: Array) -> Array:
    """Opening at every quadrature point of the joint, m."""
    normal = joint.normal[joint.element]
    moved = [
        np.einsum("qi,qi->q", interpolation(basis, points, cells) @ displacement, normal)
        for points, cells in ((joint.points_a, joint.cells_a), (joint.points_b, joint.cells_b))
    ]
    return moved[1] - moved[0]


def _difference(first: Array, second: Array) -> tuple[float, float]:
    """Largest difference over the largest value of the second, and that value."""
    size = np.abs if first.ndim == 1 else lambda rows: np.linalg.norm(rows, axis=1)
    scale = float(np.max(size(second)))
    return float(np.max(size(first - second))) / scale, scale
