"""The benchmark harness: what it writes, and small versions of what it measures."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import mesh_convergence
from benchmarks.against_calculix.compare import Ours, comparable
from benchmarks.against_calculix.problem import problem_of
from benchmarks.performance import calculix, closed_form, scaling, set_up, streaming
from benchmarks.performance.__main__ import GROUPS, main
from benchmarks.performance.calibration import finite_differences
from benchmarks.performance.cases import coarse_case, reference_case, with_elements
from benchmarks.performance.marching import march_row
from benchmarks.performance.pillar import pillar_case
from benchmarks.performance.report import BEGIN, END, TARGETS, cells, missed, write_markdown
from benchmarks.performance.timing import Row, Skipped, paired
from calibrate.linear import fit_ring
from estimator.fchs.stream import run
from fesim.joint.compiled_gap import compile_gap
from fesim.joint.gap import gap_problem
from fesim.joint.law import stiffness_at_rest
from fesim.setup import machine
from fesim.setup.parts import make_parts
from fesim.setup.structure import build_structure
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.models import ring_source
from thermojoint.models.assembly import assemble

ROW = Row("march-vs-refactor", 0.5, 200.0, 400.0, "s", "a note")


def two_rows():
    yield ROW
    yield Skipped("march-vs-calculix", "no ccx on the PATH")


def failing():
    yield replace(ROW, name="first")
    raise ConvergenceError("did not converge")


def measured_rows(path):
    return json.loads(path.read_text("utf-8"))["rows"]


def test_every_row_is_in_the_file_with_the_machine_it_was_measured_on(tmp_path):
    out = tmp_path / "bench.json"
    assert main(["--out", str(out)], {"two": two_rows}) == 0
    content = json.loads(out.read_text("utf-8"))
    assert content["rows"] == [vars(ROW)]
    assert set(content["rows"][0]) == {"name", "ours", "other", "ratio", "unit", "note"}
    assert {"cpu", "cores", "memory_GB", "threads", "versions"} <= set(content["machine"])
    assert content["machine"]["versions"]["numpy"] == np.__version__


def test_what_cannot_be_measured_is_reported_with_its_reason(tmp_path, capsys):
    out = tmp_path / "bench.json"
    main(["--out", str(out)], {"two": two_rows})
    skipped = json.loads(out.read_text("utf-8"))["skipped"]
    assert skipped == [{"name": "march-vs-calculix", "reason": "no ccx on the PATH"}]
    assert "skipped: no ccx on the PATH" in capsys.readouterr().out


def test_without_calculix_its_rows_are_skipped(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    found = list(calculix.rows())
    assert [type(one) for one in found] == 4 * [Skipped]
    assert all("ccx" in one.reason for one in found)


@pytest.mark.parametrize("coupling", calculix.NAMES)
def test_a_row_against_calculix_says_what_marched(coupling):
    case = calculix.long_case(coupling)
    ours = Ours(None, None, None, seconds=2.0, march_seconds=1.05)
    step, whole = calculix.compared("name", case, [(ours, calculix.Theirs(1.5, 1600.0))])
    assert (step.name, step.ours, step.other) == ("name-step", 1.0, 1500.0)
    assert (whole.name, whole.ours, whole.other) == ("name", 2.0, 1600.0)
    for row in (step, whole):
        assert f"ours {coupling}, full thermal order, gap equations in NumPy" in row.note


def test_the_law_of_the_comparison_with_calculix_is_not_machine_code():
    """Which is what the notes of its rows say."""
    law = comparable(problem_of(calculix.long_case("staggered")).law)
    laws = [(law, 1)]
    problem = gap_problem(1e-13 * np.eye(3), np.ones(3), np.ones(3), stiffness_at_rest(laws), None)
    assert compile_gap(problem, laws) is None


def test_a_failed_group_loses_no_other_row_and_shows_in_the_exit_code(tmp_path):
    out = tmp_path / "bench.json"
    assert main(["--out", str(out)], {"bad": failing, "two": two_rows}) == 1
    assert [row["name"] for row in measured_rows(out)] == ["first", ROW.name]
    assert "did not converge" in out.read_text("utf-8")


def test_only_the_groups_that_are_named_run(tmp_path):
    out = tmp_path / "bench.json"
    assert main(["--only", "two", "--out", str(out)], {"bad": failing, "two": two_rows}) == 0
    assert [row["name"] for row in measured_rows(out)] == [ROW.name]


def test_an_unknown_group_is_named_before_anything_runs(tmp_path, capsys):
    assert main(["--only", "calculx", "--out", str(tmp_path / "bench.json")], GROUPS) == 2
    assert "did you mean 'calculix'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_page_keeps_its_text_and_gets_the_new_table(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Title\n\n{BEGIN}\nold\n{END}\n\nThe end.\n", encoding="utf-8")
    results = list(two_rows())
    write_markdown(page, results)
    once = page.read_text("utf-8")
    assert once.startswith("# Title\n")
    assert once.endswith("The end.\n")
    assert "old" not in once
    assert "| `march-vs-refactor` | 0.5 | 200 | s | 400 | ratio ≥ 300 |" in once
    assert "- `march-vs-calculix`: skipped. no ccx on the PATH" in once
    write_markdown(page, results)
    assert page.read_text("utf-8") == once


def test_a_page_without_marks_is_refused_before_anything_runs(tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text("no marks\n", encoding="utf-8")
    with pytest.raises(InputError, match="bench: begin"):
        write_markdown(page, [ROW])
    out = tmp_path / "bench.json"
    assert main(["--out", str(out), "--markdown", str(page)], {"two": two_rows}) == 2
    assert "bench: begin" in capsys.readouterr().err
    assert not out.exists()


def test_a_missed_target_shows():
    slow = replace(ROW, ratio=299.0)
    assert missed(slow)
    assert "missed" in cells(slow)[-1]
    assert not missed(ROW)
    assert "missed" not in cells(ROW)[-1]
    assert not missed(replace(slow, name="a row without a target"))


def test_a_target_on_time_is_an_upper_bound():
    row = Row("calibration", 9.9, 20.0, 2.0, "s", "")
    assert not missed(row)
    assert missed(replace(row, ours=10.1))
    assert TARGETS["reproduce-kept"][0].text("s") == "ours ≤ 35 s"


def test_the_ratio_says_how_many_times_less_ours_takes():
    ours, other, ratio = paired(lambda: sum(range(100)), lambda: sum(range(100_000)), 3)
    assert ours < other
    assert ratio > 10.0


def test_eq2_in_closed_form_agrees_with_the_integral_it_is_timed_against():
    rows = list(closed_form.rows(repeats=1, accuracy=1e-6))
    assert [row.name for row in rows] == ["eq2-vs-quadrature", "eq2-vs-subtracted"]
    for row, allowed in zip(rows, (1e-5, 1e-10), strict=True):
        difference = float(row.note.partition("difference ")[2].split()[0])
        assert difference < allowed
        assert row.ratio > 1.0


@pytest.fixture(scope="module")
def estimator(hand_made_model):
    return assemble(hand_made_model, streaming.INTERVAL, 600.0)


@pytest.fixture(scope="module")
def measured():
    random = np.random.default_rng(0)
    return streaming.Measured(random.normal(0.0, 1.0, (60, 3)).cumsum(axis=0))


@pytest.mark.parametrize("way", [streaming.Blocks, streaming.Collapsed])
def test_the_convolutions_give_the_estimators_own_numbers(estimator, measured, way):
    """At every sample, not only at the one that is timed."""
    count = len(measured.values)
    times = streaming.INTERVAL * np.arange(1, count + 1)
    estimate, _ = run(estimator, times, measured.values[:, 0], measured.values[:, 1:])
    other = way(estimator, count)
    for i in range(count):
        delta_T, *temperatures = measured.row(i)
        linear, nonlinear = other.sample(delta_T, temperatures)
        scale = np.abs(estimate.total).max()
        assert np.abs(linear - estimate.linear[i]).max() < 1e-8 * scale
        assert np.abs(nonlinear - estimate.nonlinear[i]).max() < 1e-8 * scale


def test_the_estimators_rows_have_all_figures(estimator, measured):
    rows = list(streaming.per_sample(estimator, measured, 40, repeats=2))
    names = ["per-sample", "percentile", "collapsed"]
    assert [row.name for row in rows] == [f"estimator-{name}" for name in names]
    assert all(0.0 < row.ours < 1e5 and row.ratio > 0.0 for row in rows)
    mean, percentile = rows[0].ours, rows[1].ours
    assert percentile >= mean


def test_growth_compares_the_ends_of_one_run(estimator, measured, monkeypatch):
    """The last samples of a run with its first, the one that makes the matrix left out."""
    streamed = []

    def times(one, _, count):
        streamed.append((one, count))
        return np.arange(float(count))

    monkeypatch.setattr(streaming, "stream_times", times)
    growth, _ = streaming.growth(estimator, measured, few=10, repeats=2, many=50)
    assert streamed == [(estimator, 50), (estimator, 50)]
    assert growth.ours == pytest.approx(np.mean(range(40, 50)))
    assert growth.other == pytest.approx(np.mean(range(1, 11)))


def test_machine_code_is_compared_with_the_same_march(coarse_case):
    reduced = coarse_case.replace(march={"thermal": "reduced"})
    row = march_row(reduced, machine.set_up(reduced))
    assert row.name == "march-1050"
    assert float(row.note.partition("differ by ")[2].split()[0]) < 1e-12


def test_finite_differences_find_the_same_fit_without_a_gradient():
    t = np.arange(10.0, 2110.0, 10.0)
    parameters = (3.0, 3.2, 2e-4, 0.19, 0.12)
    data = ring_source.step_response(t, *parameters)
    exact, _ = fit_ring(t, data, starts=2)
    with finite_differences():
        found, _ = fit_ring(t, data, starts=2)
        assert not ring_source.step_response_gradient(t, *parameters)[1].any()
    assert found.a == pytest.approx(exact.a, rel=1e-4)
    assert found.r == pytest.approx(exact.r, rel=1e-4)
    assert ring_source.step_response_gradient(t, *parameters)[1].any()


def test_mesh_convergence_refuses_fewer_meshes_than_a_limit_takes(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["mesh_convergence.py", "--meshes", "2"])
    with pytest.raises(SystemExit, match="2"):
        mesh_convergence.main()
    assert "choose from 3, 4" in capsys.readouterr().err


def test_a_size_that_does_not_fit_into_memory_is_refused(monkeypatch):
    last = scaling.Size(22_452, 2_175, 27, 300, 3.0, 1.0, 0.2)
    monkeypatch.setattr(scaling, "free_memory", lambda: 2.0)
    assert "GB are free" in scaling.lacking_memory(25.0, last)
    monkeypatch.setattr(scaling, "free_memory", lambda: 2000.0)
    assert scaling.lacking_memory(25.0, last) is None


@pytest.mark.long
def test_the_largest_mesh_has_half_a_million_displacements():
    """Which is what the row of its memory says."""
    case = with_elements(reference_case(), scaling.ELEMENTS[-1], None)
    mesh = build_structure(case).mesh
    edges, corners = mesh.edges.shape[1], mesh.p.shape[1]
    assert 3 * (edges + corners) >= 500_000


def test_free_memory_is_in_gigabytes(tmp_path):
    table = tmp_path / "meminfo"
    table.write_text("MemTotal: 9000000 kB\nMemAvailable:    1000000 kB\n", encoding="ascii")
    assert scaling.free_memory(table) == pytest.approx(1.024)
    assert scaling.free_memory(tmp_path / "nothing") is None


@pytest.mark.long
def test_a_size_that_breaks_off_says_why():
    reason = scaling.measured(["--elements", "none"])
    assert isinstance(reason, str)
    assert "invalid float value: 'none'" in reason


def test_growth_is_told_against_the_smallest_size():
    small = scaling.Size(20_000, 2_000, 27, 300, 2.0, 1.0, 0.2)
    large = replace(small, unknowns=200_000, setup=30.0, repeats=3)
    rows = {row.name: row for row in scaling.against(large, small, "200k", 200_000)}
    setup = rows["scaling-setup-200k"]
    assert (setup.ours, setup.other) == (30.0, 2.0)
    assert setup.ratio == pytest.approx(2.0 / 30.0)
    assert "unknowns x 10.0, this x 15.0" in setup.note


@pytest.mark.long
def test_a_set_up_of_which_the_heat_changes_has_all_rows():
    rows = list(set_up.changed_rows(1, with_elements(coarse_case(), 160.0, None)))
    assert [row.name for row in rows] == [
        f"setup-changed-{name}" for name in ("source", "film", "probe")
    ]
    assert all(0.0 < row.ours < 100.0 and row.ratio > 0.0 for row in rows)


def test_the_pillar_has_five_joints_of_as_many_contact_elements(tmp_path):
    parts = make_parts(pillar_case(tmp_path, 3, 2, 3))
    assert [len(joint.area) for joint in parts.joints] == 5 * [6]
