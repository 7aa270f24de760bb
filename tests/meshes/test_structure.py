"""A structure is checked when it is made: each error says what is wrong and where."""

from dataclasses import replace

import numpy as np
import pytest
from bars import two_bars
from skfem import MeshHex, MeshQuad, MeshTet

from meshes.structure import Probe, Structure
from thermojoint.artefacts.errors import InputError

BARS = two_bars()


def refused(match, **changes):
    with pytest.raises(InputError, match=match) as error:
        replace(BARS, **changes)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mesh", [MeshHex(), MeshTet()])
def test_hexahedra_and_tetrahedra_make_structures(mesh):
    structure = Structure(mesh, {"block": np.arange(mesh.nelements)}, {})
    assert structure.body("block").size == mesh.nelements


def test_a_plane_mesh_is_refused():
    refused("MeshQuad1; use tetrahedra or hexahedra", mesh=MeshQuad())


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_node_that_is_not_finite_is_named(value):
    points = BARS.mesh.p.copy()
    points[1, 7] = value
    refused("node 7 ", mesh=MeshHex(points, BARS.mesh.t))


def test_every_cell_is_in_exactly_one_body():
    left, right = BARS.bodies["left"], BARS.bodies["right"]
    refused("1 cells are in no body and 0 in several", bodies={"left": left[1:], "right": right})
    twice = np.append(right, left[0])
    refused(
        "and 1 in several, the first in 'left' and 'right'; put",
        bodies={"left": left, "right": twice},
    )


def test_empty_and_foreign_bodies_are_named():
    none = np.empty(0, dtype=int)
    refused("body 'ghost' has no cells", bodies=BARS.bodies | {"ghost": none})
    beyond = np.array([BARS.mesh.nelements])
    refused("body 'ghost' names cells", bodies=BARS.bodies | {"ghost": beyond})


def test_surfaces_are_boundaries():
    inside = np.setdiff1d(np.arange(BARS.mesh.nfacets), BARS.mesh.boundary_facets())
    refused("'cut' has facets inside", surfaces=BARS.surfaces | {"cut": inside[:1]})
    none = np.empty(0, dtype=int)
    refused("surface 'cut' has no facets", surfaces=BARS.surfaces | {"cut": none})


def test_joints_need_two_separate_surfaces():
    refused("did you mean 'joint.b'", joints={"joint": ("joint.a", "joint_b")})
    refused("share facets", joints={"joint": ("joint.a", "joint.a")})


def test_probes_lie_in_the_mesh_and_name_a_body_that_exists():
    refused(
        r"probe 'far' at \(100, 30, 20\) m lies outside .* \(0, 0, 0\) to",
        probes={"far": Probe((100.0, 30.0, 20.0))},
    )
    refused("probe 'far'", probes={"far": Probe((np.nan, 0.0, 0.0))})
    refused("did you mean 'left'", probes={"near": Probe((0.0, 0.0, 0.0), "lefty")})


def test_a_wrong_name_is_answered_by_the_nearest_one():
    with pytest.raises(InputError, match=r"supports: no surface .* did you mean 'left_end'"):
        BARS.surface("left_ent", "supports")
    with pytest.raises(InputError, match=r"bodies: no body .* did you mean 'right'"):
        BARS.body("rigth", "bodies")
