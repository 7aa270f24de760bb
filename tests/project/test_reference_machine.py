"""The study of the reference machine: what is read off responses, and how it is scored."""

import numpy as np
import pytest

from benchmarks.reference_machine import observables, score
from benchmarks.reference_machine.__main__ import HERE, STUDIES
from benchmarks.reference_machine.table import INPUTS, Machine, as_markdown, machines_of, scored
from fesim.batch.folder import response_path
from fesim.batch.study import read_study
from thermojoint.artefacts.response import make_response, write_response

LEVELS = {"0.5": 0.5, "1.0": 1.0, "2.0": 2.0, "3.0": 3.0}
TIMES = np.arange(0.0, 2101.0, 10.0)
LADDER = [f"e{k}" for k in range(1, 10)]


def quadratic_machine(level, heat=None):
    """Proportional displacement and temperature, plus a part quadratic in the heat input.

    At heat input 3: 250 µm along y, of it 30 µm beyond proportionality; pressures settle with 20 s.
    """
    grown = -np.expm1(-TIMES / 300.0)
    linear, square = 215.0 / 3.0, 5.0
    total = 1e-6 * grown * (linear * level + square * level**2)
    settled = -np.expm1(-TIMES / 20.0)
    return make_response(
        {
            "heat_input": np.full(TIMES.size, level) if heat is None else heat,
            "temperature": np.multiply.outer(grown, np.linspace(1.0, 9.0, 9)) * level,
            "displacement": np.stack((0.0 * total, total, 0.0 * total), axis=1),
            "pressure": 1e6 * (4.0 + np.outer(settled, [2.0, -1.0]) * level),
        },
        {"time": TIMES, "probe": LADDER, "axis": ["x", "y", "z"], "contact": [1, 2]},
    )


@pytest.fixture(scope="module")
def responses():
    found = {name: quadratic_machine(level) for name, level in LEVELS.items()}
    heat = 2.0 * np.interp(TIMES, [0.0, 300.0, 600.0], [0.0, 1.0, 0.0])
    return found | {"triangle": quadratic_machine(0.0, heat)}


def test_a_quadratic_machine_has_the_printed_ratios(responses):
    seen = observables.observables_of(responses)
    assert seen["ratio_half"] == pytest.approx(-0.125, rel=1e-9, abs=0)
    assert seen["ratio_three"] == pytest.approx(3.0, rel=1e-9, abs=0)
    grown = -np.expm1(-7.0)
    assert seen["total_um"] == pytest.approx(260.0 * grown, rel=1e-9, abs=0)
    assert seen["nonlinear_um"] == pytest.approx(30.0 * grown, rel=1e-9, abs=0)
    assert seen["from_vertical_deg"] == pytest.approx(0.0, abs=1e-9)


def test_a_temperature_in_proportion_to_the_heat_deviates_nowhere(responses):
    assert observables.observables_of(responses)["deviation_K"] == pytest.approx(0.0, abs=1e-9)


def test_the_triangle_deviates_by_what_superposition_does_not_explain(responses):
    # The fake triangle stays cold: all that the superposed reference predicts is its deviation.
    seen = observables.observables_of(responses)
    assert seen["triangle_K"] == pytest.approx(seen["triangle_top_K"], rel=1e-9, abs=0)
    assert seen["triangle_K"] > 1.0


def test_only_pressures_that_rise_count(responses):
    shares = observables.pressure_shares(responses["2.0"])
    assert shares == pytest.approx([-np.expm1(-3.0)], rel=1e-6, abs=0)


def test_half_of_an_exponential_is_reached_after_ln_2_time_constants():
    curve = np.outer(-np.expm1(-TIMES / 200.0), [-3.0, 4.0])
    expected = 200.0 * np.log(2.0)
    assert observables.half_time(TIMES, curve) == pytest.approx(expected, rel=1e-3, abs=0)
    late = (np.exp(-9.0) - np.exp(-10.5)) / -np.expm1(-10.5)
    assert observables.late_change(TIMES, curve) == pytest.approx(late, rel=1e-9, abs=0)


def test_the_printed_tables_say_what_the_statements_say():
    printed = {one.name: one.printed for one in (*score.STATEMENTS, *score.TOLD)}
    linear = observables.printed_displacement(TIMES)
    nonlinear = observables.printed_nonlinear(TIMES)
    assert observables.half_time(TIMES, linear) == pytest.approx(printed["half_time_s"], rel=0.01)
    assert observables.late_change(TIMES, linear) == pytest.approx(printed["late_change"], rel=0.02)
    assert observables.half_time(TIMES, nonlinear) == pytest.approx(
        printed["nonlinear_half_time_s"], rel=0.05
    )
    assert observables.from_vertical(linear[-1]) == pytest.approx(
        printed["from_vertical_deg"], abs=0.5
    )
    assert observables.from_vertical(nonlinear[-1]) == pytest.approx(
        printed["nonlinear_from_vertical_deg"], abs=0.5
    )


def test_the_papers_machine_scores_zero_and_one_without_values_scores_worst():
    printed = {one.name: one.printed for one in score.STATEMENTS}
    assert score.score(printed) == pytest.approx(0.0, abs=1e-12)
    unknown = dict.fromkeys(printed, np.nan)
    assert score.score(unknown) == pytest.approx(score.WORST, rel=1e-12, abs=0)


def test_a_miss_is_counted_in_tolerances_and_capped():
    assert score.by_factor(250.0 * 1.2, 250.0, 1.2) == pytest.approx(1.0)
    assert score.by_factor(250.0 / 1.2, 250.0, 1.2) == pytest.approx(1.0)
    assert score.by_factor(-250.0, 250.0, 1.2) == np.inf
    assert score.at_least(0.5, 0.75, 0.25) == pytest.approx(1.0)
    assert score.at_least(0.9, 0.75, 0.25) == pytest.approx(0.0, abs=1e-12)
    assert score.at_most(0.02, 0.034, 0.02) == pytest.approx(0.0, abs=1e-12)
    assert all(one.miss(1e9) <= score.WORST for one in score.STATEMENTS)


@pytest.mark.parametrize("name", STUDIES)
def test_every_machine_of_a_study_is_driven_by_all_inputs(name):
    machines = machines_of(read_study(HERE / f"{name}.toml"))
    assert machines
    assert all(set(cases) == INPUTS for cases in machines.values())


def test_a_machine_is_scored_once_all_its_responses_are_there(responses, tmp_path):
    study = read_study(HERE / "candidates.toml")
    cases = next(iter(machines_of(study).values()))
    for name, one in cases.items():
        assert list(scored(study, tmp_path)) == []
        write_response(responses[name], response_path(tmp_path, one.id))
    (machine,) = scored(study, tmp_path)
    assert machine.score == score.score(observables.observables_of(responses))
    page = as_markdown([machine])
    assert "printed" in page
    assert "**-0.125**" in page


def test_the_best_machine_comes_first():
    seen = {one.name: one.printed for one in (*score.STATEMENTS, *score.TOLD)}
    seen |= {f"{kind}_{axis}_um": 1.0 for kind in ("total", "nonlinear") for axis in "xy"}
    off = dict.fromkeys(score.misses(seen), 0.0)
    page = as_markdown([Machine({"a.b": k}, float(k), dict(seen), off) for k in (2, 1)])
    assert page.index("| 1 | 1.00") < page.index("| 2 | 2.00")
