"""NAFEMS T1: thermal stress of a membrane with a hot spot.

A hot disc of radius a in a cold plate: alpha T = 1e-3 inside, 0 outside, E = 100 GPa, nu = 0.3,
plane stress. Result: sigma_yy at D = (a, 0), on the cold side. In an unbounded plate it is
E alpha T / 2 = 50 MPa, the value of the benchmark; in the 20 mm square plate of the benchmark it is
0.9 % larger because of the free edges.

Plane stress in three dimensions: between two planes that hold z, a material with
E' = E (1 + 2 nu) / (1 + nu)^2, nu' = nu / (1 + nu), alpha' = alpha (1 + nu) / (1 + 2 nu) has the
displacement and the stress in the plane of one with E, nu and alpha in plane stress: E' / (1 -
nu'^2) = E, nu' / (1 - nu') = nu, alpha' (1 + nu') = alpha. The problem then has no
three-dimensional layer at the edge of the disc.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex

from fesim.solid.elasticity import elastic_operators
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces, probe_cells
from fesim.solid.stress import stress_at, stress_rows
from meshes.structure import Probe, Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.solving import solve_given
from thermojoint.verification.structures import box_surfaces

Complex = NDArray[np.complexfloating[Any, Any]]

RADIUS, THICKNESS = 1e-3, 1e-4
MODULUS, POISSON, HOT_STRAIN = 100e9, 0.3, 1e-3
UNBOUNDED = 0.5 * MODULUS * HOT_STRAIN
#: The square core of the disc's mesh, in radii.
CORE = 0.6


def quarter_plate(half_width: float, around: int) -> Structure:
    """Mesh a quarter of the plate, one element thick, with bodies "hot" and "cold".

    `around` elements divide an eighth of the circle; all elements are about as long as wide. The
    half-width is in m.
    """
    line = np.linspace(0.0, 1.0, around + 1)
    side = 0.25 * np.pi / around
    layers = int(np.ceil((1.0 - CORE) / side))
    reach = half_width / RADIUS
    rings = int(np.ceil(np.log(reach) / side))
    growing = (np.geomspace(1.0, reach, rings + 1) - 1.0) / (reach - 1.0)
    hot = [
        _block(line, line, lambda u, v: CORE * np.stack([u, v])),
        *_both_halves(np.linspace(0.0, 1.0, layers + 1), line, _core_side, _circle),
    ]
    cold = _both_halves(growing, line, _circle, lambda v: reach * _plate_side(v))
    mesh = _glued([*hot, *cold])
    cells = np.arange(mesh.nelements)
    count = sum(part.nelements for part in hot)
    return Structure(mesh, {"hot": cells[:count], "cold": cells[count:]}, box_surfaces(mesh))


def _core_side(v: Array) -> Array:
    return CORE * np.stack([np.ones_like(v), v])


def _circle(v: Array) -> Array:
    return np.stack([np.cos(0.25 * np.pi * v), np.sin(0.25 * np.pi * v)])


def _plate_side(v: Array) -> Array:
    return np.stack([np.ones_like(v), np.tan(0.25 * np.pi * v)])


def _block(u: Array, v: Array, place: Callable[[Array, Array], Array]) -> MeshHex:
    """Mesh one layer over the grid (u, v), its nodes put at place(u, v) in the plane."""
    grid = MeshHex.init_tensor(u, v, np.array([0.0, 1.0]))
    return MeshHex(np.vstack([place(grid.p[0], grid.p[1]), grid.p[2]]), grid.t)


def _both_halves(
    u: Array, v: Array, start: Callable[[Array], Array], end: Callable[[Array], Array]
) -> list[MeshHex]:
    """Return the part between two curves over the angles 0 to 45 degrees, and its mirror image."""

    def place(s: Array, t: Array) -> Array:
        return (1.0 - s) * start(t) + s * end(t)

    return [_block(u, v, place), _block(u, v, lambda s, t: place(s, t)[::-1])]


def _glued(parts: list[MeshHex]) -> MeshHex:
    """Join blocks at their common nodes; convert radii and layers to m."""
    points = np.hstack([part.p for part in parts])
    shifts = np.cumsum([0, *(part.p.shape[1] for part in parts)])
    corners = np.hstack([part.t + shift for part, shift in zip(parts, shifts, strict=False)])
    _, first, number = np.unique(points.round(9), axis=1, return_index=True, return_inverse=True)
    size = np.array([[RADIUS], [RADIUS], [THICKNESS]])
    return MeshHex(np.ascontiguousarray(size * points[:, first]), number.ravel()[corners])


def stress_at_d(half_width: float, around: int) -> float:
    """sigma_yy at D on the cold side, Pa."""
    structure = quarter_plate(half_width, around)
    spaces = make_spaces(structure.mesh)
    cold = Material(
        conductivity=1.0,
        density=1.0,
        heat_capacity=1.0,
        youngs_modulus=MODULUS * (1.0 + 2.0 * POISSON) / (1.0 + POISSON) ** 2,
        poisson_ratio=POISSON / (1.0 + POISSON),
        expansion=0.0,
    )
    strain = HOT_STRAIN * (1.0 + POISSON) / (1.0 + 2.0 * POISSON)
    materials = {"hot": replace(cold, expansion=strain), "cold": cold}
    held = {"x0": "x", "y0": "y", "z0": "z", "z1": "z"}
    elastic = elastic_operators(structure, spaces, materials, [], held)
    rise = np.ones(spaces.heat.N)
    held_unknowns = np.setdiff1d(np.arange(spaces.displacement_size), elastic.free)
    load = elastic.thermal_load @ rise
    displacement = solve_given(elastic.stiffness, load, held_unknowns, 0.0, "hot spot")
    point = Probe((RADIUS, 0.0, 0.5 * THICKNESS), "cold")
    rows = stress_rows(
        structure,
        spaces,
        materials,
        np.array(point.position)[:, None],
        probe_cells(structure, {"D": point}),
    )
    stress = stress_at(rows, displacement, rise)
    return float(stress[0, 1, 1])


def square_plate_stress(half_width: float, terms: int = 12) -> float:
    """sigma_yy at D of a square plate with free edges, Pa: the closed form plus a series.

    Kolosov-Muskhelishvili: s_xx + s_yy = 4 Re f, s_yy - s_xx + 2 i s_xy = 2 (conj(z) f' + g). The
    unbounded plate outside the disc is f = 0, g = s a^2 / z^2. What frees the edges is regular
    inside and has the symmetry of the square: f = sum A_k z^(4k), g = sum B_k z^(4k+2), fitted to
    the tractions on the edge by least squares.
    """
    y = np.linspace(0.0, 1.0, 40 * terms)
    edge = 1.0 + 1j * y
    far = _stresses(0.0 * edge, 0.0 * edge, (RADIUS / half_width) ** 2 / edge**2, edge)
    at_d = np.array([RADIUS / half_width + 0.0j])
    basis = [_power(edge, k) for k in range(terms)] + [_shear_power(edge, k) for k in range(terms)]
    on_d = [_power(at_d, k) for k in range(terms)] + [_shear_power(at_d, k) for k in range(terms)]
    tractions = np.array([np.concatenate([part[0], part[2]]) for part in basis]).T
    wanted = -np.concatenate([far[0], far[2]])
    coefficients = np.linalg.lstsq(tractions, wanted, rcond=None)[0]
    return UNBOUNDED * (1.0 + float(coefficients @ np.array([part[1][0] for part in on_d])))


def _stresses(f: Complex, f_prime: Complex, g: Complex, z: Complex) -> tuple[Array, Array, Array]:
    """s_xx, s_yy and s_xy of the potentials at z."""
    total = 4.0 * f.real
    apart = 2.0 * (np.conj(z) * f_prime + g)
    return 0.5 * (total - apart.real), 0.5 * (total + apart.real), 0.5 * apart.imag


def _power(z: Complex, k: int) -> tuple[Array, Array, Array]:
    slope = 4 * k * z ** (4 * k - 1) if k else 0.0 * z
    return _stresses(z ** (4 * k), slope, 0.0 * z, z)


def _shear_power(z: Complex, k: int) -> tuple[Array, Array, Array]:
    return _stresses(0.0 * z, 0.0 * z, z ** (4 * k + 2), z)


def checks() -> Iterator[Check]:
    """NAFEMS T1 on the benchmark's plate and on a practically unbounded one."""
    for width, reference, source in (
        (10e-3, square_plate_stress(10e-3), "series for the finite plate"),
        (40e-3, UNBOUNDED, "NAFEMS T1: 50.0 MPa, E alpha T / 2"),
    ):
        yield Quantity("sigma_yy at D", "MPa", 5e-3, source).check(
            f"NAFEMS T1, plate of {2e3 * width:g} mm",
            1e-6 * reference,
            1e-6 * stress_at_d(width, around=12),
        )
