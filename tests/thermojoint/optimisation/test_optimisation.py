"""Design questions: known minima are found, limits hold, and a machine becomes better."""

import json

import numpy as np
import pytest
from batch_cases import case_text, tally
from in_process import run
from moving_knee import PATH

from fesim.batch.study import RangeSection
from fesim.simulate import simulate
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.optimisation.results import measured
from thermojoint.optimisation.search import Effort, search
from thermojoint.optimisation.settings import DesignFile, LimitSection

SPANS = [RangeSection(path=name, low=-2.0, high=3.0) for name in ("x", "y")]
QUESTION = """case = "machine.toml"
minimise = "joints.knee.preload_MPa"
ranges = [{ path = "joints.knee.preload_MPa", low = 1.0, high = 10.0, scale = "log" }]
limits = [{ figure = "displacement_x_peak_um", at_most = %s }]
"""


def bowl(rows):
    """(x - 1)² + (y + 1)² of rows of values, and x + y as a second figure."""
    at = np.array([[row["x"], row["y"]] for row in rows])
    return np.column_stack([((at - [1.0, -1.0]) ** 2).sum(axis=1), at.sum(axis=1)])


def question(tmp_path, limits=()):
    """A question about `bowl`: minimise the first figure within limits of the second."""
    (tmp_path / "machine.toml").touch()
    return DesignFile.model_construct(
        case=tmp_path / "machine.toml", ranges=SPANS, minimise="bowl", limits=list(limits)
    )


def found(given, effort):
    done = search(SPANS, bowl, lambda figures: measured(given, figures), effort)
    return done, done.rows[done.best()]


def test_the_bottom_of_a_bowl_is_found(tmp_path):
    _, values = found(question(tmp_path), Effort(population=20, generations=60))
    assert list(values.values()) == pytest.approx([1.0, -1.0], abs=0.05)


@pytest.mark.parametrize(
    ("limit", "at"),
    [({"at_least": 1.0}, [1.5, -0.5]), ({"at_most": -1.0}, [0.5, -1.5])],
)
def test_within_a_limit_the_nearest_point_on_it_is_found(tmp_path, limit, at):
    """On x + y = c the bowl is lowest at (1 + c/2, -1 + c/2)."""
    given = question(tmp_path, [LimitSection(figure="sum", **limit)])
    done, values = found(given, Effort(population=20, generations=80))
    assert list(values.values()) == pytest.approx(at, abs=0.1)
    assert done.measured[done.best(), 1] <= 0.0


def test_a_limit_that_nothing_holds_ends_with_the_least_excess(tmp_path):
    given = question(tmp_path, [LimitSection(figure="sum", at_most=-6.0)])
    done, values = found(given, Effort(population=20, generations=40))
    assert list(values.values()) == pytest.approx([-2.0, -2.0], abs=0.1)
    assert done.measured[done.best(), 1] > 0.0


def test_a_search_asks_for_each_case_once_and_again_for_the_same(tmp_path):
    given, effort = question(tmp_path), Effort(population=8, generations=6)
    first, again = (found(given, effort)[0] for _ in range(2))
    assert first.rows == again.rows
    assert len({tuple(row.items()) for row in first.rows}) == len(first.rows)


def test_a_search_goes_on_where_the_aim_is_mostly_constant(tmp_path):
    """The first generation agrees to a thousandth of the aim, not to a hundredth of its changes."""

    def raised(rows):
        return bowl(rows) + np.array([1e5, 0.0])

    effort = Effort(population=20, generations=60)
    done = search(SPANS, raised, lambda figures: measured(question(tmp_path), figures), effort)
    assert list(done.rows[done.best()].values()) == pytest.approx([1.0, -1.0], abs=0.4)
    assert 5 < len(done.sizes) < 60


def test_cases_without_a_result_are_passed_over(tmp_path):
    given = question(tmp_path, [LimitSection(figure="sum", at_most=10.0)])

    def half(rows):
        figures = bowl(rows)
        figures[figures[:, 1] < 0.5] = np.nan
        return figures

    done = search(SPANS, half, lambda figures: measured(given, figures), Effort(20, 60))
    assert list(done.rows[done.best()].values()) == pytest.approx([1.25, -0.75], abs=0.1)


def test_no_case_is_outside_its_range(tmp_path):
    """With five digits both ends of this range would be 1."""
    (narrow,) = spans = [RangeSection(path="x", low=1.000013, high=1.000024)]
    given = question(tmp_path)

    def line(rows):
        return np.array([[row["x"]] for row in rows])

    done = search(spans, line, lambda figures: measured(given, figures), Effort(5, 3))
    assert all(narrow.low <= row["x"] <= narrow.high for row in done.rows)


PEAK = "displacement_x_peak_um"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("optimisation")
    (folder / "machine.toml").write_text(case_text(1.0))
    return folder


def optimised(folder, limit):
    (folder / "question.toml").write_text(QUESTION % limit)
    effort = ("--population", 5, "--generations", 3, "--workers", 1)
    options = ("--out", folder / "out", "--json", folder / "found.json")
    code = run("optimise", folder / "question.toml", *options, *effort)
    return code, json.loads((folder / "found.json").read_text())


def test_the_least_preload_that_keeps_a_limit_is_checked_by_a_full_march(folder, capsys):
    code, content = optimised(folder, 1e3)
    assert code == 0
    # Every preload keeps this limit: the lowest of the cases is found.
    table = (folder / "out" / "summary.csv").read_text().splitlines()
    column = table[0].split(",").index("joints.knee.preload_MPa")
    preloads = [float(line.split(",")[column]) for line in table[1:]]
    assert content["found"]["joints.knee.preload_MPa"] == min(preloads)
    assert content["cases"] == len(preloads)
    moved = content["figures"][1]
    assert moved["full_march"] == pytest.approx(moved["found"], rel=1e-3)
    assert (folder / "out" / "optimisation.png").stat().st_size > 1000
    # A limit that no preload keeps: the same cases, none of them run again, and exit code 1.
    code, content = optimised(folder, 1e-3)
    assert code == 1
    assert set(tally(folder / "out")["started"].values()) == {1}
    assert not content["figures"][1]["holds"]
    assert "within the limit" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (QUESTION.replace("displacement_x_peak_um", "displacement_q_um"), "no figure named"),
        (QUESTION.replace("minimise", "maximise", 1) + 'minimise = "steps"\n', "either"),
        (QUESTION.replace(", at_most = %s", ""), "no bound"),
        (QUESTION.replace("at_most = %s", "at_most = 1.0, at_least = 2.0"), "below at_most"),
        (QUESTION.replace("at_most = %s", "at_least = -60.0"), "counts by its magnitude"),
        (QUESTION.replace("%s", "-60.0"), "counts by its magnitude"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused(folder, capsys, text, message):
    (folder / "bad.toml").write_text(text.replace("%s", "1.0"))
    assert run("optimise", folder / "bad.toml", "--out", folder / "none") == 2
    assert message in capsys.readouterr().err
    assert not (folder / "none").exists()


def test_a_given_design_with_a_zero_takes_part(tmp_path):
    """Without friction this machine moves half as far along y: no other case of these is better."""
    text = case_text(2.0)
    assert "friction_coefficient = 0.6" in text
    (tmp_path / "machine.toml").write_text(
        text.replace("friction_coefficient = 0.6", "friction_coefficient = 0.0")
    )
    (tmp_path / "question.toml").write_text(
        'case = "machine.toml"\nminimise = "displacement_y_peak_um"\n'
        'ranges = [{ path = "joints.knee.friction_coefficient", low = 0.0, high = 0.6 }]\n'
    )
    options = ("--out", tmp_path / "out", "--json", tmp_path / "found.json", "--workers", 1)
    effort = ("--population", 5, "--generations", 1)
    assert run("optimise", tmp_path / "question.toml", *options, *effort) == 0
    content = json.loads((tmp_path / "found.json").read_text())
    assert content["found"] == {"joints.knee.friction_coefficient": 0.0}
    assert content["figures"][0]["now"] == content["figures"][0]["found"]


def test_a_machine_with_axes_is_checked_by_an_iterated_march(tmp_path):
    """It has no march with all thermal unknowns; what is judged is the slope over its stroke."""
    text = PATH.read_text("utf-8")
    for old, new in (
        ("\nelement_size_mm = 50.0", "\nelement_size_mm = 100.0"),
        ("joint_element_size_mm = 25.0", "joint_element_size_mm = 50.0"),
        ("station_mm = 50.0", "station_mm = 100.0"),
        ("along = 8 ", "along = 4 "),
        ("across = 3", "across = 1"),
        ("step_s = 10.0", "step_s = 30.0"),
        ("duration_min = 60.0", "duration_min = 5.0"),
        ("moving_knee.csv", str(PATH.with_suffix(".csv"))),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "machine.toml").write_text(text)
    slope = "displacement_x_slope_y_final_um_per_m"
    question = (QUESTION % 1e3).replace("displacement_x_peak_um", slope)
    (tmp_path / "question.toml").write_text(question)
    options = ("--out", tmp_path / "out", "--json", tmp_path / "found.json", "--workers", 1)
    effort = ("--population", 5, "--generations", 1)
    assert run("optimise", tmp_path / "question.toml", *options, *effort) == 0
    moved = json.loads((tmp_path / "found.json").read_text())["figures"][1]
    assert moved["figure"] == slope
    assert moved["full_march"] == pytest.approx(moved["found"], rel=0.01)
    assert moved["found"] > 0.1


def test_adaptive_steps_are_checked_by_finer_ones(tmp_path):
    """Fixed steps of the response's spacing are off by 1 % of this displacement under a ramp."""
    text = case_text(20.0).replace('thermal = "full"\ncoupling = "staggered"', "")
    for old, new in (
        ("step_s = 2.0", 'step_s = 60.0\nmethod = "adaptive"'),
        ('kind = "step"', 'kind = "ramp"\nduration_min = 10.0'),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "machine.toml").write_text(text)
    code, content = optimised(tmp_path, 1e3)
    assert code == 0
    moved = content["figures"][1]
    assert moved["full_march"] == pytest.approx(moved["found"], abs=0.01)
    assert moved["full_march"] != moved["found"]


def test_what_was_found_is_reported_where_its_full_march_fails(folder, capsys, monkeypatch):
    def failing(case, **options):
        raise ConvergenceError("joint knee: no contact pressure")

    monkeypatch.setattr("fesim.simulate.simulate", failing)
    code, content = optimised(folder, 1e3)
    assert code == 1
    assert "no result: joint knee: no contact pressure" in capsys.readouterr().err
    least, moved = content["figures"]
    assert least["full_march"] == content["found"]["joints.knee.preload_MPa"]
    assert moved["full_march"] is None
    assert not moved["holds"]


def test_a_limit_that_only_the_full_march_breaks_is_told_apart(folder, capsys, monkeypatch):
    def hotter(case, **options):
        heat = case.heat_input.model_copy(update={"level": 2.0})
        return simulate(case.model_copy(update={"heat_input": heat}), **options)

    monkeypatch.setattr("fesim.simulate.simulate", hotter)
    code, content = optimised(folder, 5.0)
    assert code == 1
    moved = content["figures"][1]
    assert moved["found"] < 5.0 < moved["full_march"]
    assert "but its full march does not; take a limit with a margin" in capsys.readouterr().err


def test_a_file_of_others_in_its_folder_is_kept(folder, tmp_path, capsys):
    (folder / "question.toml").write_text(QUESTION % 1e3)
    (tmp_path / "optimisation.png").write_text("my notes\n")
    assert run("optimise", folder / "question.toml", "--out", tmp_path) == 2
    assert "optimisation.png: exists and is not a picture" in capsys.readouterr().err
    assert [one.read_text() for one in tmp_path.iterdir()] == ["my notes\n"]


@pytest.mark.parametrize(
    ("aim", "path", "low", "high", "reason"),
    [
        (PEAK, "joints.knee.preload_MPa", -10.0, -1.0, "5 are refused: joints.knee.preload_MPa"),
        (PEAK, "heat_input.level", 1e9, 1e10, "no case within the ranges has a result"),
        # A value is one of a case that fails, too, and yet no result.
        ("heat_input.level", "heat_input.level", 1e9, 1e10, "no case within the ranges has a res"),
    ],
)
def test_ranges_without_any_result_are_told(folder, capsys, aim, path, low, high, reason):
    (folder / "hopeless.toml").write_text(
        f'case = "machine.toml"\nminimise = "{aim}"\n'
        f'ranges = [{{ path = "{path}", low = {low}, high = {high} }}]\n'
    )
    effort = ("--population", 5, "--generations", 1, "--workers", 1)
    assert run("optimise", folder / "hopeless.toml", "--out", folder / path, *effort) == 2
    assert reason in capsys.readouterr().err


def test_json_on_standard_output_is_all_that_is_printed_there(folder, capsys):
    optimised(folder, 1e3)
    capsys.readouterr()
    effort = ("--population", 5, "--generations", 3, "--workers", 1)
    options = ("--out", folder / "out", "--json", "-")
    run("optimise", folder / "question.toml", *options, *effort)
    assert json.loads(capsys.readouterr().out)["found"]
