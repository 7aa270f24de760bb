"""Study files: which cases they name, what is refused, and which cases share a condensation."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from batch_cases import case_text, grid, levels, study_in, write_study
from hypothesis import given
from hypothesis import strategies as st

from fesim.batch.paths import known_paths, with_values
from fesim.batch.queue import Queue
from fesim.batch.study import (
    LatinHypercubeSection,
    StudyFile,
    combinations,
    latin_hypercube,
    plain,
    read_study,
)
from fesim.batch.worker import Outcome, Task
from fesim.case.identity import case_id, condensation_key, elasticity_key
from fesim.case.joint_sections import ConductanceSection
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up, with_laws
from thermojoint.artefacts.errors import InputError

CUBE = """[latin_hypercube]
samples = 5
seed = 3
[[latin_hypercube.ranges]]
path = "joints.knee.roughness_um"
low = 0.5
high = 5.0
scale = "log"
"""


HEAT_FILE = "values = [{kind = 'sampled', file = 'heat.csv'}]\n"


def test_a_study_is_the_product_of_its_sections(tmp_path):
    rows = (
        '[[list]]\npaths = ["joints.knee.friction_coefficient", "heat_input"]\n'
        'rows = [[0.2, {kind = "step", level = 2.0}], '
        '[0.6, {kind = "triangle", peak = 2.0, duration_min = 1.0}]]\n'
    )
    study = study_in(tmp_path, grid("march.coupling", "staggered", "iterated") + rows + CUBE)
    assert len(study.cases) == 2 * 2 * 5
    assert study.paths == (
        "march.coupling",
        "joints.knee.friction_coefficient",
        "heat_input",
        "joints.knee.roughness_um",
    )
    assert {one.case.heat_input.kind for one in study.cases} == {"step", "triangle"}
    for one in study.cases:
        assert one.case.march.coupling == one.values["march.coupling"]
        assert one.case.joints["knee"].roughness_um == one.values["joints.knee.roughness_um"]
        assert (one.case.joints["knee"].friction_coefficient == 0.2) == (
            one.case.heat_input.kind == "step"
        )
    assert len({one.key for one in study.cases}) == 1


def test_the_same_case_twice_is_one_case(tmp_path):
    assert len(study_in(tmp_path, grid("heat_input.level", 1, 1.0, 2.0)).cases) == 2


def test_a_name_with_a_dot_can_be_on_the_way_to_a_value(tmp_path):
    """As those of the sides of joints have."""
    path = write_study(tmp_path, grid("sources.spindle.front.reference_power_W", 200.0, 300.0))
    named = case_text(2.0).replace("[sources.bearings]", '[sources."spindle.front"]')
    (tmp_path / "machine.toml").write_text(named)
    cases = [one.case for one in read_study(path).cases]
    assert [case.sources["spindle.front"].reference_power_W for case in cases] == [200.0, 300.0]


def test_a_dimension_that_the_case_leaves_to_its_default_can_be_varied(tmp_path):
    study = study_in(tmp_path, grid("structure.dimensions_mm.wall", 40.0, 50.0))
    assert [one.case.structure.dimensions_mm["wall"] for one in study.cases] == [40.0, 50.0]
    assert len({one.key for one in study.cases}) == 2


def test_other_values_leave_the_data_of_the_case_as_they_were():
    """Cases share what they do not vary: it must not change under another case's hands."""
    data = {"a": {"b": [{"c": 1.0}, {"c": 2.0}]}, "d": {"e": 3.0}}
    first = with_values(data, {"a.b.1.c": 5.0, "a.f.g": 6.0, "d": {"h": 7.0}})
    assert first == {"a": {"b": [{"c": 1.0}, {"c": 5.0}], "f": {"g": 6.0}}, "d": {"h": 7.0}}
    assert data == {"a": {"b": [{"c": 1.0}, {"c": 2.0}]}, "d": {"e": 3.0}}


@given(samples=st.integers(1, 40), seed=st.integers(0, 2**32), log=st.booleans())
def test_every_strip_of_a_latin_hypercube_has_one_sample(samples, seed, log):
    section = LatinHypercubeSection(
        samples=samples,
        seed=seed,
        ranges=[
            {"path": "a", "low": 0.1, "high": 10.0, "scale": "log" if log else "linear"},
            {"path": "b", "low": -3.0, "high": 4.0},
        ],
    )
    found = latin_hypercube(section)
    assert found == latin_hypercube(section)
    a, b = (np.array([row[name] for row in found]) for name in "ab")
    a = np.log10(a) / 2.0 + 0.5 if log else (a - 0.1) / 9.9
    for strips in (a, (b + 3.0) / 7.0):
        assert sorted(np.floor(strips * samples + 1e-9).astype(int).clip(0, samples - 1)) == list(
            range(samples)
        )


@pytest.mark.parametrize(
    ("varied", "told"),
    [
        ("", "nothing varies"),
        ("[[grid]\n", "no valid TOML"),
        (grid("joints.knee.frictoin_coefficient", 1.0), "'joints.knee.friction_coefficient'?"),
        (grid("sources.bearing.reference_power_W", 1.0), "'sources.bearings.reference_power_W'?"),
        (grid("heat_input.level", 1.0, "hot"), "case 2 (heat_input.level = hot)"),
        (grid("joints.knee.roughness_um", -1.0), "greater than 0"),
        (grid("supports.fixed", ["column_bse"]), "'column_base'?"),
        (grid("displacement.point", "C"), "no probe named 'C'"),
        (grid("structure.dimensions_mm.wall", 900.0), "case 1 (structure.dimensions_mm.wall"),
        (
            "[[grid]]\npath = 'heat_input'\nvalues = [{kind = 'sampled', file = 'none.csv'}]\n",
            "none.csv: cannot be read",
        ),
        (grid("heat_input.level", 1.0) * 2, "varied twice"),
        (grid("heat_input", {}) + grid("heat_input.level", 1.0), "overlap"),
        (grid("heat_input.level"), "grid.1.values"),
        (grid("heat_input.level", 1.0) + "step = 2\n", "grid.1: no key named 'step'"),
        ("grids = []\n", "did you mean 'grid'"),
        ("[[list]]\npaths = ['heat_input.level']\nrows = [[1.0, 2.0]]\n", "row 1 has 2 values"),
        (CUBE.replace("seed = 3", ""), "latin_hypercube.seed is missing"),
        (CUBE.replace("samples = 5", "samples = 0"), "latin_hypercube.samples"),
        (CUBE.replace("low = 0.5", "low = 6.0"), "low must be below high"),
        (CUBE.replace("low = 0.5", "low = 0.0"), "low must be positive"),
        (CUBE.replace("log", "lag"), "latin_hypercube.ranges.1.scale"),
        (levels(400) + grid("march.step_s", *range(1, 300)), "119600 cases"),
    ],
)
def test_a_bad_study_is_refused_in_one_line(tmp_path, varied, told):
    path = write_study(tmp_path, varied)
    with pytest.raises(InputError) as refusal:
        read_study(path)
    message = str(refusal.value)
    assert told in message
    assert "study.toml" in message
    assert "\n" not in message or told == "no valid TOML"


def test_the_history_of_a_load_is_read_before_any_case_runs(tmp_path):
    (tmp_path / "good.csv").write_text("time_s,factor\n0,1\n10,2\n")
    (tmp_path / "bad.csv").write_text("time_s,factor\n10,1\n0,2\n")
    path = write_study(tmp_path, grid("loads.push.file", "good.csv", "bad.csv"))
    with (tmp_path / "machine.toml").open("a") as file:
        file.write('[loads.push]\nsurface = "exterior"\nforce_N = [1, 0, 0]\nfile = "good.csv"\n')
    with pytest.raises(InputError, match=r"case 2 .*bad\.csv: time 0 s of sample 2"):
        read_study(path)


def test_an_ambient_that_radiation_contradicts_is_refused_in_a_later_case_too(tmp_path):
    """Ambients share a condensation, and no case is set up alone to find it."""
    for name, first in (("as_said", 20.0), ("warmer", 30.0)):
        (tmp_path / f"{name}.csv").write_text(f"time_s,ambient_degC\n0,{first}\n3600,31\n")
    path = write_study(tmp_path, grid("ambient.file", "as_said.csv", "warmer.csv"))
    with (tmp_path / "machine.toml").open("a") as file:
        file.write("[radiation.exterior]\nemissivity = 0.9\nambient_degC = 20.0\n")
        file.write('[ambient]\nfile = "as_said.csv"\n')
    with pytest.raises(InputError, match=r"case 2 .*20 °C, but ambient begins with 30 °C"):
        read_study(path)


def test_a_byte_order_mark_may_lead_a_study_and_its_case(tmp_path):
    path = write_study(tmp_path, grid("heat_input.level", 1.0, 2.0))
    for file in (path, tmp_path / "machine.toml"):
        file.write_text(file.read_text("utf-8"), "utf-8-sig")
    assert len(read_study(path).cases) == 2


def test_a_study_without_its_case_is_refused(tmp_path):
    path = write_study(tmp_path, levels(2))
    (tmp_path / "machine.toml").unlink()
    with pytest.raises(InputError, match=r"machine\.toml: cannot be read"):
        read_study(path)


def test_combinations_change_the_last_section_fastest():
    given_study = StudyFile.model_validate(
        {"case": "x", "grid": [{"path": p, "values": [1, 2]} for p in "ab"]}
    )
    assert [(one["a"], one["b"]) for one in combinations(given_study)] == [
        (1, 1),
        (1, 2),
        (2, 1),
        (2, 2),
    ]


# Which cases share a condensation.

#: Another value for everything that enters only loads and joint laws, or is only recorded.
NOT_CONDENSED = {
    "title": "another",
    "heat_input.level": 2.0,
    "heat_input": {"kind": "triangle", "peak": 1.0, "duration_min": 2.0},
    "sources.bearings.reference_power_W": 100.0,
    "sources.bearings.count": 1,
    "sources.bearings.reading": "total",
    "sources.bearings.heat_input": {"kind": "step", "level": 2.0},
    "march.duration_min": 1.0,
    "march.coupling": "iterated",
    "joints.knee.preload_MPa": 3.0,
    "joints.knee.roughness_um": 2.0,
    "joints.knee.asperity_slope": 0.2,
    "joints.knee.hardness_GPa": 1.5,
    "joints.knee.normal_law": "back-burdekin",
    "joints.knee.back_burdekin": {"coefficient_um": 0.5, "exponent": 0.5},
    "joints.knee.conductance": {"law": "cmy-exact"},
    "joints.knee.gap": {"gas_conductivity_W_mK": 0.026},
    "joints.knee.friction_coefficient": 0.1,
    "joints.knee.tangential_stiffness_ratio": 0.5,
    "output.snapshots_s": [10.0],
}
CONDENSED = {
    "structure.element_size_mm": 90.0,
    "structure.half": False,
    "structure.dimensions_mm.wall": 40.0,
    "materials.cast_iron.conductivity_W_mK": 50.0,
    "materials.cast_iron.density_kg_m3": 7000.0,
    "materials.screw.youngs_modulus_GPa": 3000.0,
    "materials.screw.expansion_1_K": 0.0,
    "bodies.screw": "cast_iron",
    "joints.knee.along": 8,
    "joints.knee.across": 2,
    "joints.knee.side_a": "other",
    "joints.knee.slip_heating": True,
    "supports.fixed": ["column_base"],
    "supports.symmetry": {},
    "supports.springs": {"screw_foot": {"stiffness_N_um": [1.0, 1.0, 1.0]}},
    "convection_W_m2K.exterior": 7.0,
    "sources.bearings.surface": "interior",
    "sources.bearings.profile": {"expression": "1 + y_m"},
    "materials.cast_iron.conductivity_factor": {"rise_K": [0.0, 100.0], "factor": [1.0, 0.9]},
    "materials.cast_iron.expansion_factor": {"rise_K": [0.0, 100.0], "factor": [1.0, 1.1]},
    "materials.cast_iron.youngs_modulus_factor": {"rise_K": [0.0, 100.0], "factor": [1.0, 0.9]},
    "convection_factor": {"exterior": {"rise_K": [0.0, 100.0], "factor": [1.0, 2.0]}},
    "radiation": {"exterior": {"emissivity": 0.9, "ambient_degC": 20.0}},
    "cavities": {"air": {"surfaces": ["interior"], "film_W_m2K": 3.0}},
    "initial_temperature": {"rise_K": 5.0},
    "held_temperatures": {"exterior": {"rise_K": 1.0}},
    "loads": {"gravity": {"acceleration_m_s2": [0.0, -9.81, 0.0]}},
    "bolts": {
        "one": {
            "head": {"surface": "rear"},
            "thread": {"surface": "knee.b"},
            "force_kN": 10.0,
            "diameter_mm": 16.0,
            "material": "cast_iron",
        }
    },
    "walls": {"floor": {"faces": "column_base"}},
    "output.forces": True,
    "output.stress_probes": ["T1"],
    "march.step_s": 1.0,
    "march.solver": "superlu",
    "march.thermal": "reduced",
    "displacement.point": "B",
    "probes.T1.position_mm": [625.0, 450.0, 80.0],
    "candidates": [{"body": "table", "low_mm": [0, 0, 0], "high_mm": [1, 1, 1], "spacing_mm": 1.0}],
}
#: What a joint has in the place of its preload.
OF_OPEN_JOINTS = {"joints.knee.initial_opening_um", "joints.knee.reference_pressure_MPa"}
#: What a joint has on an axis, which a batch refuses.
OF_AXES = {"joints.knee.axis", "joints.knee.running_friction_coefficient"}


@pytest.fixture(scope="module")
def data():
    import tomllib

    found = tomllib.loads(case_text(2.0))
    found["joints"]["knee"] |= {"side_a": "knee.a", "side_b": "knee.b"}
    return found


def made(data, values):
    return case_from_data(with_values(data, values), "case", Path())


def test_one_key_of_a_missing_section_leaves_the_others_at_their_defaults(data):
    knee = {key: value for key, value in data["joints"]["knee"].items() if key != "conductance"}
    bare = data | {"joints": {"knee": knee}}
    changed = made(bare, {"joints.knee.conductance.law": "cmy-exact"}).joints["knee"].conductance
    assert changed == ConductanceSection(law="cmy-exact")


def test_a_section_that_is_there_is_not_filled_up(data):
    alone = data | {"displacement": {"point": "A"}}
    assert made(alone, {"displacement.point": "T1"}).displacement.relative_to is None


@pytest.mark.parametrize("path", NOT_CONDENSED)
def test_loads_and_joint_laws_leave_the_condensation_as_it_is(data, path):
    changed = made(data, {path: NOT_CONDENSED[path]})
    assert condensation_key(changed) == condensation_key(made(data, {}))
    assert case_id(changed) != case_id(made(data, {}))


@pytest.mark.parametrize("path", CONDENSED)
def test_whatever_enters_the_condensation_changes_its_key(data, path):
    changed = made(data, {path: CONDENSED[path]})
    assert condensation_key(changed) != condensation_key(made(data, {}))
    assert case_id(changed) != case_id(made(data, {}))


def test_every_value_of_a_case_is_known_to_one_of_the_two_lists(data):
    above = {path.rsplit(".", n)[0] for path in [*CONDENSED, *NOT_CONDENSED] for n in range(5)}
    sections = {path.split(".")[0] for path in known_paths(made(data, {}))}
    joint = {p for p in known_paths(made(data, {})) if p.startswith("joints.knee.")}
    assert sections - {p.split(".")[0] for p in above} == {"ambient", "axes", "volume"}
    pair = {"joints.knee.side_b"}
    assert {p for p in joint if p.count(".") == 2} <= above | pair | OF_OPEN_JOINTS | OF_AXES


def test_an_opening_is_part_of_the_law(data):
    """No joint has it beside a preload: as OF_OPEN_JOINTS, both at once."""
    closed = data["joints"]["knee"] | {"preload_MPa": 0.0, "reference_pressure_MPa": 4.0}
    wide, wider = (
        made(data, {"joints.knee": closed | {"initial_opening_um": opening}})
        for opening in (0.0, 50.0)
    )
    assert condensation_key(wide) == condensation_key(wider) == condensation_key(made(data, {}))
    assert case_id(wide) != case_id(wider)


def test_the_strength_of_a_held_temperature_is_a_load_and_its_place_is_not(data):
    warm, hot, elsewhere = (
        made(data, {"held_temperatures": {place: {"rise_K": rise}}})
        for place, rise in (("exterior", 1.0), ("exterior", 2.0), ("interior", 1.0))
    )
    assert condensation_key(warm) == condensation_key(hot) != condensation_key(elsewhere)


def test_a_file_counts_by_its_content(tmp_path, data):
    names = [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    for name, text in zip(names, ("0,1", "0,1", "0,2"), strict=True):
        name.write_text(f"time_s,heat_input\n{text}\n")
    one, same, other = (
        made(data, {"heat_input": {"kind": "sampled", "file": str(name)}}) for name in names
    )
    assert case_id(one) == case_id(same) != case_id(other)
    assert condensation_key(one) == condensation_key(other)
    mesh = {"structure": {"kind": "mesh", "file": str(names[0])}}
    assert condensation_key(made(data, mesh)) != condensation_key(
        made(data, {"structure": {"kind": "mesh", "file": str(names[2])}})
    )


def test_only_files_are_taken_for_files(data, tmp_path):
    named = data | {"bodies": data["bodies"] | {"file": "cast_iron"}}
    named["convection_W_m2K"] = {"file": 5.0}
    named["held_temperatures"] = {"file": {"rise_K": 1.0}, "screw_foot": {"file": "oil.csv"}}
    (tmp_path / "oil.csv").write_text("time_s,rise_K\n0,1\n")
    case = case_from_data(named, "case", tmp_path)
    assert case.bodies["file"] == "cast_iron"
    assert case.held_temperatures["screw_foot"].file == tmp_path / "oil.csv"
    before = case_id(case)
    assert elasticity_key(case)
    (tmp_path / "oil.csv").write_text("time_s,rise_K\n0,2\n")
    assert case_id(case) != before


def test_the_files_of_a_study_are_found_from_any_folder(tmp_path, monkeypatch):
    write_study(tmp_path / "there", "[[grid]]\npath = 'heat_input'\n" + HEAT_FILE)
    (tmp_path / "there" / "heat.csv").write_text("time_s,heat_input\n0,1\n")
    monkeypatch.chdir(tmp_path)
    case = read_study(Path("there/study.toml")).cases[0].case
    assert case.heat_input.file == tmp_path / "there" / "heat.csv"


def test_a_condensation_with_other_laws_is_that_of_the_other_case(data):
    del_heat = {path: value for path, value in NOT_CONDENSED.items() if path != "heat_input.level"}
    base, other = made(data, {}), made(data, del_heat)
    shared, own = with_laws(set_up(base), other), set_up(other)
    joints, own_joints = shared.machine.contact, own.machine.contact
    thermal, elastic = shared.machine.thermal, joints.elastic
    np.testing.assert_allclose(thermal.inputs, own.machine.thermal.inputs, rtol=1e-12)
    np.testing.assert_allclose(elastic.compliance, own_joints.elastic.compliance, rtol=1e-10)
    np.testing.assert_allclose(elastic.reference, own_joints.elastic.reference, rtol=1e-12)
    gap, slip = (
        np.full((3, joints.count), -1e-7),
        np.zeros((2, joints.count)),
    )
    np.testing.assert_allclose(
        joints.traction(gap, slip).value,
        own_joints.traction(gap, slip).value,
        rtol=1e-12,
    )
    assert joints.preload[0] == pytest.approx(3.0e6, rel=1e-12)


# Which case a worker gets next.


def test_a_course_beyond_the_stroke_is_refused_before_any_work(tmp_path):
    """It would fail case by case."""
    case = files("thermojoint").joinpath("cases/moving_knee.toml")
    path = tmp_path / "study.toml"
    varied = grid("axes.y.stroke_mm", [-100.0, 200.0], [-50.0, 200.0])
    path.write_text(f'case = "{case}"\n{varied}')
    with pytest.raises(InputError, match=r"case 2 .*: axes\.y: .* is outside stroke_mm, -50 to"):
        read_study(path)


def test_cases_of_a_machine_with_axes_share_a_set_up_if_only_the_heat_differs(tmp_path):
    """Its set-up holds the laws of its joints and where it moves."""
    case = files("thermojoint").joinpath("cases/moving_knee.toml")
    path = tmp_path / "study.toml"
    for varied, count in (
        (levels(2), 1),
        (grid("joints.knee.preload_MPa", 3.0, 4.0), 2),
        (grid("axes.y.reference_mm", 0.0, 50.0), 2),
    ):
        path.write_text(f'case = "{case}"\n{varied}')
        assert len({one.key for one in read_study(path).cases}) == count


def test_every_table_of_conductances_is_read_before_any_work(tmp_path):
    """Laws share a condensation: only the table of the first case was read."""
    for name, falling in (("good", 3000.0), ("bad", 10.0)):
        rows = f"pressure_MPa,conductance_W_m2K\n1,1000\n5,2000\n9,{falling}\n"
        (tmp_path / f"{name}.csv").write_text(rows)
    tables = "".join(f'{{law = "table", file = "{name}.csv"}}, ' for name in ("good", "bad"))
    path = write_study(
        tmp_path, f'[[grid]]\npath = "joints.knee.conductance"\nvalues = [{tables}]\n'
    )
    with pytest.raises(InputError, match=r"case 2 .*bad.csv: .* falls as pressure_MPa rises"):
        read_study(path)


def test_loads_that_turn_where_no_step_can_follow_are_refused_before_any_work(tmp_path):
    """As `simulate` refuses them: they failed case by case."""
    path = write_study(tmp_path, grid("joints.knee.slip_heating", False, True))
    push = '[loads.push]\nsurface = "bearings"\nforce_N = [100.0, 0.0, 0.0]\nfile = "push.csv"\n'
    machine = tmp_path / "machine.toml"
    machine.write_text(machine.read_text() + push)
    (tmp_path / "push.csv").write_text("time_s,factor\n0,0\n45,1\n90,0\n")
    with pytest.raises(
        InputError, match=r"case 2 .*turns back within the step to 46 s, which slip"
    ):
        read_study(path)


def outcome(task):
    return Outcome(task.id, "done", seconds=1.0, setup_seconds=20.0)


@given(
    sizes=st.lists(st.integers(1, 6), min_size=1, max_size=5),
    order=st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=60),
)
def test_every_case_is_handed_out_once_whoever_finishes_or_dies_first(sizes, order):
    tasks = [
        Task(f"{key}-{n}", str(key), "") for key, size in enumerate(sizes) for n in range(size)
    ]
    queue, working, finished = Queue(tasks), {}, []
    names = ["w0", "w1", "w2"]

    def hand_out():
        queue.keep(names)
        for name in names:
            if name not in working and (task := queue.next_for(name)) is not None:
                working[name] = task

    hand_out()
    moves = iter(order)
    while working:
        number, dies = next(moves, (0, False))
        name = sorted(working)[number % len(working)]
        task = working.pop(name)
        if dies:
            names[names.index(name)] = name + "'"
            queue.give_back(task)
        else:
            finished.append(task.id)
            queue.learn(task, outcome(task))
        hand_out()
    assert sorted(finished) == sorted(task.id for task in tasks)


def test_a_worker_stays_with_its_condensation():
    tasks = [Task(f"{key}-{n}", key, "") for n in range(10) for key in ("a", "b")]
    queue = Queue(tasks)
    keys = {name: [queue.next_for(name).key for _ in range(10)] for name in ("w0", "w1")}
    assert {name: len(set(some)) for name, some in keys.items()} == {"w0": 1, "w1": 1}


def test_a_worker_joins_another_only_if_that_is_quicker_than_its_set_up():
    queue = Queue([Task(str(n), "a", "") for n in range(30)])
    first = queue.next_for("w0")
    queue.learn(first, outcome(first))
    assert queue.next_for("w1") is not None
    queue = Queue([Task(str(n), "a", "") for n in range(10)])
    first = queue.next_for("w0")
    queue.learn(first, outcome(first))
    assert queue.next_for("w1") is None
    assert all(queue.next_for("w0") for _ in range(9))
    assert len(queue) == 0


def test_a_huge_integer_is_a_float_in_the_tables():
    """No table has integers beyond 64 bits: they ended a batch in a traceback after its cases."""
    assert (plain(10**23), plain(2**63 - 1), plain(True)) == (1e23, 2**63 - 1, True)
    assert isinstance(plain(10**23), float)
