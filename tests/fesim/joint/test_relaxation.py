"""Viscous relaxation: it says why a joint has no equilibrium, and agrees with Newton's method."""

import numpy as np
import pytest
from bars import surface_law
from random_joints import K_N, held_by_a_joint, random_problem

from fesim.joint.gap import TOLERANCE, solve_gap
from fesim.joint.relaxation import relax
from thermojoint.artefacts.errors import ConvergenceError


def test_it_ends_where_newtons_method_does():
    """With little friction there is one equilibrium only."""
    for seed in range(20):
        problem, thermal_gap = random_problem(seed, 4, 1e-5, 0.15)
        zero = np.zeros((3, 4))
        straight = solve_gap(problem, thermal_gap, zero[1:], zero)
        found, steps = relax(problem, thermal_gap, zero[1:], zero)
        assert steps > 1
        assert found.iterations > straight.iterations
        assert found.residual <= TOLERANCE
        np.testing.assert_allclose(found.gap, straight.gap, rtol=0.0, atol=1e-11)


def test_a_body_pulled_off_by_more_than_its_preload_has_come_loose():
    """Nothing but the joint holds it: the joint bears its preload and no more."""
    law = surface_law()
    problem = held_by_a_joint(law, np.eye(3) / K_N)
    zero = np.zeros((3, 1))
    for share in (0.9, 1.1):
        pulled = np.array([share * law.preload / K_N, 0.0, 0.0])
        if share < 1.0:
            found, _ = relax(problem, pulled, zero[1:], zero)
            assert found.traction.value[0, 0] == pytest.approx(-share * law.preload, rel=1e-6)
        else:
            with pytest.raises(ConvergenceError, match=r"moves by more than 1 m.*has come loose"):
                relax(problem, pulled, zero[1:], zero)


@pytest.mark.parametrize(
    ("spoil", "tolerance", "match"),
    [(np.nan, TOLERANCE, "not finite"), (1.0, 0.0, "wanted 0e\\+00 m")],
)
def test_what_cannot_be_solved_says_why(spoil, tolerance, match):
    problem, thermal_gap = random_problem(3, 4, 1e-5, 0.6)
    zero = np.zeros((3, 4))
    with pytest.raises(ConvergenceError, match=match) as caught:
        relax(problem, spoil * thermal_gap, zero[1:], zero, tolerance)
    assert "\n" not in str(caught.value)


def test_a_wedge_of_high_friction_snaps_once_and_then_slides():
    """Sliding opens it, which takes pressure off, which takes friction off.

    One contact element on springs a across, b along and c between, in units of the joint's: slip
    u opens the gap by n = -c u / (a + s), s the slope of the pressure. While it slides the force
    grows by (b + c (mu s - c) / (a + s)) u: where that is negative, no equilibrium is near.
    """
    friction, across, along, between = 3.0, 0.25, 1.0, -0.4
    law = surface_law(friction)
    stiffness = K_N * np.array([[across, between, 0.0], [between, along, 0.0], [0.0, 0.0, along]])
    compliance = np.linalg.inv(stiffness + np.diag(np.full(3, K_N)))
    problem = held_by_a_joint(law, compliance)
    gap, slip, snaps = np.zeros((3, 1)), np.zeros((2, 1)), []
    for load in np.linspace(0.0, 6.0, 61) * law.preload:
        thermal_gap = compliance @ np.array([0.0, load, 0.0])
        try:
            found = solve_gap(problem, thermal_gap, slip, gap)
        except ConvergenceError:
            steep = -float(law.normal.slope(gap[0])[0]) / K_N
            grows = along + between * (friction * steep - between) / (across + steep)
            assert grows < 0.0
            assert not slip.any()
            found, _ = relax(problem, thermal_gap, slip, gap)
            snaps.append(found.traction.slip[0, 0])
        gap, slip = found.gap, found.traction.slip
    assert len(snaps) == 1
    assert snaps[0] > 0.3e-6
    assert slip[0, 0] > 4e-6
