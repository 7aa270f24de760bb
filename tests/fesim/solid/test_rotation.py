"""How a body turns at a point, and the tip of a tool that turns with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bars import shifted, two_bars
from hypothesis import given
from hypothesis import strategies as st
from moving_knee import coarse_data

from fesim.case.schema import case_from_data
from fesim.setup.discretised import displacement_rows
from fesim.simulate import simulate
from fesim.solid.rotation import rotation_rows
from fesim.solid.spaces import make_spaces
from meshes.milling_machine import box_milling_machine
from meshes.structure import Probe
from thermojoint.artefacts.errors import InputError

VECTORS = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
TOOL = {"tool_mm": [30.0, -120.0, 50.0], "tool_within_mm": 150.0}


@pytest.fixture(scope="module")
def machine():
    structure = box_milling_machine(element_size=0.2)
    return structure, make_spaces(structure.mesh)


def knee(**displacement):
    """The knee of the tests, whose point is B alone."""
    data = coarse_data() | {"displacement": {"point": "B"} | displacement}
    data["march"] |= {"duration_min": 2.0}
    data["axes"]["y"] |= {"rotation_within_mm": 150.0}
    return case_from_data(data, "knee", Path())


def rigid(spaces, turn, shift):
    places = spaces.displacement.doflocs.T
    return (np.array(shift) + np.cross(turn, places)).ravel()


@given(turn=VECTORS, shift=VECTORS)
def test_the_rotation_of_a_rigid_motion_is_its_own(machine, turn, shift):
    structure, spaces = machine
    rows = rotation_rows(structure, spaces, "B", 0.15)
    assert rows @ rigid(spaces, turn, shift) == pytest.approx(np.array(turn), abs=1e-9)


@pytest.mark.parametrize("shift", [(0.1, 0.7, 0.3), (-0.3, 0.1, 1.1), (2.3, -0.6, 0.9)])
def test_nodes_at_the_radius_turn_the_point_wherever_the_machine_is(shift):
    bars = two_bars()
    end = bars.probes["end"].position  # in a node; others are at 20 mm from it
    whole = rotation_rows(bars, make_spaces(bars.mesh), "end", 0.02)
    place = tuple(x + dx for x, dx in zip(end, shift, strict=True))
    moved = replace(shifted(bars, list(bars.bodies), shift), probes={"end": Probe(place, "right")})
    again = rotation_rows(moved, make_spaces(moved.mesh), "end", 0.02)
    np.testing.assert_allclose(again.toarray(), whole.toarray(), atol=1e-9)


@given(turn=VECTORS, shift=VECTORS)
def test_in_a_rigid_motion_the_tip_of_a_tool_moves_as_the_place_where_it_is(machine, turn, shift):
    structure, spaces = machine
    rows = displacement_rows(knee(**TOOL), structure, spaces)
    tip = np.array(structure.probes["B"].position) + 1e-3 * np.array(TOOL["tool_mm"])
    moved = shift + np.cross(turn, tip)
    assert rows @ rigid(spaces, turn, shift) == pytest.approx(moved, abs=1e-9)


def test_a_tool_is_a_lever_where_the_axis_stands_and_elsewhere():
    bare, tipped = (simulate(knee(**one), accuracy=False).response for one in ({}, TOOL))
    arm = 1e-3 * np.array(TOOL["tool_mm"])
    for name in ("", "asked_"):
        turned = np.cross(bare[f"{name}rotation"], arm)
        further = tipped[f"{name}displacement"] - bare[f"{name}displacement"]
        # The bases of the two differ.
        size = np.abs(turned).max()
        np.testing.assert_allclose(further, turned, rtol=0.0, atol=1e-4 * size)
        assert size > 1e-7
    assert "tip, (30, -120, 50) mm from B," in tipped.attrs["displacement_of"]


def test_from_the_point_itself_only_the_turning_moves_the_tip_of_a_tool():
    first = {"point": "B", "relative_to": "B"}
    own, tipped = (simulate(knee(**one), accuracy=False).response for one in (first, first | TOOL))
    assert not own["displacement"].values.any()
    assert not own["asked_displacement"].values.any()
    bare = simulate(knee(), accuracy=False).response
    turned = np.cross(bare["rotation"], 1e-3 * np.array(TOOL["tool_mm"]))
    size = np.abs(turned).max()
    # The bases of the two differ.
    np.testing.assert_allclose(tipped["displacement"], turned, rtol=0.0, atol=1e-4 * size)


def test_a_tool_without_its_place_or_the_nodes_that_turn_is_refused(machine):
    with pytest.raises(InputError, match="tool_within_mm"):
        knee(tool_mm=[0.0, 0.0, 1.0])
    with pytest.raises(InputError, match="take a larger radius"):
        displacement_rows(knee(**TOOL | {"tool_within_mm": 1.0}), *machine)
