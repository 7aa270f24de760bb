"""What a calibration takes: measured responses by its page; one line for what it cannot take."""

import json
import re
import shlex
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from repository import ROOT

from calibrate import chain
from calibrate.drivable import check_alone, check_drivable
from calibrate.responses import candidates_in, check_responses, moving_axes
from estimator.fchs import judging as judge
from fesim.case.schema import CandidatesSection, Case, case_from_data, read_case
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.artefacts.response import make_response, read_response, write_response
from thermojoint.cli import arguments, modelling
from thermojoint.cli.app import app
from thermojoint.models import deformation, ring_source
from thermojoint.models.model_file import read_model, read_provenance
from thermojoint.models.parameters import DeformationModel, RingModel
from thermojoint.paper import inputs, reproduce
from thermojoint.paper.inputs import check_placeable
from thermojoint.paper.verdict import paper_claim

pytestmark = pytest.mark.usefixtures("few_starts")

PAGE = (ROOT / "docs" / "calibration.md").read_text("utf-8")
SECTION = PAGE[PAGE.index("## What a measured response must contain") :]
BLOCKS = dict(re.findall(r"^```(\w+)[^\n]*\n(.*?)^```", SECTION, re.M | re.S))

THREE_AXES = ROOT / "thermojoint" / "cases" / "three_axes.toml"

TIMES = 10.0 * np.arange(151)
#: Those of the page, m.
DISTANCES = [[0.049, 0.125], [0.108, 0.062]]
PLACES = {
    "a": (0.575, 0.600, 0.175),
    "b": (0.550, 0.450, 0.125),
    "T1": (0.625, 0.450, 0.0875),
    "T2": (0.625, 0.700, 0.0875),
}
MAIN = RingModel(K=8.0, a=3.2, alpha=2.1e-4, r=0.19, r0=0.12)
SOURCES = [(1.3, 8.0, 2e-4), (0.9, 20.0, 3e-4)]
STRENGTHS = {0.5: (-0.12, -0.2), 1.0: (0.0, 0.0), 2.0: (1.0, 1.0)}
SHAPES = (
    DeformationModel(3e-6, 5e-6, -1e-8, 0.004, 0.0011, 0.009, 2e-8, 0.02),
    DeformationModel(-1e-6, 3e-6, 1e-8, 0.006, 0.0008, 0.012, -2e-8, 0.03),
)


def saturating(t, rate, gain):
    return gain * -np.expm1(-rate * t)


def measured(level, t=TIMES):
    """What thermometers (K) and gauges (m) show: the heat's part, and that of two sources."""
    b = level * saturating(t, 1e-3, 2.0)
    shown = {
        "a": b + level * ring_source.step_response(t, **asdict(MAIN)),
        "b": b,
        "T1": level * saturating(t, 6e-4, 1.5),
        "T2": level * saturating(t, 4e-4, 1.0),
        "x": level * saturating(t, 1e-3, 80e-6),
        "y": 1e-9 * np.sin(t),
        "z": level * saturating(t, 7e-4, -70e-6),
    }
    for i, strength in enumerate(STRENGTHS[level]):
        for j, sensor in enumerate(("T1", "T2")):
            shown[sensor] = shown[sensor] + strength * ring_source.step_response(
                t, *SOURCES[i], DISTANCES[i][j], 0.02
            )
        for axis, sign in (("x", 1.0), ("z", -1.0)):
            shown[axis] = shown[axis] + sign * strength * deformation.step_response(t, SHAPES[i])
    return shown


def response(level, *, probes=None, t=TIMES, **attributes):
    """The same as a response; `probes` maps further names to those of `PLACES`."""
    shown = measured(level, t)
    probes = probes or {name: name for name in PLACES}
    return make_response(
        {
            "heat_input": np.full(t.size, level),
            "temperature": np.stack([shown[name] for name in probes.values()], axis=1),
            "displacement": np.stack([shown[axis] for axis in "xyz"], axis=1),
            "probe_position": np.array([PLACES[name] for name in probes.values()]),
            "contact_position": np.array([[0.62, y, 0.09] for y in (0.40, 0.55, 0.72)]),
        },
        {"time": t, "probe": list(probes), "axis": ["x", "y", "z"]},
        {"reference_power_W": 295.0} | attributes,
    )


def test_steps_of_sources_with_other_powers_are_refused():
    """The case was edited between the runs."""
    powers = {0.5: (60.0, 30.0), 1.0: (120.0, 60.0), 2.0: (300.0, 120.0)}
    steps = {
        level: response(level).assign(
            source_power=(("time", "source"), np.tile(each, (TIMES.size, 1)), {"units": "W"}),
            source=["motor", "pump"],
        )
        for level, each in powers.items()
    }
    said = "input 2: at heat input 1 source 'motor' has 150 W, in the reference 120 W"
    with pytest.raises(InputError, match=said):
        check_responses(steps.pop(1.0), steps, 2)


def test_steps_of_displacements_of_other_points_are_refused():
    """The case measured another point in the last run."""
    steps = {level: response(level, displacement_of="A relative to B") for level in (0.5, 1.0)}
    steps[2.0] = response(2.0, displacement_of="A")
    with pytest.raises(InputError, match="input 2: displacement of A, in the reference of A rel"):
        check_responses(steps.pop(1.0), steps, 2)


def test_steps_with_a_thermometer_elsewhere_are_refused():
    """The case had its T2 elsewhere in the last run."""
    moved = others()
    moved[2.0]["probe_position"].loc["T2"] += [0.0, 0.03, 0.0]
    with pytest.raises(InputError, match="input 2: probe 'T2' is 30 mm from its place in the ref"):
        chain.calibrate_responses(response(1.0), moved)


def others(**options):
    return {level: response(level, **options) for level in (0.5, 2.0)}


# Measured responses


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Do what the page says, in a folder with the files of a logger that skips samples."""
    folder = tmp_path_factory.mktemp("measured")
    times = np.delete(5.0 * np.arange(301), [7, 8, 100])
    for level in STRENGTHS:
        shown = measured(level, times)
        columns = {"time_s": times}
        columns |= {f"{name}_degC": 20.0 + shown[name] for name in PLACES}
        columns |= {"ambient_degC": np.full(times.size, 20.0)}
        columns |= {f"{axis}_um": 1e6 * shown[axis] for axis in "xyz"}
        np.savetxt(
            folder / f"step-{level}.csv",
            np.column_stack(list(columns.values())),
            "%.9g",
            ",",
            header=",".join(columns),
            comments="",
        )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(BLOCKS["python"], "calibration.md", "exec"), {})
        program, *words = shlex.split(BLOCKS["sh"])
        assert program == "thermojoint"
        app(words, standalone_mode=False)
    return folder


def test_measured_steps_calibrate_as_the_page_says(page):
    model = read_model(page / "model.json")
    assert np.allclose(model.distances, DISTANCES)
    assert model.sensors == PLACES
    assert model.reference_power_W == 295.0
    thermal = model.linear.thermal
    assert ring_source.step_response(TIMES, **asdict(thermal)) == pytest.approx(
        ring_source.step_response(TIMES, **asdict(MAIN)), abs=0.02
    )


def test_a_model_is_written_also_where_there_can_be_no_regressions(tmp_path, command):
    """With one sensor at the joint, which the regressions say after the calibration."""
    one = {name: name for name in ("a", "b", "T1")}
    for level in STRENGTHS:
        write_response(response(level, probes=one), tmp_path / f"{level}.nc")
    code, _, error = command(
        *("calibrate", "--reference", tmp_path / "1.0.nc", "--distances-mm", "49"),
        *("--input", f"2={tmp_path / '2.0.nc'}", "--input", f"0.5={tmp_path / '0.5.nc'}"),
        *("--out", tmp_path / "model.json", "--baselines", tmp_path / "baselines.json"),
    )
    assert code == 2
    assert "no probe named 'T2'" in error
    assert list(read_model(tmp_path / "model.json").linear.direct) == ["T1"]
    assert not (tmp_path / "baselines.json").exists()


def test_the_axes_that_move_are_calibrated_whatever_they_are_called(page):
    model = read_model(page / "model.json")
    assert list(model.linear.deformation) == ["x", "z"]
    for source in model.sources:
        assert list(source.deformation) == list(source.driven) == ["x", "z"]


def test_every_command_takes_a_model_of_other_axes(page, capsys, monkeypatch):
    monkeypatch.chdir(page)
    app(["tables", "model.json"], standalone_mode=False)
    assert "Deformation z (Eq. 8)" in capsys.readouterr().out
    app(["estimate", "model.json", "step-2.0.csv", "--out", "estimate.csv"], standalone_mode=False)
    estimate = np.genfromtxt("estimate.csv", delimiter=",", names=True)
    truth = 1e6 * measured(2.0, estimate["time_s"])["z"]
    assert np.abs(estimate["z_um"] - truth).max() < 0.05 * np.abs(truth).max()
    arguments = ["validate", "model.json", "step-2.0.nc", "--reference", "step-1.0.nc"]
    app([*arguments, "--json", "errors.json"], standalone_mode=False)
    rows = json.loads(Path("errors.json").read_text())["rows"]
    assert {row["axis"] for row in rows} == {"x", "z"}


def test_a_long_record_that_begins_one_interval_after_the_step_is_calibrated():
    """What is left of 1501 samples or more has to be even from the step on, too."""
    late = 0.9 * np.arange(1, 1602)
    runs = {level: response(level, t=late) for level in STRENGTHS}
    model = chain.calibrate_responses(runs.pop(1.0), runs, DISTANCES).model
    thermal = model.linear.thermal
    assert ring_source.step_response(TIMES, **asdict(thermal)) == pytest.approx(
        ring_source.step_response(TIMES, **asdict(MAIN)), abs=0.02
    )


def test_the_paper_claims_nothing_of_an_axis_it_has_not():
    row = {"case": "step-3.0", "estimator": "fchs"}
    assert paper_claim(row | {"axis": "y"}) == 0.5
    assert paper_claim(row | {"axis": "z"}) is None


def test_the_model_file_tells_how_the_averaging_loop_ended(page):
    text = read_provenance(page / "model.json").reports["averaging"]
    assert re.search(r"the inputs agree after|the means stopped moving|did not agree", text)
    assert re.search(r"max \S+ K, rms \S+ K; joint fit: max \S+ K, rms \S+ K", text)
    condition = float(re.search(r"condition number of the strengths (\S+)", text)[1])
    assert condition > 1.0


def uneven():
    times = TIMES.copy()
    times[50:] += 3.0
    return times


UNSUITED = {
    "samples are skipped": (
        lambda: (response(1.0, t=uneven()), others(t=uneven())),
        "10 to 13 s apart",
    ),
    "the first sample comes late": (
        lambda: (response(1.0, t=TIMES + 25.0), others(t=TIMES + 25.0)),
        "the first at 25 s",
    ),
    "no places": (lambda: (response(1.0).drop_vars("probe_position"), others()), "probe_position"),
    "no power": (lambda: (response(1.0, reference_power_W="much"), others()), "reference_power_W"),
    "one other step": (lambda: (response(1.0), {2.0: response(2.0)}), "as many heat inputs"),
    "wrong level": (
        lambda: (response(1.0), {0.6: response(0.5), 2.0: response(2.0)}),
        "input 0.6: its heat input is 0.5",
    ),
    "another duration": (
        lambda: (response(1.0), {0.5: response(0.5, t=TIMES[:90]), 2.0: response(2.0)}),
        "sample times differ",
    ),
    "a sensor is missing": (
        lambda: (response(1.0), {0.5: response(0.5).isel(probe=[0, 1, 2]), 2.0: response(2.0)}),
        "input 0.5: no probe named 'T2'",
    ),
    "nothing moves": (
        lambda: (
            response(1.0).sel(axis=[]),
            {level: one.sel(axis=[]) for level, one in others().items()},
        ),
        "zero along every axis",
    ),
    "no contact elements": (
        lambda: (response(1.0).drop_vars("contact_position"), others()),
        "--distances-mm",
    ),
}


@pytest.mark.parametrize("mistake", UNSUITED)
def test_responses_that_cannot_be_calibrated_are_refused_before_any_fit(mistake, monkeypatch):
    monkeypatch.setattr(chain, "calibrate_displacements", None)  # would fail if it were called
    make, said = UNSUITED[mistake]
    with pytest.raises(InputError) as caught:
        chain.calibrate_responses(*make())
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("distances", [[[0.05, 0.1]], [[0.05, 0.1], [0.1]], [[0.05, -1], [1, 1]]])
def test_distances_of_another_number_or_sign_are_refused_before_any_fit(distances, monkeypatch):
    monkeypatch.setattr(chain, "calibrate_displacements", None)
    with pytest.raises(InputError, match="distances"):
        chain.calibrate_responses(response(1.0), others(), distances)


def test_axes_along_which_nothing_moves_are_left_out_and_no_others():
    assert moving_axes(response(1.0), others()) == ["x", "z"]
    # What moves in one of the other steps only counts as well.
    bent = others()
    bent[2.0] = bent[2.0].copy(deep=True)
    bent[2.0]["displacement"][-1, 1] = 1e-5
    assert moving_axes(response(1.0), bent) == ["x", "y", "z"]


# Responses with candidates

CANDIDATES = {"hot": "a", "cold": "b", "low": "T1", "high": "T2"}


@pytest.fixture(scope="module")
def carried(coarse_case):
    """A case with two candidate boxes, as responses carry it."""
    boxes = [
        CandidatesSection(body="column", low_mm=low, high_mm=high, spacing_mm=25.0)
        for low, high in (
            ((500.0, 400.0, 100.0), (600.0, 700.0, 200.0)),
            ((610.0, 400.0, 50.0), (650.0, 750.0, 100.0)),
        )
    ]
    return coarse_case.model_copy(update={"candidates": boxes}).model_dump_json()


def placeable(level, case, **options):
    return response(level, probes=CANDIDATES, case=case, **options)


def test_a_candidate_is_chosen_for_the_box_of_its_own_body_alone(coarse_case):
    box = {"low_mm": (500.0, 400.0, 50.0), "high_mm": (650.0, 750.0, 200.0), "spacing_mm": 25.0}
    bodies = ("column", "table")
    boxes = [CandidatesSection(body=body, **box) for body in bodies]
    case = coarse_case.model_copy(update={"candidates": boxes, "probes": {}})
    probes = {"s575_600_175_column": "a", "s550_450_125_table": "b", "gauge": "T1"}
    seen = response(1.0, probes=probes, case=case.model_dump_json())
    assert candidates_in(seen) == (
        ["s575_600_175_column", "gauge"],
        ["s550_450_125_table", "gauge"],
    )


UNPLACEABLE = {
    "wrong level": (lambda m: {0.6: m(0.5), 2.0: m(2.0)}, "input 0.6: its heat input is 0.5"),
    "another duration": (lambda m: {0.5: m(0.5, t=TIMES[:90]), 2.0: m(2.0)}, "sample times differ"),
    "another interval": (
        lambda m: {0.5: m(0.5, t=0.5 * TIMES), 2.0: m(2.0)},
        "sample times differ",
    ),
    "other candidates": (
        lambda m: {0.5: m(0.5).isel(probe=[0, 1, 2]), 2.0: m(2.0)},
        "input 0.5: no probe named 'high'",
    ),
    "no input": (lambda m: {}, "as many heat inputs"),
}


@pytest.mark.parametrize("mistake", UNPLACEABLE)
def test_responses_that_do_not_belong_together_are_refused_before_any_sensor_is_chosen(
    mistake, carried, monkeypatch
):
    monkeypatch.setattr(chain, "choose_heat_pair", None)  # would fail if it were called
    make, said = UNPLACEABLE[mistake]
    with pytest.raises(InputError) as caught:
        chain.calibrate_responses(
            placeable(1.0, carried),
            make(lambda level, **options: placeable(level, carried, **options)),
        )
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_distances_go_with_named_sensors_only(carried):
    made = {level: placeable(level, carried) for level in (0.5, 1.0, 2.0)}
    with pytest.raises(InputError, match="name the probes a, b, T1 and T2"):
        chain.calibrate_responses(made.pop(1.0), made, DISTANCES)


def test_a_pair_that_fails_makes_way_for_the_next_without_fitting_table_1_again(
    carried, monkeypatch
):
    tried, fitted = [], []
    fit_heat = chain.calibrate_heat

    def heat(*given):
        fitted.append(given)
        return fit_heat(*given)

    def unstable(base, *_):
        tried.append(base)
        raise ConvergenceError("no stable inverse")

    monkeypatch.setattr(chain, "calibrate_heat", heat)
    monkeypatch.setattr(chain, "calibrate_fictitious", unstable)
    rank = chain.rank_joint_sensors
    monkeypatch.setattr(chain, "rank_joint_sensors", lambda *given: 2 * list(rank(*given)))
    made = {level: placeable(level, carried) for level in (0.5, 1.0, 2.0)}
    with pytest.raises(InputError, match="no stable inverse"):
        chain.calibrate_responses(made.pop(1.0), made)
    # Both twice: the pair, then each of the two alone.
    assert len(tried) == 1 + 2 * 2
    assert len(fitted) == 1


# Cases


def drivable(coarse_data, **sections):
    return case_from_data(coarse_data | sections, "case", Path())


def own_input(data):
    source = data["sources"]["bearings"] | {"heat_input": {"kind": "step", "level": 1.0}}
    return {"sources": {"bearings": data["sources"]["bearings"], "drive": source}}


def history(folder, column, last):
    (folder / "history.csv").write_text(f"time_s,{column}\n0,20\n30,{last}\n")
    return {"file": str(folder / "history.csv")}


def bolts(file):
    """A bolt through the knee, whose force follows a file if there is one."""
    bolt = {
        "head": {"position_mm": [550.0, 500.0, 87.5], "diameter_mm": 30.0, "body": "column"},
        "thread": {"position_mm": [675.0, 500.0, 87.5], "diameter_mm": 16.0, "body": "table"},
        "force_kN": 30.0,
        "diameter_mm": 16.0,
        "material": "cast_iron",
    }
    return {"bolts": {"lower": bolt | file}}


DISTURBED = {
    "a bolt that settles": (
        lambda data, folder: bolts(history(folder, "factor", 19)),
        "bolts.lower",
    ),
    "the weight of the machine": (
        lambda data, folder: {"loads": {"weight": {"acceleration_m_s2": [0.0, -9.81, 0.0]}}},
        "loads.weight",
    ),
    "a source with a heat input of its own": (
        lambda data, folder: own_input(data),
        "sources.drive.heat_input",
    ),
    "no source": (
        lambda data, folder: {"sources": {}, "held_temperatures": {"bearings": {"rise_K": 5.0}}},
        "add [sources.NAME]",
    ),
    "an ambient that changes": (
        lambda data, folder: {"ambient": history(folder, "ambient_degC", 21)},
        "steady ambient",
    ),
    "a warm surface": (
        lambda data, folder: {"held_temperatures": {"bearings": {"rise_K": 5.0}}},
        "held_temperatures.bearings",
    ),
    "a surface that warms": (
        lambda data, folder: {"held_temperatures": {"bearings": history(folder, "rise_K", 21)}},
        "held_temperatures.bearings",
    ),
}


@pytest.mark.parametrize("name", DISTURBED)
def test_a_case_with_more_than_the_heat_input_is_refused_before_it_is_set_up(
    name, coarse_data, tmp_path, monkeypatch
):
    make, said = DISTURBED[name]
    case = drivable(coarse_data, **make(coarse_data, tmp_path))
    monkeypatch.setattr(inputs, "set_up", None)  # would fail if they were called
    monkeypatch.setattr(reproduce, "set_up", None)
    for begin in (
        lambda: inputs.simulate_inputs(case, inputs.CALIBRATION),
        lambda: reproduce.reproduce(case, tmp_path / "out"),
    ):
        with pytest.raises(InputError) as caught:
            begin()
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)


def test_an_axis_whose_motion_warms_the_machine_is_refused():
    """With its screws at work 2.9 µm of 5.8 were not in proportion to the heat input."""
    moving = read_case(THREE_AXES)
    names = list(moving.axes)
    with pytest.raises(InputError, match=rf"axes\.{names[0]}: .* the heat input alone warms"):
        check_alone(response(1.0, case=moving.model_dump_json()), "step")
    data = moving.model_dump(mode="json")
    for axis in data["axes"].values():
        low, high = axis["stroke_mm"]
        axis |= {"file": None, "position_mm": 0.5 * (low + high)}
        if axis["ball_screw"]:
            axis["ball_screw"]["motor_heat_W"] = 0.0
    check_drivable(case_from_data(data, "case", Path()))


def test_the_chain_asks_at_once_to_leave_out_the_axes(tmp_path):
    """It asked to let them stand, and refused the axes that did."""
    with pytest.raises(InputError, match=r"axes\.x: .*leave out \[axes\]"):
        reproduce.reproduce(read_case(THREE_AXES), tmp_path / "out")


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"loads": {"weight": {"acceleration_m_s2": [0.0, -9.81, 0.0]}}}, "loads.weight"),
        ({"initial_temperature": {"rise_K": 5.0}}, "initial_temperature"),
    ],
)
def test_simulated_steps_with_more_than_the_heat_are_refused_before_any_fit(
    changed, said, coarse_data, coarse_case, monkeypatch
):
    monkeypatch.setattr(chain, "calibrate_displacements", None)  # would fail if it were called
    disturbed = drivable(coarse_data, **changed).model_dump_json()
    given = others(case=coarse_case.model_dump_json())
    with pytest.raises(InputError, match=f"reference: {said}"):
        chain.calibrate_responses(response(1.0, case=disturbed), given)
    given[0.5] = response(0.5, case=disturbed)
    with pytest.raises(InputError, match=f"input 0.5: {said}"):
        chain.calibrate_responses(response(1.0, case=coarse_case.model_dump_json()), given)


def test_a_steady_ambient_and_a_surface_at_ambient_do_no_harm(coarse_data, tmp_path):
    sections = {
        "ambient": history(tmp_path, "ambient_degC", 20),
        "held_temperatures": {"bearings": {"rise_K": 0.0}},
    }
    check_drivable(drivable(coarse_data, **sections))


def test_bolts_whose_force_only_heat_changes_do_no_harm(coarse_data, tmp_path):
    check_drivable(drivable(coarse_data, **bolts({})))
    check_drivable(drivable(coarse_data, **bolts(history(tmp_path, "factor", 20))))


def test_a_load_would_be_taken_for_the_joint(coarse_data):
    """What is not proportional to the heat is the joint's: half of the sag, at half of the heat."""
    weight = {"weight": {"acceleration_m_s2": [0.0, -9.81, 0.0]}}
    case = drivable(coarse_data, loads=weight)
    ready = set_up(case)
    half, one = (
        simulate(
            case.model_copy(update={"heat_input": StepInput(kind="step", level=level)}), setup=ready
        )
        .response["displacement"]
        .to_numpy()[0]
        for level in (0.5, 1.0)
    )
    assert np.abs(half - 0.5 * one).max() > 0.5e-6


def test_a_case_without_a_joint_is_refused_before_it_is_set_up(coarse_case, tmp_path, monkeypatch):
    monkeypatch.setattr(reproduce, "set_up", None)
    longer = coarse_case.march.model_copy(update={"duration_min": 2.0})
    check_placeable(coarse_case.model_copy(update={"march": longer}))
    case = Case.model_construct(**(dict(coarse_case) | {"joints": {}}))
    with pytest.raises(InputError, match="nothing is nonlinear"):
        reproduce.reproduce(case, tmp_path / "out")


def test_a_case_of_long_steps_is_refused_before_it_is_set_up(coarse_data, tmp_path, monkeypatch):
    """It was simulated and calibrated, and then there was no noise for it."""
    monkeypatch.setattr(reproduce, "set_up", None)
    march = coarse_data["march"] | {"step_s": 60.0, "duration_min": 35.0}
    with pytest.raises(InputError, match=r"march: .* 60 s apart; .* a shorter step_s"):
        reproduce.reproduce(drivable(coarse_data, march=march), tmp_path / "out")


def test_a_march_of_half_a_minute_is_refused_before_it_is_set_up(
    coarse_data, tmp_path, monkeypatch
):
    """All was simulated, calibrated and drawn, and then there was no pressure after a minute."""
    monkeypatch.setattr(reproduce, "set_up", None)
    march = coarse_data["march"] | {"step_s": 1.0, "duration_min": 0.5}
    with pytest.raises(InputError, match=r"march: it ends after 30 s, .* a longer duration_min"):
        reproduce.reproduce(drivable(coarse_data, march=march), tmp_path / "out")


# The command line


@pytest.mark.parametrize("level", ["nan", "inf", "-inf", "two"])
def test_a_heat_input_is_a_finite_number(level):
    with pytest.raises(InputError, match="LEVEL=RESPONSE"):
        arguments.level_and_file(f"{level}=r2.nc")
    assert arguments.level_and_file("-0.5=r2.nc") == (-0.5, Path("r2.nc"))


def test_a_cool_down_is_for_the_joint_aware_model_only(tmp_path):
    with pytest.raises(InputError, match="other than 0"):
        modelling.calibrate(
            reference=tmp_path / "r1.nc", out=tmp_path / "m.json", given=["0=cool-down.nc"]
        )
    with pytest.raises(InputError, match="--case"):
        modelling.calibrate(
            reference=tmp_path / "r1.nc",
            out=tmp_path / "m.h5",
            given=["0=cool-down.nc"],
            kind="joint-aware",
        )


@pytest.mark.parametrize("text", ["1,2,3", "1,2,3,4,5", "1,2,3,0", "1,2,3,nan", "1,2,3,four", ""])
def test_distances_are_a_square_of_positive_numbers_in_millimetres(text):
    with pytest.raises(InputError, match="--distances-mm"):
        arguments.distances(text)
    assert np.allclose(arguments.distances("49, 125,108,62"), DISTANCES)
    assert arguments.distances("50") == [[0.05]]


def test_a_response_is_judged_with_noise_only_where_noise_is_asked_for(
    hand_made_model, coarse_response
):
    found = {
        noisy: judge.validate_model(
            hand_made_model, None, {"triangle": coarse_response}, noisy=noisy
        )
        for noisy in ((), ("triangle",))
    }
    assert set(found[()].estimates) == {"triangle"}
    assert set(found["triangle",].estimates) == {"triangle", "triangle-noise"}


def test_a_response_of_slow_samples_is_judged_whatever_its_name(hand_made_model):
    slow = response(1.0, t=40.0 * np.arange(20))
    slow["probe_position"][:] = [hand_made_model.sensors[name] for name in PLACES]
    slow = slow.sel(axis=["x", "y"])
    found = judge.validate_model(hand_made_model, None, {"triangle": slow})
    assert {row["case"] for row in found.rows} == {"triangle"}


def test_a_written_measured_response_is_what_the_page_says(page):
    kept = read_response(page / "step-0.5.nc")
    assert np.allclose(np.diff(kept["time"]), 10.0)
    assert kept["temperature"].sel(probe="a").to_numpy() == pytest.approx(
        measured(0.5, kept["time"].to_numpy())["a"], abs=0.01
    )
