"""Many places at once: what the compiled sweep finds is what is found at each alone."""

from dataclasses import replace

import numpy as np
import pytest

from fesim.axes import mapping
from fesim.axes.corner_table import around
from fesim.axes.mapping import seen_from, surveyed
from fesim.axes.march import march_moving
from fesim.axes.setup import axis_inputs, set_up_axes
from fesim.case.schema import case_from_data
from fesim.joint import compiled_gap
from fesim.march.settling import displaced, initial_state, settle_along
from fesim.march.stepping import plainly_staggered
from thermojoint.verification.axis_chain import chain_data, on_axes

PLACES = np.random.default_rng(4).uniform((-0.3, -0.3, -0.1), (0.3, 0.3, 0.2), (40, 3))
#: Where all axes are aligned, at the ends of their strokes, and one place twice.
PLACES[:4] = (-0.3, -0.3, -0.1), (0.3, 0.3, 0.2), (0.1, 0.0, 0.0), (0.1, 0.0, 0.0)


@pytest.fixture(scope="module")
def warm(tmp_path_factory):
    """A chain whose pads stick across their guides and partly slide, after some hot steps."""
    folder = tmp_path_factory.mktemp("survey")
    at = {name: {"position_mm": 0.0} for name in "xyz"}
    data = on_axes(chain_data(folder, (0.0, 0.0, 0.0)), at)
    for joint in data["joints"].values():
        joint |= {"friction_coefficient": 0.15, "preload_MPa": 0.5}
    data["heat_input"]["level"] = 3.0
    data["march"] = {"step_s": 120.0, "duration_min": 20.0}
    case = case_from_data(data, "chain", folder)
    ready = set_up_axes(case)
    moving = ready.moving
    at_rest = initial_state(moving.machine)
    inputs = axis_inputs(case).at(120.0 * np.arange(1, 11))
    *_, track = march_moving(moving, ready.axes, inputs, plainly_staggered, at_rest)
    return moving, track.step(-1)


def one_by_one(moving, step, tolerance):
    """Displacements at the places by the plain method, and which contact elements slide."""
    alone = moving.guideway.elastic.alone(step.state.temperature)
    there = replace(step.state, change=np.zeros_like(step.state.change))
    found, slides = [], []
    for at in map(tuple, PLACES):
        contact = replace(moving.settling(at), gap_tolerance=tolerance)
        free = moving.guideway.free_at(at, alone)
        settled, _ = settle_along(contact, there, free[: there.gap.size])
        slides.append((settled.traction.slip != step.state.slip).any(axis=0))
        machine = replace(moving.machine, contact=contact)
        found.append(displaced(machine, free, settled, step.inputs)[1])
    return np.array(found), np.array(slides)


def test_a_sweep_finds_what_is_found_at_each_place_alone(warm, monkeypatch):
    moving, step = warm
    alone = []
    monkeypatch.setattr(mapping, "settle_along", lambda *a: alone.append(a) or settle_along(*a))
    exact, slides = one_by_one(moving, step, 1e-18)
    # Some stick and some slide, and which differs from place to place.
    assert slides.any()
    assert not slides.all()
    assert np.unique(slides, axis=0).shape[0] > 1
    seen = seen_from(moving, step, [tuple(at) for at in PLACES])
    assert np.abs(exact).max() > 1e-6
    assert np.allclose(seen.displacement, exact, rtol=0.0, atol=1e-14)
    assert seen.residual.max() <= moving.machine.contact.tolerance
    # Where the sweep does not converge the plain method takes over: seldom.
    assert len(alone) <= 4


@pytest.mark.parametrize("split", [None, 3])
def test_how_contact_elements_are_grouped_for_factors_does_not_matter(warm, monkeypatch, split):
    """Axis by axis, as one group, or in small ones of which each depends on its neighbours."""
    moving, step = warm
    places = [tuple(at) for at in PLACES]
    by_axis = seen_from(moving, step, places)
    held = moving.tables.held
    stations = moving.guideway.stations
    parts = np.split(held % stations.count, moving.tables.begin[1:-1])
    assert [set(part) for part in parts] == [set(group) for group in stations.groups]
    begin = np.unique([*range(0, held.size, split or held.size), held.size])
    monkeypatch.setattr(moving.tables, "begin", begin)
    plain = []
    monkeypatch.setattr(mapping, "settle_along", lambda *a: plain.append(a) or settle_along(*a))
    grouped = seen_from(moving, step, places)
    assert np.allclose(grouped.displacement, by_axis.displacement, rtol=0.0, atol=1e-14)
    assert len(plain) <= 4


def test_what_a_sweep_cannot_solve_is_left_to_the_plain_method(warm):
    """A tangent that is singular ends a sweep, not the simulation."""
    moving, step = warm
    contact, state = moving.machine.contact, step.state
    alone = np.full(len(moving.guideway.elastic.thermal), np.nan)
    found = surveyed(contact, moving.tables, (state.gap, state.slip), alone, PLACES)
    assert np.isnan(found.residual).all()


def test_the_order_of_the_places_does_not_matter(warm):
    moving, step = warm
    places = [tuple(at) for at in PLACES]
    forth, back = (seen_from(moving, step, one).displacement for one in (places, places[::-1]))
    assert np.allclose(forth, back[::-1], rtol=0.0, atol=1e-14)


def test_places_with_too_many_combinations_are_taken_in_parts(warm, monkeypatch):
    moving, step = warm
    places = [tuple(at) for at in PLACES]
    whole = seen_from(moving, step, places).displacement
    monkeypatch.setattr(mapping, "AT_ONCE", 20 * moving.tables.each)
    parts = seen_from(moving, step, places)
    assert np.allclose(parts.displacement, whole, rtol=0.0, atol=1e-14)


def test_a_law_that_is_not_built_in_settles_place_by_place(warm, monkeypatch):
    moving, step = warm
    places = [tuple(at) for at in PLACES[:6]]
    compiled = seen_from(moving, step, places)
    monkeypatch.setattr(compiled_gap, "compile_gap", lambda *_: None)
    plain = seen_from(moving, step, places)
    assert np.allclose(plain.displacement, compiled.displacement, rtol=0.0, atol=1e-12)
    assert plain.residual.max() <= moving.machine.contact.tolerance


def test_no_place_is_no_error(warm):
    moving, step = warm
    seen = seen_from(moving, step, [])
    assert seen.displacement.shape == (0, step.displacement.size)


def test_what_is_around_a_place_is_what_its_stations_say(warm):
    stations = warm[0].guideway.stations
    found = around(stations, PLACES)
    assert len(set(found.corners)) == len(found.corners)
    for at, touched, weight in zip(PLACES, found.touched, found.weight, strict=True):
        mine = {
            found.corners[k]: share for k, share in zip(touched, weight, strict=True) if share > 0.0
        }
        expected = dict(stations.corners(tuple(at)))
        assert mine.keys() == expected.keys()
        assert np.allclose([mine[one] for one in expected], list(expected.values()), atol=1e-12)
