"""Which readings are not accepted: channels judged by themselves, without any machine."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.sensor_faults import Channels, Sample, Thresholds, judge_sample, new_watch

CHANNELS = Channels(np.full(4, 0.03), np.full(4, -60.0), np.full(4, 200.0), 4)
RULES = Thresholds()
STEP = 2.0


def nothing_explained(innovation, _):
    """No heat that could change."""
    return innovation, 1e-3 * np.eye(4)


def followed(rows, predicted, step=STEP):
    """The verdict on every row of readings, with what the model says beside it."""
    watch, found = new_watch(4, RULES), []
    for k, (row, said) in enumerate(zip(rows, predicted, strict=True)):
        verdict = judge_sample(
            watch, Sample(step * k, row, said), nothing_explained, CHANNELS, RULES
        )
        watch = verdict.watch
        found.append(verdict)
    return found


def healthy(count=100, seed=0):
    """A machine that warms up, as a model knows it, and its noisy readings."""
    rng = np.random.default_rng(seed)
    said = np.outer(np.linspace(0.0, 20.0, count), [1.0, 0.5, 0.2, 0.1])
    return said + 0.03 * rng.normal(size=said.shape), said


def accepted(found):
    return np.array([one.accepted for one in found])


def test_healthy_channels_are_all_believed():
    assert accepted(followed(*healthy())).all()


@pytest.mark.parametrize(
    ("change", "within"),
    [
        (lambda values: np.full_like(values, -220.0), 0),
        (lambda values: values + 5.0, 0),
        (lambda values: values - 5.0, 0),
        (lambda values: values + 273.15, 0),
        (lambda values: np.full_like(values, values[0]), 15),
    ],
    ids=["broken wire", "5 K more", "5 K less", "kelvin for degrees", "stuck"],
)
def test_a_channel_that_lies_is_left_out_alone_and_soon(change, within):
    rows, said = healthy()
    rows[50:, 1] = change(rows[50:, 1])
    found = accepted(followed(rows, said))
    assert not found[50 + within :, 1].any()
    assert found[:, [0, 2, 3]].all()


def test_a_channel_comes_back_some_time_after_its_last_fault():
    rows, said = healthy()
    rows[40, 2] += 30.0
    found = accepted(followed(rows, said))
    away = round(RULES.clear / STEP)
    # The way back is as hasty as the way out.
    assert not found[40 : 41 + away, 2].any()
    assert found[42 + away :, 2].all()


def test_a_channel_that_is_off_stays_out_where_the_model_without_it_wanders_towards_it():
    rows, said = healthy(400)
    rows[50:, 0] += 5.0
    said[50:, 0] += np.minimum(np.linspace(0.0, 7.0, 350), 2.0)
    found = accepted(followed(rows, said))
    assert not found[50:, 0].any()
    assert found[:, 1:].all()
    # Jumped back, it need not be nearer than any other.
    rows[150:, 0] -= 5.5
    said[150:, 0] -= said[150, 0] - rows[150, 0] - 0.8
    found = accepted(followed(rows, said))
    assert found[150 + round(RULES.agreed / STEP) + 1 :, 0].all()


def test_a_jump_of_the_heat_does_not_clear_a_channel_that_is_off():
    rows, said = healthy(400)
    rows[50:, 0] += 5.0
    # The heat falls: the reading with it, the model without the reading four minutes later.
    rows[100:, 0] -= 4.8
    said[220:, 0] -= 4.8
    assert not accepted(followed(rows, said))[50:, 0].any()


def test_an_empty_channel_is_not_believed_and_shows_no_fault():
    rows, said = healthy()
    rows[30:60, 3] = np.nan
    found = accepted(followed(rows, said))
    assert not found[30:60, 3].any()
    assert found[60:].all()


def test_a_coarse_display_that_repeats_itself_is_not_stuck():
    rows, said = healthy(300)
    coarse = np.round(rows / 0.5) * 0.5
    assert accepted(followed(coarse, said)).all()


def test_a_coarse_display_that_stands_still_is_left_out_once_the_model_has_moved_on():
    rows, said = healthy(300)
    coarse = np.round(rows / 0.5) * 0.5
    coarse[100:, 0] = coarse[100, 0]
    assert not accepted(followed(coarse, said))[150:, 0].any()


def at_rest(seed=0, count=60):
    """A cold machine and its noisy readings, the third of which never changes."""
    rng = np.random.default_rng(seed)
    said = np.zeros((count, 4))
    rows = 0.03 * rng.normal(size=said.shape)
    rows[:, 2] = 0.01
    return rows, said


@pytest.mark.parametrize("seed", range(5))
def test_a_channel_that_is_stuck_from_before_the_start_has_no_noise_where_others_have(seed):
    found = accepted(followed(*at_rest(seed)))
    assert not found[30:, 2].any()
    assert found[:, [0, 1, 3]].all()


def test_a_channel_that_heat_has_not_reached_is_believed_where_nothing_has_noise():
    _, said = healthy()
    said[:, 2] = 0.0
    assert accepted(followed(said, said)).all()


def test_where_most_contradict_it_is_the_model_that_is_lost():
    rows, said = healthy()
    found = followed(rows + 8.0, said)
    assert found[0].lost
    assert found[0].accepted.all()
    one = rows.copy()
    one[:, 0] += 8.0
    assert not followed(one, said)[0].lost


def test_an_error_that_lasts_is_remembered_and_one_that_passes_is_forgotten():
    count = round(3.0 * RULES.lasts / STEP)
    rows, said = np.zeros((count, 4)), np.zeros((count, 4))
    rows[:, 0] = 0.5
    rows[:30, 1] = 0.5
    rows[:, 2] = 20.0
    *_, last = followed(rows, said)
    after, gone, distrusted, own = last.watch.lasting
    assert after == pytest.approx(0.5 * (1.0 - np.exp(-3.0)), rel=0.01)
    assert abs(gone) < 0.02 * after
    assert not last.accepted[2]
    assert abs(distrusted) < 0.02 * after
    assert abs(own) < 1e-12


def test_what_a_change_of_the_heat_explains_is_no_fault():
    rows, said = (values[:3] for values in healthy())

    def heat(innovation, _):
        """The first channel alone stands on a source, and the source may do anything."""
        rest = innovation.copy()
        rest[0] = 0.0
        return rest, 1e-3 * np.eye(4)

    rows[1, 0] += 4.0
    watch = followed(rows[:1], said[:1])[0].watch
    sample = Sample(STEP, rows[1], said[1])
    verdict = judge_sample(watch, sample, heat, CHANNELS, RULES)
    assert verdict.accepted.all()
    verdict = judge_sample(watch, sample, nothing_explained, CHANNELS, RULES)
    assert not verdict.accepted[0]


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_no_small_innovation_is_a_fault(departures):
    """Whatever the covariance says of itself: a model is not perfect."""
    small = RULES.gate * RULES.model_error / 2.0 * np.array(departures)
    sample = Sample(0.0, small, np.zeros(4))
    verdict = judge_sample(new_watch(4, RULES), sample, nothing_explained, CHANNELS, RULES)
    assert verdict.accepted.all()


@given(
    st.lists(
        st.lists(st.one_of(st.floats(-500.0, 500.0), st.just(np.nan)), min_size=4, max_size=4),
        min_size=1,
        max_size=30,
    )
)
def test_whatever_comes_a_verdict_is_given_and_the_watch_stays_sound(rows):
    said = np.zeros((len(rows), 4))
    for row, verdict in zip(rows, followed(np.array(rows), said), strict=True):
        assert not (verdict.accepted & np.isnan(row)).any()
        assert np.isin(verdict.watch.distrusted, (0.0, 1.0)).all()
        assert ((verdict.watch.repeat_rate >= 0.0) & (verdict.watch.repeat_rate <= 1.0)).all()
