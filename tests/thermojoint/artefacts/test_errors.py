"""Errors that name what is known."""

from thermojoint.artefacts.errors import MOST_NAMES, unknown_name


def test_a_message_lists_few_names_whole_and_of_many_the_first():
    few = unknown_name("probe", "zz", ["b", "a"], "case.toml: probes")
    assert str(few) == "case.toml: probes: no probe named 'zz'; known: a, b"
    many = [f"c{k:03}" for k in range(200)]
    text = str(unknown_name("probe", "zz", many, "case.toml"))
    assert text.endswith(f"c{MOST_NAMES - 1:03} and {200 - MOST_NAMES} more")
    assert "did you mean 'c150'?" in str(unknown_name("probe", "c150x", many, "case.toml"))
