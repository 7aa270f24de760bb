"""Writes a problem as a CalculiX input deck.

The preload. CalculiX knows no preloaded joint: it measures overclosure from the geometry, and an
overclosure makes a pressure that something must balance. So side b is moved into side a by `shift`,
which makes the table's overclosure `shift - opening`, and both sides are pulled together with the
preload as a surface load, as the clamps do. The first step, one increment, has only that: contact
pressure and clamps balance on every part of the joint, nothing moves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skfem import CellBasis

from benchmarks.against_calculix.elements import (
    connectivity,
    element_of,
    faces,
    node_basis,
)
from benchmarks.against_calculix.laws import ExponentialLaw
from benchmarks.against_calculix.problem import Problem
from fesim.joint.law import BackBurdekinLaw, JointLaw
from fesim.solid.elasticity import DIRECTIONS
from meshes.pairing import outward_areas
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

Table = list[tuple[float, float]]

TEMPERATURE = 11

#: The pressure table starts where the pressure is this part of the preload, and ends where it is
#: this many times the preload.
NEGLIGIBLE = 1e-6
LARGEST = 20.0
#: Pressures of the conductance table over the preload. CalculiX 2.20 has room for 20 points: they
#: are dense where the pressures are. In between it takes straight lines.
CONDUCTANCE_PRESSURES = np.array([0.0, *np.geomspace(1e-3, 0.1, 3), *np.geomspace(0.15, 20.0, 16)])


@dataclass(frozen=True)
class Choices:
    """How CalculiX is asked to solve a problem."""

    #: One of `elements.ELEMENTS`; "" for the one with our displacements.
    element: str = ""
    #: Steady state instead of time steps.
    steady: bool = False
    #: Write the normal law as a table of so many points; 0 for CalculiX's closed forms.
    table_points: int = 0
    #: Largest residual and correction of an increment, relative to what CalculiX compares them
    #: with; 0 for its own, 0.5 % and 1 %.
    tolerance: float = 0.0
    #: Iterations before an increment may be given up as diverging; 0 for its own, 4.
    patience: int = 0
    #: Results after every so many increments (and the last).
    every: int = 1_000_000


@dataclass(frozen=True)
class Deck:
    """An input deck and what is needed to read its results."""

    #: The deck.
    text: str
    #: The scalar space whose unknown i is node i + 1 of the deck.
    basis: CellBasis
    #: Overclosure at opening 0, m.
    shift: float


def pressure_table(law: JointLaw, points: int, shift: float) -> Table:
    """Points (pressure, overclosure) of the normal law; overclosure is `shift` less the opening.

    From overclosure 0, where CalculiX lets go and the pressure is set to zero, to `LARGEST` times
    the preload. The preload is a point, so that its balance is exact.
    """
    deepest = shift - _opening_at(law, LARGEST * law.preload)
    inside = np.linspace(0.0, shift, max(2, round(points * shift / deepest)))
    outside = np.linspace(shift, deepest, points - inside.size + 1)[1:]
    depth = np.concatenate([inside, outside])
    pressure = law.normal.pressure(shift - depth)
    pressure[0] = 0.0
    pressure[inside.size - 1] = law.preload
    return list(zip(pressure.tolist(), depth.tolist(), strict=True))


def conductance_table(problem: Problem, pressures: Array) -> Table:
    """Points (conductance, pressure) of Eq. 11."""
    count = len(problem.joint.area)
    values = [problem.law.conductance(np.full(count, pressure)) for pressure in pressures]
    if not all(np.allclose(each, each[0], rtol=1e-12) for each in values):
        raise InputError("against_calculix: a side of the joint has two materials; give it one")
    return [(float(h[0]), float(p)) for h, p in zip(values, pressures, strict=True)]


def write_deck(problem: Problem, choices: Choices) -> Deck:
    """Return the deck of a problem."""
    structure, law = problem.structure, problem.law
    element = element_of(structure, choices.element)
    basis = node_basis(structure, element)
    cells = connectivity(basis)
    normal, shift = _normal_behaviour(law, choices.table_points)
    conductances = conductance_table(problem, law.preload * CONDUCTANCE_PRESSURES)
    side_a, side_b = structure.joints[problem.joint.name]
    on = {
        name: faces(structure, basis, cells, name)
        for name in {side_a, side_b, *problem.convection, *problem.fluxes}
    }
    pull = _number(-law.preload)
    # Faces of a guide beside its pads would touch them across their edge.
    sides = {
        "SIDE_A": _covered(problem, side_a, problem.joint.cells_a, on[side_a]),
        "SIDE_B": _covered(problem, side_b, problem.joint.cells_b, on[side_b]),
    }
    clamps = [f"{e}, P{f}, {pull}" for side in sides.values() for e, f in side]
    # A steady load is held for a second step, which takes out what the tolerance of the first one
    # leaves (on the bars, 2e-5 of the displacement becomes 2e-7).
    count = 2 if choices.steady else 1
    friction = law.friction
    lines = chain(
        ["*NODE, NSET=ALL"],
        _rows(_shifted_nodes(problem, basis, shift).T, start=1),
        _bodies(problem, cells, element),
        *(
            [f"*SURFACE, NAME={label}, TYPE=ELEMENT", *(f"{e}, S{f}" for e, f in side)]
            for label, side in sides.items()
        ),
        ["*SURFACE INTERACTION, NAME=JOINT"],
        normal,
        ["*FRICTION", f"{_number(friction.coefficient)}, {_number(friction.stiffness)}"]
        if friction.coefficient
        else [],
        ["*GAP CONDUCTANCE", *_rows(conductances)],
        ["*CONTACT PAIR, INTERACTION=JOINT, TYPE=SURFACE TO SURFACE", "SIDE_A, SIDE_B"],
        # A transient step starts with accelerations computed without contact forces: if it starts
        # without clamps too, they are zero.
        ["*AMPLITUDE, NAME=CLAMPS", "0., 0., 1.E-9, 1., 1.E9, 1."],
        ["*INITIAL CONDITIONS, TYPE=TEMPERATURE", "ALL, 0."],
        ["*BOUNDARY", *_supports(problem, basis)],
        ["*STEP, INC=10", "*COUPLED TEMPERATURE-DISPLACEMENT, STEADY STATE, DIRECT", "1., 1."],
        ["*DLOAD", *clamps],
        *(
            ["*FILM", *(f"{e}, F{f}, 0., {_number(convection)}" for e, f in on[name])]
            for name, convection in problem.convection.items()
        ),
        _held(problem, basis, 0.0),
        # A transient step after this one keeps account of energy, and wants it from the start.
        ["*EL PRINT, ELSET=BODY1, TOTALS=ONLY", "ELSE"],
        ["*END STEP"],
        *(_loaded_step(problem, basis, on, clamps, choices) for _ in range(count)),
    )
    text = "\n".join(lines) + "\n"
    return Deck(text, basis, shift)


def _normal_behaviour(law: JointLaw, points: int) -> tuple[list[str], float]:
    """Lines of the normal law, and the overclosure at opening 0."""
    normal = law.normal
    keyword = "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE="
    if points:
        shift = _opening_at(law, NEGLIGIBLE * law.preload)
        return [keyword + "TABULAR", *_rows(pressure_table(law, points, shift))], shift
    if isinstance(normal, BackBurdekinLaw) and normal.exponent == 1.0:
        stiffness = 1.0 / normal.coefficient
        return [keyword + "LINEAR", f"{_number(stiffness)}, 1."], law.preload / stiffness
    if isinstance(normal, ExponentialLaw):
        # CalculiX takes the overclosure over which the pressure grows a hundredfold.
        hundredfold = np.log(100.0) / normal.rate
        start = NEGLIGIBLE * law.preload
        lines = [keyword + "EXPONENTIAL", f"{_number(hundredfold)}, {_number(start)}"]
        return lines, -float(np.log(NEGLIGIBLE)) / normal.rate
    raise InputError(
        "against_calculix: CalculiX has this normal law as a table only, which its surface-to-"
        "surface contact misreads; use an exponential law, or back-burdekin with exponent 1"
    )


def _opening_at(law: JointLaw, pressure: float) -> float:
    """Opening at which the normal law gives `pressure`, by bisection."""
    scale = law.preload / -float(law.normal.slope(np.zeros(1))[0])

    def excess(opening: float) -> float:
        return float(law.normal.pressure(np.array([opening]))[0]) - pressure

    return float(brentq(excess, -50.0 * scale, 50.0 * scale, xtol=1e-15))


def _bodies(problem: Problem, cells: NDArray[np.int64], element: str) -> list[str]:
    lines: list[str] = []
    for number, (name, members) in enumerate(problem.structure.bodies.items(), start=1):
        m = problem.materials[name]
        lines += [f"*ELEMENT, TYPE={element}, ELSET=BODY{number}"]
        lines += [_wrapped([cell + 1, *(cells[cell] + 1)]) for cell in members]
        lines += [f"*MATERIAL, NAME=MATERIAL{number}"]
        lines += ["*ELASTIC", f"{_number(m.youngs_modulus)}, {_number(m.poisson_ratio)}, 0."]
        lines += ["*EXPANSION, ZERO=0.", f"{_number(m.expansion)}, 0."]
        lines += ["*CONDUCTIVITY", f"{_number(m.conductivity)}, 0."]
        lines += ["*DENSITY", f"{_number(m.density)}, 0."]
        lines += ["*SPECIFIC HEAT", f"{_number(m.heat_capacity)}, 0."]
        lines += [f"*SOLID SECTION, ELSET=BODY{number}, MATERIAL=MATERIAL{number}"]
    return lines


def _shifted_nodes(problem: Problem, basis: CellBasis, shift: float) -> Array:
    """Nodes (3, n) with everything connected to side b moved into side a by `shift` (m)."""
    dofs = basis.element_dofs
    size = int(basis.N)
    first = np.tile(dofs[0], len(dofs))
    links = coo_array((np.ones(first.size), (first, dofs.ravel())), shape=(size, size))
    _, label = connected_components(links, directed=False)
    part_a = set(label[dofs[0, problem.joint.cells_a]])
    part_b = set(label[dofs[0, problem.joint.cells_b]])
    if part_a & part_b:
        raise InputError("against_calculix: the sides of the joint are parts of one body")
    moved = np.isin(label, list(part_b))
    return basis.doflocs - shift * problem.joint.normal[0][:, None] * moved


def _covered(
    problem: Problem, side: str, cells: NDArray[np.int64], on: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Faces of a side that the other one covers, in front of `cells`: a guide is longer."""
    mesh, facets = problem.structure.mesh, problem.structure.surface(side)
    under = facets[np.isin(mesh.f2t[0, facets], cells)]
    area = np.linalg.norm(outward_areas(mesh, under), axis=1).sum()
    if not np.isclose(area, problem.joint.area.sum(), rtol=1e-9):
        raise InputError("against_calculix: pads cover parts of faces; align the meshes")
    covered = set((1 + cells).tolist())
    return [(e, f) for e, f in on if e in covered]


def _supports(problem: Problem, basis: CellBasis) -> list[str]:
    held: set[tuple[int, int]] = set()
    wanted: list[tuple[str, tuple[int, ...]]] = [(name, (1, 2, 3)) for name in problem.fixed]
    wanted += [(name, (1 + DIRECTIONS.index(d),)) for name, d in problem.symmetry.items()]
    for name, directions in wanted:
        nodes = basis.get_dofs(problem.structure.surface(name)).all()
        held |= {(int(node) + 1, direction) for node in nodes for direction in directions}
    return [f"{node}, {direction}" for node, direction in sorted(held)]


def _tolerance(value: float) -> list[str]:
    return ["*CONTROLS, PARAMETERS=FIELD", f"{_number(value)}, {_number(value)}"]


def _patience(iterations: int) -> list[str]:
    own = f"{iterations}, {2 * iterations}, 9, {4 * iterations}, 10, 4, , 5, ,"
    return ["*CONTROLS, PARAMETERS=TIME INCREMENTATION", own, ".25, .5, .75, .85, , , 1.5,"]


def _held(problem: Problem, basis: CellBasis, factor: float) -> list[str]:
    lines = ["*BOUNDARY"] if problem.held else []
    for name, value in problem.held.items():
        nodes = basis.get_dofs(problem.structure.surface(name)).all()
        lines += [
            f"{node + 1}, {TEMPERATURE}, {TEMPERATURE}, {_number(factor * value)}" for node in nodes
        ]
    return lines


def _loaded_step(
    problem: Problem,
    basis: CellBasis,
    on: dict[str, list[tuple[int, int]]],
    clamps: list[str],
    choices: Choices,
) -> list[str]:
    # CalculiX's transient step is dynamic; the strongest damping keeps the velocities, from which
    # it predicts the next increment, from ringing.
    kind = ", STEADY STATE" if choices.steady else ", ALPHA=-.333333"
    # A ramp in ten increments: in one, the iterations do not always find a stiff joint's state.
    times = (
        ".1, 1."
        if choices.steady
        else f"{_number(problem.step)}, {_number(problem.step * problem.steps)}"
    )
    increments = f"FREQUENCY={choices.every}"
    return [
        f"*STEP, INC={problem.steps + 20}",
        f"*COUPLED TEMPERATURE-DISPLACEMENT{kind}, DIRECT",
        times,
        *(_tolerance(choices.tolerance) if choices.tolerance else []),
        *(_patience(choices.patience) if choices.patience else []),
        *([] if choices.steady else ["*DLOAD, OP=NEW, AMPLITUDE=CLAMPS", *clamps]),
        *_held(problem, basis, 1.0),
        *chain.from_iterable(
            ["*DFLUX", *(f"{e}, S{f}, {_number(flux)}" for e, f in on[name])]
            for name, flux in problem.fluxes.items()
        ),
        f"*NODE PRINT, NSET=ALL, {increments}",
        "U, NT",
        f"*CONTACT PRINT, {increments}",
        "CDIS, CSTR",
        f"*CONTACT PRINT, SLAVE=SIDE_A, MASTER=SIDE_B, {increments}",
        "CF",
        "*END STEP",
    ]


def _rows(rows: Iterable[Iterable[float]], start: int | None = None) -> Iterator[str]:
    """Comma-separated rows with all digits, numbered from `start` on if that is given."""
    for number, row in enumerate(rows, start=start or 0):
        values = ", ".join(_number(value) for value in row)
        yield values if start is None else f"{number}, {values}"


def _number(value: float) -> str:
    """Number in a field of 20 characters, which is all that CalculiX reads."""
    return f"{value:.13E}"


def _wrapped(numbers: list[int]) -> str:
    """An element's numbers, at most 16 in a line."""
    pieces = [numbers[at : at + 15] for at in range(0, len(numbers), 15)]
    return ",\n".join(", ".join(str(number) for number in piece) for piece in pieces)
