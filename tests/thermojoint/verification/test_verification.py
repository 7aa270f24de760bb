"""The verification suite, its page, its JSON and its exit code."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT

from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.verification.check import Check
from thermojoint.verification.hot_spot import UNBOUNDED, square_plate_stress
from thermojoint.verification.report import markdown, results_data, shown
from thermojoint.verification.suite import Group, Result, run

PAGE = ROOT / "docs" / "verification.md"
FIELDS = ["name", "quantity", "unit", "reference", "computed", "relative_error", "tolerance"]

#: The loosest tolerance that the specification allows, by the beginning of a check's name.
LOOSEST = {
    "two bars,": 1e-6,
    "heat patch": 1e-9,
    "elastic patch": 1e-9,
    "expansion patch": 1e-9,
    "contact patch": 1e-9,
    "NAFEMS": 5e-3,
    "heat, ": 0.1,
    "elasticity, ": 0.1,
    "thermoelasticity, ": 0.1,
    "implicit Euler": 0.1,
    "conductance, exact, p/H": 5e-7,
    "conductance, ": 5e-4,
    "Barber's rod,": 1e-2,
    "two dissimilar rods,": 1e-3,
    "friction, block at": 1e-8,
    "friction, block round": 2e-3,
    "friction, column": 2e-5,
    "partial slip,": 1e-2,
    "condensed march,": 1e-9,
    "reduced march,": 1e-3,
    "splitting,": 0.1,
}


def named_on_page():
    """First cell of every row of the page's tables."""
    rows = [line for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| ")]
    return [row.split(" | ")[0].removeprefix("| ") for row in rows if "| quantity |" not in row]


@pytest.fixture(scope="session")
def results():
    """The whole suite, run once."""
    return list(run())


@pytest.fixture(scope="session")
def checks(results):
    """Every check by what the page calls it."""
    return {shown(check)[0]: check for result in results for check in result.checks}


@pytest.mark.parametrize("named", named_on_page())
def test_every_known_result_is_reproduced(checks, named):
    broken = {name: one.source for name, one in checks.items() if one.quantity == "broken off"}
    assert named in checks, broken
    check = checks[named]
    assert check.passed, f"{check.computed} instead of {check.reference}"


def test_the_page_lists_every_check_once(results, checks):
    assert sum(len(result.checks) for result in results) == len(checks)
    assert sorted(named_on_page()) == sorted(checks)


def test_no_two_checks_have_the_same_name(checks):
    assert len({check.name for check in checks.values()}) == len(checks)


def test_the_page_has_the_groups_and_their_explanations(results):
    """All but the digits of the computed values, which differ from machine to machine."""

    def skeleton(text):
        return [line for line in text.splitlines() if not line.startswith("| ")]

    assert skeleton(markdown(results)) == skeleton(PAGE.read_text("utf-8"))


@pytest.mark.parametrize(("begins", "loosest"), LOOSEST.items())
def test_no_tolerance_is_looser_than_specified(checks, begins, loosest):
    meant = [check for check in checks.values() if check.name.startswith(begins)]
    assert meant
    assert all(check.tolerance <= loosest for check in meant)


def test_the_json_has_the_fields_of_every_check(results):
    content = json.loads(json.dumps(results_data(results), allow_nan=False))
    assert list(content) == ["cases"]
    assert len(content["cases"]) == sum(len(result.checks) for result in results)
    for case in content["cases"]:
        assert list(case) == [*FIELDS, "source"]
        assert all(isinstance(case[name], str) for name in ("name", "quantity", "unit", "source"))
        numbers = [case[name] for name in FIELDS[3:]]
        assert all(isinstance(value, float) for value in numbers)
        assert case["relative_error"] <= case["tolerance"]


def example(**changes):
    made = Check("a rod", "temperature", "K", 20.0, 20.001, 1e-3, "closed form")
    return replace(made, relative_error=math.nan, scale=math.nan, **changes)


@pytest.fixture
def verify(monkeypatch, command):
    """Run `verify` on a group of checks (or what yields them) and one of checks after it.

    Gives exit code and standard output.
    """

    def run_on(checks, *arguments, after=()):
        first = checks if callable(checks) else lambda: checks
        groups = Group("Rods", first), Group("More rods", lambda: after)
        monkeypatch.setattr("thermojoint.verification.suite.GROUPS", groups)
        return command("verify", *arguments)[:2]

    return run_on


def test_all_within_tolerance_ends_with_0(verify, tmp_path):
    code, told = verify([example()], "--json", tmp_path / "v.json")
    assert code == 0
    assert "1 of 1 checks are within tolerance" in told
    (case,) = json.loads((tmp_path / "v.json").read_text())["cases"]
    assert case["name"] == "a rod"
    assert case["relative_error"] == pytest.approx(5e-5)


def test_one_wrong_reference_ends_with_1_and_is_named(verify, tmp_path):
    wrong = example(name="a wrong rod", reference=21.0)
    files = ["--json", tmp_path / "v.json", "--markdown", tmp_path / "v.md"]
    code, told = verify([example(), wrong], *files)
    assert code == 1
    assert "1 of 2 checks are within tolerance" in told
    assert "out of tolerance: a wrong rod" in told
    assert len(json.loads((tmp_path / "v.json").read_text())["cases"]) == 2
    assert "**out**" in (tmp_path / "v.md").read_text("utf-8")


@pytest.mark.parametrize("computed", [math.nan, math.inf])
def test_a_result_that_is_no_number_fails_and_is_still_valid_json(verify, tmp_path, computed):
    code, _ = verify([example(computed=computed)], "--json", tmp_path / "v.json")
    assert code == 1
    (case,) = json.loads((tmp_path / "v.json").read_text())["cases"]
    assert case["computed"] is None
    assert case["relative_error"] is None


@given(
    reference=st.floats(-1e6, 1e6).filter(lambda x: abs(x) > 1e-6),
    error=st.floats(-0.1, 0.1),
    tolerance=st.floats(1e-4, 0.05),
)
def test_a_check_passes_exactly_when_its_relative_error_is_within_tolerance(
    reference, error, tolerance
):
    check = Check("c", "q", "1", reference, reference * (1.0 + error), tolerance, "s")
    assert check.relative_error == pytest.approx(abs(error), abs=1e-12)
    assert check.passed == (check.relative_error <= tolerance)


def test_a_given_error_counts_instead_of_the_shown_values():
    check = Check("c", "q", "K", 1.0, 1.0, 1e-3, "s", relative_error=2e-3)
    assert not check.passed


@pytest.mark.parametrize(
    "change", [{"reference": 0.0}, {"tolerance": 0.0}, {"tolerance": math.nan}]
)
def test_a_check_without_a_measure_of_its_error_is_refused(change):
    with pytest.raises(ValueError, match="check 'a rod'") as caught:
        example(**change)
    assert "\n" not in str(caught.value)


def test_the_series_for_the_finite_plate_converges_and_tends_to_the_unbounded_one():
    coarse, fine = (square_plate_stress(10e-3, terms) for terms in (8, 16))
    assert coarse == pytest.approx(fine, rel=1e-7)
    excess = [square_plate_stress(width) / UNBOUNDED - 1.0 for width in (10e-3, 20e-3, 40e-3)]
    # The edge's stress falls like the square of its distance.
    assert excess[0] / excess[1] == pytest.approx(4.0, rel=0.02)
    assert excess[1] / excess[2] == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize(
    "error",
    [
        ConvergenceError("march: did not converge"),
        ValueError("zip() argument 2\nis shorter"),
        np.linalg.LinAlgError("Singular matrix"),
    ],
)
def test_a_group_that_breaks_off_fails_and_loses_no_other_check(verify, tmp_path, error):
    def breaking():
        yield example()
        raise error

    files = ["--json", tmp_path / "v.json", "--markdown", tmp_path / "v.md"]
    code, told = verify(breaking, *files, after=[example(name="another rod")])
    assert code == 1
    assert "2 of 3 checks are within tolerance" in told
    assert "out of tolerance: Rods: broken off" in told
    cases = json.loads((tmp_path / "v.json").read_text())["cases"]
    assert [case["name"] for case in cases] == ["a rod", "Rods: broken off", "another rod"]
    assert cases[1]["computed"] is None
    assert cases[1]["source"] == f"{type(error).__name__}: {' '.join(str(error).split())}"
    assert cases[1]["source"] in (tmp_path / "v.md").read_text("utf-8")


def test_a_group_passes_only_with_all_of_its_checks():
    good, bad = example(), example(reference=30.0)
    group = Group("Rods", lambda: [good, bad])
    (result,) = run([group])
    assert not result.passed
    assert Result(group, (good,)).passed
