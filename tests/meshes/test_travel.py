"""Stations: places that contact elements cover at several positions, each paired once."""

import numpy as np
import pytest

from meshes.box_grid import Box, box_mesh, put_side_by_side
from meshes.pairing import pair_joint
from meshes.structure import Structure
from meshes.travel import Travel, sliding, stations_of
from thermojoint.artefacts.errors import InputError

FEET = ("left", "right")
APART, SIZE, STEPS = 4, 0.02, 7


def two_feet_on_a_guide():
    """Feet of two elements along, and of one width, four elements apart."""
    guide = box_mesh([Box((0.0, -0.02, 0.0), (0.3, 0.0, 0.02))], (), ((), (), ()), SIZE)
    begins = [APART * SIZE * k for k in range(2)]
    boxes = [Box((x, 0.0, 0.0), (x + 2 * SIZE, 0.02, 0.02)) for x in begins]
    feet = [box_mesh([box], (), ((), (), ()), SIZE) for box in boxes]
    mesh, (below, *above) = put_side_by_side([guide, *feet])
    facets = mesh.boundary_facets()
    touching = np.abs(mesh.p[1, mesh.facets[:, facets]]).max(axis=0) < 1e-9
    owner = mesh.f2t[0, facets]
    surfaces = {
        name: facets[touching & np.isin(owner, cells)]
        for name, cells in zip(("top", *FEET), (below, *above), strict=True)
    }
    bodies = {"guide": below, **dict(zip(FEET, above, strict=True))}
    joints = {f"of {name}": (name, "top") for name in FEET}
    return Structure(mesh, bodies, surfaces, joints)


def test_feet_that_pass_the_same_places_of_a_guide_share_their_stations():
    structure = two_feet_on_a_guide()
    along = np.array([1.0, 0.0, 0.0])
    joints = [sliding(pair_joint(structure, name, 2, 1), along) for name in structure.joints]
    shifts = SIZE * np.arange(STEPS)[:, None] * along
    travel = Travel("x", FEET, dict.fromkeys(structure.joints, (2, 1)), shifts)
    found = stations_of(structure, joints, [travel])
    assert found.element.size == APART + 2 + STEPS - 1
    centres = np.array(
        [
            np.bincount(found.station, found.share * along_one, found.element.size)
            for along_one in found.points
        ]
    ).T
    (place,) = found.place
    as_meshed = np.concatenate([joint.centre for joint in joints])
    assert np.allclose(centres[place], as_meshed + shifts[:, None], rtol=0.0, atol=1e-12)


def test_a_foot_that_would_pass_over_a_joint_that_stands_is_refused():
    """Both would press the same part of the guide; beside each other they may stand."""
    structure, along = two_feet_on_a_guide(), np.array([1.0, 0.0, 0.0])
    left, right = (pair_joint(structure, f"of {name}", 2, 1) for name in FEET)
    joints = [sliding(left, along), right]

    def found(steps):
        shifts = SIZE * np.arange(steps + 1)[:, None] * along
        return stations_of(structure, joints, [Travel("x", FEET[:1], {left.name: (2, 1)}, shifts)])

    assert found(APART - 2).element.size == APART
    with pytest.raises(InputError, match=r"60 mm .* 'of left' cover 4 cm2 of joint 'of right'"):
        found(APART - 1)
