"""The random marches of machines that move: what is drawn, and what counts as a failure."""

from benchmarks.moving_robustness import LEAVES, OUTSIDE, WELL, drawn, outcome


def test_what_is_drawn_follows_from_its_number_and_is_refused_where_it_must_be(tmp_path):
    for number, expected in ((0, OUTSIDE), (1, LEAVES)):
        found, data = drawn(number, tmp_path)
        assert found == expected
        assert outcome(found, data, tmp_path) == f"{expected}: refused"
        assert drawn(number, tmp_path)[1] == data


def test_a_march_that_should_be_refused_and_is_not_counts_as_wrong(tmp_path):
    expected, data = drawn(2, tmp_path)
    assert expected == WELL
    assert outcome(OUTSIDE, data, tmp_path) == f"{OUTSIDE}: not refused"
