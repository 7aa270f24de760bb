"""Readings become samples: in order, late, missing, by nothing but what arrives in which order."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermojoint.live.machine_state import ASSEMBLY
from thermojoint.live.samples import AssemblyRule, AssemblyState, assemble

PLAIN = AssemblyRule(interval=1.0, lateness=0.0, hold=0.0, wanted=2)
NAN = math.nan


def run(rule, told, state=None):
    """All samples that a stream leads to, and the verdicts."""
    state, samples, verdicts = state or AssemblyState(), [], []
    for time, values in told:
        step = assemble(rule, state, time, values)
        state = step.state
        samples += step.samples
        verdicts.append(step.verdict)
    return state, samples, verdicts


def test_a_whole_sample_is_closed_at_once_at_the_nearest_instant():
    told = [(100.0, (1.0, 2.0)), (100.8, (3.0, 4.0)), (102.3, (5.0, 6.0))]
    _, samples, _ = run(PLAIN, told)
    assert samples == [(100.0, (1.0, 2.0)), (101.0, (3.0, 4.0)), (102.0, (5.0, 6.0))]


@given(st.floats(1e9, 2e9), st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=40))
def test_a_source_that_wavers_misses_no_instant_wherever_in_the_second_it_tells(start, wavers):
    told = [(start + k + w, (1.0, 2.0)) for k, w in enumerate([0.0, *wavers])]
    _, samples, verdicts = run(PLAIN, told)
    assert set(verdicts) == {"taken"}
    np.testing.assert_array_equal(np.diff([at for at, _ in samples]), 1.0)


def test_readings_that_come_one_by_one_are_one_sample():
    _, samples, _ = run(PLAIN, [(100.0, (1.0, None)), (100.2, (None, 2.0))])
    assert samples == [(100.0, (1.0, 2.0))]


def test_one_reading_from_the_future_shuts_nobody_out_and_two_are_believed():
    state, samples = AssemblyState(), []
    for k in range(8):
        for time in [100.0 + k, 155.0] if k == 3 else [100.0 + k]:
            step = assemble(PLAIN, state, time, (1.0, 2.0), (100.0 + k, 160.0 + k))
            state, samples = step.state, samples + [at for at, _ in step.samples]
            assert (step.unconfirmed == 155.0) == (k == 4)
    assert samples == [100.0 + k for k in range(8)]
    assert ASSEMBLY.validate_python(json.loads(json.dumps(state))) == state
    for time in (155.0, 156.0):
        step = assemble(PLAIN, state, time, (1.0, 2.0), (108.0, 168.0))
        assert ASSEMBLY.validate_python(json.loads(json.dumps(step.state))) == step.state
        state = step.state
    assert [at for at, _ in step.samples] == [155.0, 156.0]


def test_what_was_not_told_in_time_is_missing():
    _, samples, _ = run(PLAIN, [(100.0, (1.0, None)), (101.0, (3.0, 4.0))])
    np.testing.assert_equal(samples, [(100.0, (1.0, NAN)), (101.0, (3.0, 4.0))])


def test_a_reading_said_to_be_missing_is_not_waited_for():
    _, samples, _ = run(PLAIN, [(100.0, (1.0, NAN))])
    np.testing.assert_equal(samples, [(100.0, (1.0, NAN))])


def test_a_late_reading_is_taken_within_the_lateness_and_left_out_after_it():
    patient = PLAIN._replace(lateness=3.0)
    told = [(100.0, (1.0, None)), (102.0, (5.0, 6.0)), (100.1, (None, 2.0)), (101.0, (3.0, 4.0))]
    _, samples, verdicts = run(patient, told)
    assert [values for _, values in samples] == [(1.0, 2.0), (3.0, 4.0), (5.0, 6.0)]
    assert set(verdicts) == {"taken"}
    _, samples, verdicts = run(PLAIN, told)
    assert [at for at, _ in samples] == [100.0, 102.0]
    assert verdicts[2:] == ["late", "late"]


def test_a_value_holds_for_as_long_as_it_is_said_to():
    told = [(100.0, (1.0, 2.0)), (101.0, (3.0, None)), (102.0, (4.0, None)), (103.0, (5.0, 6.0))]
    _, samples, _ = run(PLAIN._replace(hold=1.0), told)
    np.testing.assert_equal([one for _, (_, one) in samples], [2.0, 2.0, NAN, 6.0])


def test_a_probe_reading_joins_the_next_sample_and_holds_for_no_other():
    rule = PLAIN._replace(hold=10.0)
    told = [
        (100.0, (1.0, 2.0, None)),
        (100.1, (None, None, 7.0)),
        (101.0, (1.0, 2.0, None)),
        (102.0, (1.0, 2.0, None)),
    ]
    _, samples, verdicts = run(rule, told)
    np.testing.assert_equal([one for _, (*_, one) in samples], [NAN, 7.0, NAN])
    assert set(verdicts) == {"taken"}


@pytest.mark.parametrize("time", [NAN, math.inf, -1.0, 1e300])
def test_what_is_no_time_changes_nothing(time):
    state, samples, verdicts = run(PLAIN, [(time, (1.0, 2.0))])
    assert (state, samples, verdicts) == (AssemblyState(), [], ["no-time"])


def test_a_time_ahead_of_the_clock_does_not_shut_out_those_that_follow():
    step = assemble(PLAIN, AssemblyState(), 5e9, (1.0, 2.0), (1e9, 1e9))
    assert step.verdict == "ahead"
    assert run(PLAIN, [(100.0, (1.0, 2.0))], step.state)[1]


STREAMS = st.lists(
    st.tuples(
        st.floats(0.0, 40.0),
        st.lists(st.one_of(st.none(), st.floats(-5.0, 5.0), st.just(NAN)), min_size=3, max_size=3),
    ),
    max_size=60,
)
RULES = st.builds(
    AssemblyRule,
    interval=st.sampled_from([0.5, 1.0, 3.0]),
    lateness=st.sampled_from([0.0, 1.0, 7.0]),
    hold=st.sampled_from([0.0, 2.0]),
    wanted=st.sampled_from([2, 3]),
)


@given(RULES, STREAMS)
def test_samples_come_in_order_each_instant_once_and_none_is_older_than_a_late_one(rule, told):
    state, samples, verdicts = run(rule, told)
    at = [instant for instant, _ in samples]
    assert at == sorted(set(at))
    apart = np.diff(at) / rule.interval
    np.testing.assert_allclose(apart, np.rint(apart), atol=1e-9)
    assert len(state.open_samples) <= rule.lateness / rule.interval + 3
    assert verdicts.count("taken") >= len(samples)


@given(RULES, STREAMS, st.integers(0, 60))
def test_a_stream_that_is_interrupted_leads_to_the_same_samples(rule, told, cut):
    """What waits goes through the store and back in between."""
    _, whole, _ = run(rule, told)
    state, first, _ = run(rule, told[:cut])
    _, second, _ = run(rule, told[cut:], ASSEMBLY.validate_python(json.loads(json.dumps(state))))
    np.testing.assert_equal(first + second, whole)


@given(RULES, STREAMS)
def test_told_twice_changes_no_sample(rule, told):
    """As a broker does that was not acknowledged."""
    _, once, _ = run(rule, told)
    state, samples = AssemblyState(), []
    for one in told:
        for _ in range(2):
            step = assemble(rule, state, *one)
            state = step.state
            samples += step.samples
    np.testing.assert_equal(samples, once)
