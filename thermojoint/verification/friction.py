"""Friction: a pressed block moved back and forth and in a circle.

Two bodies are so stiff that only the joint between them deforms; the far face of one is fixed, the
far face of the other is driven. Force and work are those of a spring k_t A in series with a slider
mu P.

From a case file, a force F pushes one half of an insulated column to and fro on the other, against
a spring k. The half slides by (F - mu P)/k - mu p/k_t to each side, and the work becomes heat.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from fesim.case.schema import case_from_data
from fesim.joint.gap import Equilibrium
from fesim.joint.law import Friction, JointLaw, SurfaceNormalLaw
from fesim.march.contact import ContactProblem
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from fesim.solid.condensation import condense_elasticity
from fesim.solid.elasticity import elastic_operators
from fesim.solid.joint_operators import joint_operators
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces
from meshes.pairing import pair_joint
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification import loaded
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.loaded import column_case, joint
from thermojoint.verification.series import HARDNESS, ROUGHNESS, law_at
from thermojoint.verification.structures import IRON, SECTION, bars

#: Largest gap residual, m: far below the march's, so that only the law is compared.
RESIDUAL = 1e-18
TOLERANCE = 1e-8
#: Push on the column, N; opposing spring, N/m; number of strokes and duration of each, s.
PUSH, AGAINST, STROKES, STROKE = 4000.0, 5e6, 20, 120.0
#: Modulus of the column, Pa (9e-6 of the slip); time to a uniform temperature, s.
STIFF, EVEN = 1e15, 12000.0

COEFFICIENT = 0.3
#: The bodies' fraction of the compliance, k_t times length over modulus, is below 1e-9.
RIGID = replace(IRON, youngs_modulus=1e22, expansion=0.0)
STIFFNESS = 1e12
PRELOAD = 1.0e6
PRESSURES = (1.0e6, 4.41e6)
#: Angle between the push and the joint's first tangent, rad; oblique to both tangents.
DIRECTION = 0.5
#: Amplitude of the push, in micro-slip lengths mu p / k_t, and steps per length. The steps include
#: the kinks of the loop, so that the trapezoidal rule is exact.
AMPLITUDE, PER_LENGTH = 3, 2
#: Steps to one round of the circle. Return mapping is implicit Euler: its error falls like 1/steps.
ROUND = 1440


@dataclass(frozen=True)
class Pressed:
    """Two bodies and the joint between them."""

    #: The joint and its linear side.
    contact: ContactProblem
    #: Number of temperatures.
    nodes: int

    @property
    def area(self) -> Array:
        """Area of each contact element, m2."""
        return self.contact.elastic.area[: self.contact.count]

    def follow(self, thermal_gaps: Iterable[Array]) -> Iterator[tuple[Array, Equilibrium]]:
        """Yield (slip before, equilibrium) for one thermal gap (3 m,) after another."""
        gap, slip = np.zeros((3, self.contact.count)), np.zeros((2, self.contact.count))
        for thermal_gap in thermal_gaps:
            settled = self.contact.settle(thermal_gap, slip, gap)
            yield slip, settled
            gap, slip = settled.gap, settled.traction.slip


def pressed(
    structure: Structure,
    materials: dict[str, Material],
    law: JointLaw,
    grid: tuple[int, int],
    fixed: list[str],
    rollers: dict[str, str],
) -> Pressed:
    """Condense a structure on its joint, with reference springs as stiff as the joint itself."""
    spaces = make_spaces(structure.mesh)
    operators = joint_operators([pair_joint(structure, "joint", *grid)], spaces)
    elastic = elastic_operators(structure, spaces, materials, fixed, rollers)
    contacts = len(operators.area)
    springs = np.full(3 * contacts, law.friction.stiffness)
    no_probes = csr_array((0, spaces.displacement_size))
    condensed, _ = condense_elasticity(elastic, operators, springs, no_probes)
    contact = ContactProblem(condensed, [(law, contacts)], RESIDUAL)
    return Pressed(contact, int(spaces.heat.N))


def checks() -> Iterator[Check]:
    """Check the block at each pressure, and on its circle."""
    for pressure in PRESSURES:
        yield from block_checks(pressure)
    yield circle_check()
    yield from heat_checks()


@dataclass(frozen=True)
class Drive:
    """Force on the driver of the block."""

    #: Shape (steps, 2): force along the two tangents of the joint, N.
    force: Array
    #: Shape (steps, m): shear times slip of each contact element, J.
    dissipated: Array


def drive_block(path: Array) -> Drive:
    """Move the block along `path`, shape (steps, 3): opening and tangential displacements, m.

    Moving the driven face by U moves the block rigidly, which strains only the reference springs:
    in the gap equations this is the thermal gap (1 - C A k) U.
    """
    law = replace(law_at(PRELOAD), friction=Friction(COEFFICIENT, STIFFNESS))
    bodies = {"left": RIGID, "right": RIGID}
    block = pressed(bars("hexahedra", (2, 2, 2), (2, 3, 2)), bodies, law, (3, 2), ["x0", "x1"], {})
    elastic = block.contact.elastic
    each = np.repeat(path, block.contact.count, axis=1)
    moves = each - (each * elastic.area * elastic.reference) @ elastic.compliance
    force, dissipated = [], []
    for before, after in block.follow(moves):
        shear = -after.traction.value[1:]
        force.append(shear @ block.area)
        dissipated.append((shear * (after.traction.slip - before)).sum(axis=0) * block.area)
    return Drive(np.array(force), np.array(dissipated))


def approach(pressure: float) -> float:
    """Opening that brings the block's joint from its preload to `pressure`, m."""
    there, here = (SurfaceNormalLaw(HARDNESS, ROUGHNESS, p) for p in (pressure, PRELOAD))
    return there.separation - here.separation


def block_checks(pressure: float) -> Iterator[Check]:
    """Check a push to one side and two full cycles.

    Quantities with reference zero are relative to mu P, or to the work of a cycle.
    """
    length = COEFFICIENT * pressure / STIFFNESS
    top, cycle = AMPLITUDE * PER_LENGTH, 4 * AMPLITUDE * PER_LENGTH
    # 0 to the top, then twice down and up again.
    count = np.concatenate(
        [np.arange(top + 1), *2 * [np.abs(np.arange(1 - 2 * top, 2 * top + 1)) - top]]
    )
    pushed = length / PER_LENGTH * count
    along = np.array([np.cos(DIRECTION), np.sin(DIRECTION)])
    opening = np.full(len(pushed), approach(pressure))
    drive = drive_block(np.column_stack([opening, np.outer(pushed, along)]))
    force = drive.force @ along
    work = np.append(0.0, 0.5 * (force[1:] + force[:-1]) * np.diff(pushed))
    dissipated = drive.dissipated.sum(axis=1)
    first, second = slice(top + 1, top + 1 + cycle), slice(top + 1 + cycle, None)
    area, limit = SECTION[0] * SECTION[1], COEFFICIENT * pressure * SECTION[0] * SECTION[1]
    loop = 4.0 * limit * (pushed.max() - length)
    name = f"friction, block at {1e-6 * pressure:g} MPa"
    for quantity, unit, reference, computed, source in (
        ("pre-sliding stiffness", "N/m", STIFFNESS * area, force[1] / pushed[1], "k_t A"),
        ("sliding force", "N", limit, force[top], "mu P"),
        ("work of a cycle", "J", loop, work[second].sum(), "4 mu P (u - mu p/k_t)"),
        ("dissipation of a cycle", "J", loop, dissipated[second].sum(), "its work"),
    ):
        yield Quantity(quantity, unit, TOLERANCE, source).check(name, reference, computed)
    across = drive.force @ np.array([-along[1], along[0]])
    apart = force[second] - force[first]
    for quantity, unit, computed, scale, source in (
        ("force across the push", "N", np.abs(across).max(), limit, "none"),
        ("second cycle less the first", "N", np.abs(apart).max(), limit, "none"),
        ("least dissipation of a step", "J", drive.dissipated.min(), loop, "none while it sticks"),
    ):
        compared = Quantity(quantity, unit, TOLERANCE, source)
        yield compared.check(name, 0.0, computed, scale=float(scale))


def circle_check() -> Check:
    """The block moved in a circle: the slider follows like a trailer on a taut elastic rope.

    The rope, mu p / k_t long, is tangent to the slider's own circle, of radius r with
    r^2 + (mu p / k_t)^2 = R^2. The work of one round is thus 2 pi r mu P.
    """
    length = COEFFICIENT * PRELOAD / STIFFNESS
    radius = 2.0 * length
    angle = 2.0 * np.pi * np.arange(1, 2 * ROUND + 1) / ROUND
    start = np.linspace(0.0, radius, 11)[1:]
    path = np.vstack(
        [
            np.column_stack([0.0 * start, start, 0.0 * start]),
            radius * np.column_stack([0.0 * angle, np.cos(angle), np.sin(angle)]),
        ]
    )
    limit = COEFFICIENT * PRELOAD * SECTION[0] * SECTION[1]
    expected = 2.0 * np.pi * np.sqrt(radius**2 - length**2) * limit
    dissipated = drive_block(path).dissipated[-ROUND:].sum()
    compared = Quantity("dissipation of a round", "J", 2e-3)
    return compared.check("friction, block round a circle", expected, dissipated)


def heat_checks() -> Iterator[Check]:
    """Heat of friction in the halves of a column, and the final temperature."""
    turns = 0.5 * STROKE + STROKE * np.arange(STROKES + 1)
    factors = (-1.0) ** np.arange(STROKES + 1)
    history = np.column_stack([[0.0, *turns, EVEN], [0.0, *factors, factors[-1]]])
    with temporary_folder() as folder:
        rows = "".join(f"{time},{factor}\n" for time, factor in history)
        (folder / "push.csv").write_text(f"time_s,factor\n{rows}")
        changes = {
            "supports": {
                "fixed": ["foot"],
                "symmetry": {"side": "y"},
                "springs": {"joint.b": {"stiffness_N_um": [1e-6 * AGAINST, 0.0, 0.0]}},
            },
            "joints": {"joint": joint(preload_MPa=1e-6 * loaded.PRELOAD, slip_heating=True)},
            "loads": {
                "push": {"surface": "joint.b", "force_N": [PUSH, 0.0, 0.0], "file": "push.csv"}
            },
            "march": {"step_s": 20.0, "duration_min": EVEN / 60.0},
        }
        data = column_case(folder, True, changes)
        data["materials"]["iron"]["youngs_modulus_GPa"] = 1e-9 * STIFF
        case = case_from_data(data, "column", folder)
        setup = set_up(case)
        response = simulate(case, setup=setup, accuracy=False).response
    law, _ = setup.machine.contact.laws[0]
    limit = law.friction.coefficient * loaded.PRELOAD
    sliding = (PUSH - limit * loaded.AREA) / AGAINST - limit / law.friction.stiffness
    work = limit * loaded.AREA * sliding * (1 + 2 * STROKES)
    heat = case.march.step_s * response["friction_heat"].to_numpy()
    iron = case.materials["iron"]
    capacity = iron.density_kg_m3 * iron.heat_capacity_J_kgK * loaded.AREA * 2.0 * loaded.HALF
    name = "friction, column pushed to and fro"
    compared = Quantity("heat of friction", "J", 2e-5, "mu P times the way")
    yield compared.check(name, work, float(heat.sum()))
    compared = Quantity("temperature afterwards", "K", 2e-5, "work over heat capacity")
    yield compared.check(name, work / capacity, float(response["temperature"][-1, 0]))
