"""The placement rule on responses whose right answer is known by construction."""

import numpy as np
import pytest

from calibrate.placement.fchs import (
    RULE,
    Rule,
    choose_heat_pair,
    rank_joint_sensors,
    sources_for,
    with_roles,
)
from calibrate.responses import candidates_in
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import make_response
from thermojoint.models import deformation, ring_source
from thermojoint.models.parameters import DeformationModel, RingModel

TIMES = 4.0 * np.arange(226)
LEVELS = (0.5, 1.0, 2.0)
SHAPE = DeformationModel(1e-6, -8e-5, -5e-8, 0.009, 0.0013, 0.01)
#: Difference that Eq. 2 describes exactly, K at the reference step.
RING = RingModel(K=8.0, a=3.2, alpha=2.1e-4, r=0.19, r0=0.12)
#: Common to all sensors near the source: no ring, and out of every difference.
COMMON = 3.0 * TIMES / TIMES[-1]
AXES = ["x"]


def ring(**changed):
    """Step response of the ring source, K."""
    values = vars(RING) | changed
    return ring_source.step_response(TIMES, **values)


def response(level, temperatures, displacement=None, positions=None, contacts=((0.0, 0.0, 0.0),)):
    """A response to a step of `level` with the given temperatures (K, by probe)."""
    names = list(temperatures)
    at = [(positions or {}).get(name, (k, 0.0, 0.0)) for k, name in enumerate(names)]
    moved = (
        level * deformation.step_response(TIMES, SHAPE) if displacement is None else displacement
    )
    return make_response(
        {
            "heat_input": np.where(TIMES > 0.0, level, 0.0),
            "temperature": np.column_stack(list(temperatures.values())),
            "displacement": moved[:, None],
            "probe_position": np.array(at, dtype=float),
            "contact_position": np.array(contacts, dtype=float),
        },
        {"time": TIMES, "probe": names, "axis": AXES},
        {"title": "synthetic"},
    )


def near_source(unit, bend=None):
    """Responses at all levels; `unit` maps a probe to its rise over the common one, per unit.

    A probe in `bend` rises by a further share of itself per unit of heat above the reference.
    """
    bend = bend or {}
    made = {
        level: response(
            level,
            {
                name: level * (COMMON + rise * (1.0 + bend.get(name, 0.0) * (level - 1.0)))
                for name, rise in unit.items()
            },
        )
        for level in LEVELS
    }
    return made.pop(1.0), made


def choose(base, others, **how):
    names = [str(p) for p in base["probe"].to_numpy()]
    return choose_heat_pair(base, others, {"x": SHAPE}, names, **how)


def test_the_pair_that_eq_2_describes_is_found_warmer_first():
    pair = choose(*near_source({"cold": 0.0 * TIMES, "hot": ring()}))
    assert (pair.a, pair.b) == ("hot", "cold")
    assert pair.difference == pytest.approx(ring()[-1])
    assert pair.disproportion < 1e-12
    assert pair.ring_error < 1e-6
    # Only regularisation stands between this pair and the exact linear displacement.
    largest = 2.0 * np.abs(deformation.step_response(TIMES, SHAPE)).max()
    assert 0.0 < pair.displacement_error < 0.02 * largest


@pytest.mark.parametrize("bend", [2.0 * RULE.proportional, -2.0 * RULE.proportional])
def test_a_better_but_disproportionate_difference_is_never_chosen(bend):
    unit = {"cold": 0.0 * TIMES, "hot": ring(), "bent": ring(K=3.0 * RING.K, r=0.15)}
    straight = choose(*near_source(unit))
    assert "bent" in (straight.a, straight.b)  # it wins where it is proportional
    chosen = choose(*near_source(unit, {"bent": bend}))
    assert (chosen.a, chosen.b) == ("hot", "cold")
    assert chosen.disproportion < RULE.proportional


def test_where_no_pair_is_proportional_the_least_bent_is_taken_and_its_bend_is_stated():
    unit = {"cold": 0.0 * TIMES, "hot": ring(), "bent": ring(K=3.0 * RING.K, r=0.15)}
    chosen = choose(*near_source(unit, {"bent": 0.3, "hot": 0.01}))
    assert (chosen.a, chosen.b) == ("hot", "cold")
    assert chosen.disproportion == pytest.approx(0.01, rel=0.01)


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_the_size_of_the_temperatures_does_not_matter(scale):
    unit = {"cold": 0.0 * TIMES, "hot": ring(), "far": ring(r=0.3)}
    chosen = choose(*near_source({name: scale * rise for name, rise in unit.items()}))
    assert (chosen.a, chosen.b) == ("hot", "cold")


def test_of_two_proportional_pairs_the_one_whose_displacement_is_right_wins_not_the_faster():
    # Halts for minutes, as no single ring does.
    halting = 3.0 * ring(r=0.125, alpha=2e-3)
    halting *= 1.0 - 0.3 * np.exp(-((TIMES - 300.0) ** 2) / 2e4)
    halting = np.maximum.accumulate(halting)
    smooth = ring(r=0.15)
    assert halting[15] / halting[-1] > 2.0 * smooth[15] / smooth[-1]
    cold = 0.0 * TIMES
    alone = choose(*near_source({"cold": cold, "halting": halting}))
    both = choose(*near_source({"cold": cold, "halting": halting, "smooth": smooth}))
    assert (alone.a, alone.b) == ("halting", "cold")
    assert (both.a, both.b) == ("smooth", "cold")
    assert both.displacement_error < 0.1 * alone.displacement_error


@pytest.mark.parametrize("every", [1, 2, 3])
def test_how_fast_a_pair_answers_is_judged_by_the_clock_not_by_samples(every):
    """After a hundredth of the run one is ahead, after 15 samples the other."""
    ahead = 8.0 * (0.6 * (1.0 - np.exp(-TIMES / 8.0)) + 0.4 * (1.0 - np.exp(-TIMES / 900.0)))
    behind = 8.0 * (1.0 - np.exp(-TIMES / 40.0))
    base, others = near_source({"cold": 0.0 * TIMES, "ahead": ahead, "behind": behind})
    thinned = slice(None, None, every)
    base = base.isel(time=thinned)
    others = {level: response.isel(time=thinned) for level, response in others.items()}
    assert choose(base, others, rule=Rule(shortlist=1)).a == "ahead"


@pytest.mark.parametrize(
    ("rise", "bend"),
    [
        (ring(r=0.15), 3.0),
        (8.0 * np.exp(-(((TIMES - 300.0) / 200.0) ** 2)), 0.0),
    ],
    ids=["disproportionate", "falls again"],
)
def test_no_pair_that_fulfils_the_rule_is_an_error_that_says_what_to_do(rise, bend):
    with pytest.raises(InputError, match=r"give more \[\[candidates\]\] around the source"):
        choose(*near_source({"cold": 0.0 * TIMES, "hot": rise}, {"hot": bend}))


def test_no_or_one_candidate_near_the_source_is_refused():
    base, others = near_source({"cold": 0.0 * TIMES, "hot": ring()})
    for candidates in ([], ["hot"]):
        with pytest.raises(InputError, match="placement"):
            choose_heat_pair(base, others, {"x": SHAPE}, candidates)


FAST = 1.0 - np.exp(-TIMES / 60.0)
LATE = np.sin(TIMES / 200.0) ** 2
OTHER = np.sin(TIMES / 90.0)
#: Along the joint (y): "low" and "high" see what moves the joint, "stray" something else; "twin"
#: sees what "high" sees, too close to "low"; "faint" sees it below its uncertainty.
PLACES = {
    "high": (0.65, 0.7, 0.1),
    "low": (0.65, 0.4, 0.1),
    "twin": (0.65, 0.4 + 0.9 * RULE.apart * 0.5, 0.1),
    "stray": (0.65, 0.55, 0.1),
    "faint": (0.65, 0.9, 0.1),
}
EXTENT = 0.5


def at_joint():
    """Responses whose nonlinear displacement is a filtered "low" less a filtered "high"."""
    made = {}
    for level in LEVELS:
        off = level * (level - 1.0)
        seen = {
            "high": 6.0 * LATE,
            "low": 6.0 * FAST,
            "twin": 6.0 * LATE,
            "stray": 6.0 * OTHER,
            "faint": 0.4 * RULE.deviation_uncertainty * LATE,
        }
        temperatures = {name: level * COMMON + off * part for name, part in seen.items()}
        moved = level * deformation.step_response(TIMES, SHAPE) + off * 1e-6 * (FAST - 2.0 * LATE)
        contacts = [(0.65, y, 0.1) for y in (0.37, 0.46, 0.55, 0.64, 0.73)]
        made[level] = response(level, temperatures, moved, PLACES, contacts)
    return made.pop(1.0), made


@pytest.fixture(scope="module")
def ranked():
    return list(rank_joint_sensors(*at_joint(), list(PLACES)))


def test_the_pair_that_sees_what_moves_the_joint_comes_first_the_lower_one_as_T1(ranked):
    assert ranked[0].probes == ("low", "high")
    assert ranked[0].misfit < 0.5 * ranked[1].misfit
    # Of the pair's two largest deviations, at heat input 2 (off = 2), the smaller.
    assert ranked[0].signal == pytest.approx(12.0 * min(FAST.max(), LATE.max()))


def test_pairs_come_by_misfit_and_pairs_with_a_faint_sensor_last(ranked):
    clear = [pair.misfit for pair in ranked if "faint" not in pair.probes]
    faint = [pair.misfit for pair in ranked if "faint" in pair.probes]
    assert [pair.misfit for pair in ranked] == sorted(clear) + sorted(faint)
    assert len(faint) == len(PLACES) - 1
    assert min(faint) < max(clear)  # so that it is not the misfit that puts them last
    for pair in ranked:
        weak = pair.signal < RULE.deviation_uncertainty
        assert weak == ("faint" in pair.probes)


def test_every_two_sensors_that_are_apart_are_ranked_once_and_no_others(ranked):
    found = [frozenset(pair.probes) for pair in ranked]
    expected = {
        frozenset((one, two))
        for one in PLACES
        for two in PLACES
        if np.linalg.norm(np.subtract(PLACES[one], PLACES[two])) >= RULE.apart * EXTENT
    }
    assert len(found) == len(set(found))
    assert set(found) == expected
    assert frozenset(("low", "twin")) not in expected


def test_the_order_of_the_candidates_does_not_matter(ranked):
    again = list(rank_joint_sensors(*at_joint(), list(PLACES)[::-1]))
    assert again[0].probes == ranked[0].probes
    assert [p.misfit for p in again] == pytest.approx([p.misfit for p in ranked])


def test_any_number_of_sensors_is_ranked_and_one_sees_least(ranked):
    one, three = (next(rank_joint_sensors(*at_joint(), list(PLACES), count)) for count in (1, 3))
    assert (len(one.probes), len(three.probes)) == (1, 3)
    assert max(three.misfit, ranked[0].misfit) < one.misfit


@pytest.mark.parametrize("scale", [0.1, 10.0])
def test_the_size_of_the_joint_does_not_matter(ranked, scale):
    base, others = at_joint()
    for one in (base, *others.values()):
        one["probe_position"][:] = scale * one["probe_position"]
    assert list(rank_joint_sensors(base, others, list(PLACES))) == ranked


def doubled(response):
    """The response of a proportional structure to twice the heat."""
    more = response.copy(deep=True)
    for name in ("heat_input", "temperature", "displacement"):
        more[name][:] = 2.0 * response[name]
    return more


def test_the_level_of_the_reference_step_does_not_matter(ranked):
    base, others = near_source({"cold": 0.0 * TIMES, "hot": ring(), "far": ring(r=0.3)})
    del others[2.0]
    one, two = choose(base, others), choose(doubled(base), others)
    assert (one.a, one.b, one.difference) == (two.a, two.b, two.difference)
    # At the larger step the error is larger, and no other step is as large as the reference.
    assert two.displacement_error == pytest.approx(2.0 * one.displacement_error)
    base, others = at_joint()
    assert list(rank_joint_sensors(doubled(base), others, list(PLACES))) == ranked


def test_an_axis_that_hardly_deviates_does_not_rank_the_pairs(ranked):
    base, others = at_joint()
    # z moves as x does, but in proportion to the heat input, and a picometre beside it.
    base = base.sel(axis=["x", "x"]).assign_coords(axis=["x", "z"])
    linear = base["displacement"].to_numpy()[:, 1]
    for level, one in others.items():
        both = one.sel(axis=["x", "x"]).assign_coords(axis=["x", "z"]).copy(deep=True)
        both["displacement"][:, 1] = level * linear + 1e-12 * OTHER
        others[level] = both
    again = list(rank_joint_sensors(base, others, list(PLACES)))
    assert [pair.probes for pair in again] == [pair.probes for pair in ranked]
    assert [pair.misfit for pair in again] == pytest.approx([pair.misfit for pair in ranked])


def test_a_displacement_without_deviation_cannot_rank_pairs():
    base, others = near_source({name: ring() for name in PLACES})
    with pytest.raises(InputError, match="proportional to the heat input"):
        list(rank_joint_sensors(base, others, list(PLACES)))


def test_without_contact_elements_there_is_no_place_for_a_source():
    base, _ = at_joint()
    for bare in (base.drop_vars("contact_position"), base.isel(contact=slice(0))):
        with pytest.raises(InputError, match="no contact elements"):
            sources_for(bare, ("low", "high"))


def test_each_source_lies_at_the_contact_element_nearest_to_its_sensor():
    base, _ = at_joint()
    sources, distances = sources_for(base, ("low", "high"))
    assert sources == pytest.approx(np.array([[0.65, 0.37, 0.1], [0.65, 0.73, 0.1]]))
    assert distances == pytest.approx(np.array([[0.03, 0.33], [0.33, 0.03]]))


def test_roles_are_further_names_for_probes_that_keep_theirs():
    base, _ = at_joint()
    named = with_roles(base, {"T1": "low", "T2": "high"})
    assert {str(p) for p in named["probe"].to_numpy()} == {*PLACES, "T1", "T2"}
    for role, probe in (("T1", "low"), ("T2", "high"), *((name, name) for name in PLACES)):
        for variable in ("temperature", "probe_position"):
            assert np.array_equal(named[variable].sel(probe=role), base[variable].sel(probe=probe))
    assert named["displacement"].identical(base["displacement"])
    assert named.attrs == base.attrs
    again = with_roles(named, {"T1": "high", "T2": "low"})
    assert again.sizes["probe"] == named.sizes["probe"]
    assert np.array_equal(
        again["temperature"].sel(probe="T1"), base["temperature"].sel(probe="high")
    )


def test_without_boxes_every_probe_is_a_candidate_and_the_nearer_half_at_the_joint(coarse_response):
    names, at_joint = candidates_in(coarse_response)
    assert names == ["a", "b", "T1", "T2"]
    assert sorted(at_joint) == ["T1", "T2"]
    assert candidates_in(coarse_response.drop_vars("contact_position")) == (names, [])
