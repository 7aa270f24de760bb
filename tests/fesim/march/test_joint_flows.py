"""Joint heat flows by factors that were made at other conductances."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fesim.march.joint_flows import TOLERANCE, freeze_flows, new_flows, solve_flows
from fesim.one_thread import MANY

cases = {"seed": st.integers(0, 2**32 - 1), "count": st.integers(1, 30)}


def influence(rng, count):
    """Temperature jumps per W: symmetric and positive definite, K/W."""
    modes, _ = np.linalg.qr(rng.normal(size=(count, count)))
    return (modes * 10.0 ** rng.uniform(-3.0, 0.0, count)) @ modes.T


def exact(jumps, conducted, jump):
    system = np.eye(conducted.size) + conducted[:, None] * jumps
    return np.linalg.solve(system, conducted * jump)


@settings(max_examples=150, derandomize=True)
@given(**cases, drift=st.sampled_from([0.01, 0.3, 1.0, 5.0]))
def test_they_solve_their_equations_however_far_the_conductances_have_drifted(seed, count, drift):
    rng = np.random.default_rng(seed)
    jumps, jump = influence(rng, count), rng.normal(size=count)
    then = 10.0 ** rng.uniform(-1.0, 3.0, count)
    now = then * np.exp(drift * rng.normal(size=count))
    now[rng.random(count) < 0.1] = 0.0  # open
    flows, flow = new_flows(count), np.empty(count)
    freeze_flows(jumps, then, flows)
    solve_flows(jumps, now, jump, flows, flow)
    lack = now * jump - flow - now * (jumps @ flow)
    assert np.abs(lack).max() <= TOLERANCE * np.abs(now * jump).max() * 10.0
    np.testing.assert_allclose(flow, exact(jumps, now, jump), rtol=1e-7, atol=1e-9)


def test_factors_are_made_at_first_and_kept_while_they_serve():
    rng, count = np.random.default_rng(3), 20
    jumps, jump = influence(rng, count), rng.normal(size=count)
    first = 10.0 ** rng.uniform(0.0, 1.0, count)
    flows, flow = new_flows(count), np.empty(count)
    solve_flows(jumps, first, jump, flows, flow)
    np.testing.assert_array_equal(flows.conducted, first)
    solve_flows(jumps, 1.1 * first, jump, flows, flow)
    np.testing.assert_array_equal(flows.conducted, first)
    far = first * np.exp(5.0 * rng.normal(size=count))
    solve_flows(jumps, far, jump, flows, flow)
    np.testing.assert_array_equal(flows.conducted, far)
    np.testing.assert_allclose(flow, exact(jumps, far, jump), rtol=1e-9, atol=1e-12)


def test_flows_of_many_contact_elements_continue_those_of_the_last_steps():
    """As exactly as others, also where the temperatures turn."""
    rng, count = np.random.default_rng(7), MANY
    roots = rng.normal(size=(count, 40))
    jumps, jump = np.diag(rng.uniform(0.1, 1.0, count)) + roots @ roots.T, rng.normal(size=count)
    then, turn = 10.0 ** rng.uniform(0.0, 1.0, count), rng.normal(size=count)
    flows, flow = new_flows(count), np.empty(count)
    for step in range(5):
        now, driven = (
            then * (1.0 + 0.02 * step),
            jump * (1.0 + 0.1 * step) * (turn if step > 3 else 1.0),
        )
        solve_flows(jumps, now, driven, flows, flow)
        lack = now * driven - flow - now * (jumps @ flow)
        assert np.abs(lack).max() <= 10.0 * TOLERANCE * np.abs(now * driven).max()
    np.testing.assert_array_equal(flows.last, flow)


def test_what_single_precision_cannot_factorise_is_solved_in_double_precision():
    """The bodies resist some flows a thousand million times as much as others."""
    rng, count = np.random.default_rng(5), 30
    modes, _ = np.linalg.qr(rng.normal(size=(count, count)))
    jumps, jump = (modes * np.logspace(-9.0, 0.0, count)) @ modes.T, rng.normal(size=count)
    conducted, flow = np.full(count, 1e9), np.empty(count)
    solve_flows(jumps, conducted, jump, new_flows(count), flow)
    true = exact(jumps, conducted, jump)
    np.testing.assert_allclose(flow, true, rtol=0.0, atol=1e-6 * np.abs(true).max())


def test_nothing_flows_where_nothing_drives():
    flow = np.ones(4)
    solve_flows(np.eye(4), np.ones(4), np.zeros(4), new_flows(4), flow)
    np.testing.assert_array_equal(flow, 0.0)
