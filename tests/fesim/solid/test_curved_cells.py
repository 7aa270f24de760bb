"""Cells of second order keep their curved geometry: volumes, fields and files."""

import meshio
import numpy as np
import pytest
from skfem import FacetBasis, Functional, LinearForm, MeshHex, MeshHex2, MeshTet, MeshTet2
from skfem.io.meshio import to_meshio

from fesim.solid.elasticity import elastic_operators
from fesim.solid.heat import ThermalLoads, heat_operators
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces, probe_rows
from meshes.exchange import read_structure, write_structure
from meshes.structure import Probe, Structure
from meshes.volume_cells import corner_mesh
from thermojoint.artefacts.errors import InputError

IRON = Material(47.0, 7200.0, 500.0, 104e9, 0.27, 13.7e-6)
INNER, OUTER, HEIGHT = 0.05, 0.10, 0.03
KINDS = ["hexahedron27", "hexahedron20", "tetra10"]


def bent(points):
    """A quarter of a ring out of the unit cube."""
    radius, angle = INNER + (OUTER - INNER) * points[0], 0.5 * np.pi * points[1]
    return np.array([radius * np.cos(angle), radius * np.sin(angle), HEIGHT * points[2]])


def quarter_ring(kind, count):
    """The structure with curved cells, in memory."""
    lines = [np.linspace(0.0, 1.0, n + 1) for n in (count, 2 * count, 1)]
    straight = (MeshTet if kind == "tetra10" else MeshHex).init_tensor(*lines)
    fine = (MeshTet2 if kind == "tetra10" else MeshHex2).from_mesh(straight)
    mesh = type(fine)(bent(fine.doflocs), fine.t)
    facets = mesh.boundary_facets()
    x, y, z = straight.p[:, straight.facets[:, facets]].mean(axis=1)
    return Structure(
        mesh,
        bodies={"ring": np.arange(mesh.nelements)},
        surfaces={
            name: facets[mask]
            for name, mask in {
                "inside": x < 1e-9,
                "outside": x > 1.0 - 1e-9,
                "start": y < 1e-9,
                "end": y > 1.0 - 1e-9,
                "bottom": z < 1e-9,
            }.items()
        },
        probes={"mid": Probe(tuple(bent(np.array([0.5, 0.5, 0.5]))), "ring")},
    )


def through_a_file(kind, count, folder):
    """The structure as it comes back from a file with cells of the kind."""
    path = folder / f"ring-{count}.vtu"
    structure = quarter_ring(kind, count)
    write_structure(structure, path)
    if kind == "hexahedron20":
        grid = meshio.vtu.read(str(path))
        grid.cells = [
            meshio.CellBlock("hexahedron20", block.data[:, :20])
            if block.type == "hexahedron27"
            else block
            for block in grid.cells
        ]
        meshio.vtu.write(str(path), grid)
    return read_structure(path)


@Functional
def unity(w):
    return 1.0 + 0.0 * w.x[0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_ring_comes_back_round(kind, tmp_path):
    """Its volume misses a quarter of a ring by the fourth order of the element size."""
    exact = 0.25 * np.pi * (OUTER**2 - INNER**2) * HEIGHT
    errors = []
    for count in (1, 2):
        structure = through_a_file(kind, count, tmp_path)
        basis = make_spaces(structure.mesh).elastic
        errors.append(abs(unity.assemble(basis) / exact - 1.0))
    assert errors[0] < 2e-3
    assert errors[0] / errors[1] > 11.0
    polygons = unity.assemble(make_spaces(corner_mesh(structure.mesh)).elastic)
    assert abs(polygons / exact - 1.0) > 20.0 * errors[1]


@pytest.mark.parametrize("kind", ["hexahedron27", "tetra10"])
def test_curved_cells_survive_the_file_as_they_are(kind, tmp_path):
    structure = quarter_ring(kind, 2)
    back = through_a_file(kind, 2, tmp_path)
    assert type(back.mesh) is type(structure.mesh)
    ours, theirs = (
        np.sort(np.round(one.mesh.doflocs, 9).T.tolist(), axis=0) for one in (structure, back)
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    np.testing.assert_array_equal(back.mesh.t, structure.mesh.t)
    for name, facets in structure.surfaces.items():
        np.testing.assert_array_equal(np.sort(back.surfaces[name]), np.sort(facets))


@pytest.mark.parametrize("kind", KINDS)
def test_heat_crosses_a_ring_by_the_logarithm(kind, tmp_path):
    """Q = k angle H dT / ln(ro / ri), better by the second order of the element size."""
    exact = 47.0 * 0.5 * np.pi * HEIGHT / np.log(OUTER / INNER)
    errors = []
    for count in (2, 4):
        structure = through_a_file(kind, count, tmp_path)
        basis = make_spaces(structure.mesh).heat
        heat = heat_operators(
            structure, basis, {"ring": IRON}, ThermalLoads(held={"inside": None, "outside": None})
        )
        matrix = heat.conduction.toarray()
        given = heat.held_inputs @ np.array([0.0, 1.0, 0.0])
        temperature = np.zeros(basis.N)
        temperature[heat.held] = given
        free = np.setdiff1d(np.arange(basis.N), heat.held)
        temperature[free] = np.linalg.solve(
            matrix[np.ix_(free, free)], -matrix[np.ix_(free, heat.held)] @ given
        )
        errors.append(abs(temperature @ matrix @ temperature / exact - 1.0))
        at = probe_rows(basis, structure, structure.probes) @ temperature
        middle = np.log(OUTER / (0.5 * (INNER + OUTER))) / np.log(OUTER / INNER)
        assert at[0] == pytest.approx(middle, abs=0.02)
    assert errors[1] < 0.01
    assert errors[0] / errors[1] > 3.5


@pytest.mark.parametrize("kind", KINDS)
def test_uniform_strain_is_exact_on_curved_cells(kind, tmp_path):
    structure = through_a_file(kind, 1, tmp_path)
    spaces = make_spaces(structure.mesh)
    elastic = elastic_operators(structure, spaces, {"ring": IRON}, [], {})
    strain = np.random.default_rng(3).normal(0.0, 1e-4, (3, 3))
    displacement = (strain @ spaces.elastic.doflocs).T.ravel()
    first, shear = IRON.lame
    symmetric = 0.5 * (strain + strain.T)
    stress = first * np.trace(symmetric) * np.eye(3) + 2.0 * shear * symmetric
    forces = (elastic.stiffness @ displacement).reshape(-1, 3)
    # The surface tractions of that stress, and nothing else, hold the body.
    facets = FacetBasis(structure.mesh, spaces.elastic.elem, intorder=6)
    expected = np.stack(
        [
            LinearForm(lambda v, w, i=i: sum(stress[i, j] * w.n[j] for j in range(3)) * v).assemble(
                facets
            )
            for i in range(3)
        ],
        axis=1,
    )
    np.testing.assert_allclose(forces, expected, atol=2e-8 * np.abs(expected).max())


def test_a_cell_turned_inside_out_by_its_mid_nodes_is_refused(tmp_path):
    grid = to_meshio(quarter_ring("hexahedron27", 1).mesh, encode_cell_data=False)
    block = grid.cells[0]
    grid.points[block.data[0, 8:20]] = grid.points[block.data[0, 6]]
    grid.cell_data = {"body:ring": [np.ones(len(block.data), dtype=np.int8)]}
    meshio.vtu.write(str(tmp_path / "bad.vtu"), grid)
    with pytest.raises(InputError, match="folded"):
        read_structure(tmp_path / "bad.vtu")
