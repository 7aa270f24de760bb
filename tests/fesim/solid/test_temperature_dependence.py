"""Conductivity, film, radiation and expansion that depend on temperature."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from batch_cases import case_text, grid
from boxes import boxes
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT
from scipy.sparse import diags_array

from fesim.batch.dataset import open_dataset
from fesim.batch.study import read_study
from fesim.case.schema import case_from_data, read_case
from fesim.march.secant_step import HeatLoads, step_heat
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from fesim.snapshots import structure_snapshot
from fesim.solid.temperature_factor import TemperatureFactor, thermal_growth
from meshes.exchange import write_structure
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.paper.observers import observers_beside
from thermojoint.verification.structures import marched
from thermojoint.verification.temperature_dependence import FALLING, RISING
from thermojoint.verification.thermal_bar import FOREVER, METAL, bar_case

EXAMPLE = ROOT / "examples" / "warm_machine" / "machine.toml"
FLAT = {"rise_K": [0.0], "factor": [1.0]}
MARCH = {"step_s": 20.0, "duration_min": 5.0, "thermal": "full"}

#: To a millikelvin: between closer points the slope of a factor is no number.
rises_K = st.integers(-200_000, 200_000).map(lambda number: number / 1000.0)
points = st.lists(rises_K, min_size=1, max_size=5, unique=True).map(sorted)


@given(rises=points, data=st.data(), temperature=st.floats(-400.0, 400.0))
def test_the_integral_of_a_factor_is_its_integral(rises, data, temperature):
    values = data.draw(
        st.lists(st.floats(0.1, 3.0), min_size=len(rises), max_size=len(rises)), label="values"
    )
    factor = TemperatureFactor(np.array(rises), np.array(values))
    low, high = sorted((0.0, temperature))
    inside = [rise for rise in rises if low < rise < high]
    ends = [low, *inside, high]
    # Piecewise linear: the trapezoidal rule is exact.
    exact = np.trapezoid(np.interp(ends, rises, values), ends) * (1 if temperature > 0 else -1)
    found = factor.integral(np.array([temperature]))[0]
    assert found == pytest.approx(exact, rel=1e-9, abs=1e-9)


def driven(folder, **changes):
    """A heated bar with a film, both ends free of supports but one."""
    given = {
        "sources": {"heat": {"surface": "x0", "reference_power_W": 40.0}},
        "heat_input": {"kind": "step", "level": 1.0},
        "convection_W_m2K": {"x1": 50.0, "y1": 20.0},
        "march": MARCH,
    }
    return bar_case(folder, given | changes, (10, 2, 1))


def test_factors_of_one_are_the_constant_march(tmp_path):
    plain = marched(tmp_path, driven(tmp_path))
    data = driven(tmp_path, convection_factor={"x1": FLAT})
    data["materials"]["metal"] |= {"conductivity_factor": FLAT, "expansion_factor": FLAT}
    same = marched(tmp_path, data)
    np.testing.assert_allclose(same["temperature"], plain["temperature"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(same["displacement"], plain["displacement"], rtol=1e-9, atol=1e-14)
    assert "secant_residual" not in plain


def two_blocks(folder, gpa, **changes):
    """A block pulled askew on a plate by a joint, both warm, the block of some modulus, GPa."""
    structure = boxes(
        {"joint": ("plate.z1", "block.z0")},
        plate=((0.0, 0.0, -0.02), (0.1, 0.1, 0.0), (2, 2, 1)),
        block=((0.0, 0.0, 0.0), (0.1, 0.1, 0.04), (2, 2, 1)),
    )
    write_structure(structure, folder / "blocks.vtu")
    soft = METAL | {"youngs_modulus_GPa": gpa, "poisson_ratio": 0.3}
    data = {
        "title": "blocks",
        "structure": {"kind": "mesh", "file": "blocks.vtu"},
        "materials": {"metal": METAL, "soft": soft},
        "bodies": {"plate": "metal", "block": "soft"},
        "joints": {"joint": {"preload_MPa": 1.0, "along": 3, "across": 3} | RUBBING},
        "supports": {"fixed": ["plate.z0"]},
        "initial_temperature": {"rise_K": 30.0},
        "loads": {"f": {"surface": "block.z1", "force_N": [2500.0, 0.0, 0.0]}},
        "march": {"step_s": 20.0, "duration_min": 1.0, "thermal": "full"},
        "convection_W_m2K": {"block.z1": 200.0},
        "probes": {"tip": {"position_mm": [100.0, 100.0, 40.0], "body": "block"}},
        "displacement": {"point": "tip"},
        "output": {"snapshots_s": [60.0]},
    }
    data["materials"]["soft"] |= changes
    return case_from_data(data, "blocks", folder)


RUBBING = {
    "roughness_um": 1.25,
    "asperity_slope": 0.14,
    "hardness_GPa": 2.0,
    "friction_coefficient": 0.3,
}


def test_a_factor_on_the_modulus_is_the_modulus_that_it_gives(tmp_path):
    """A joint that slides and opens settles with it, and snapshots have its stresses."""
    halved = {"rise_K": [-100.0, -50.0], "factor": [1.5, 0.5]}
    told = []
    for case in (
        two_blocks(tmp_path, 52.0),
        two_blocks(tmp_path, 104.0, youngs_modulus_factor=halved),
    ):
        setup, steps = set_up(case), []
        response = simulate(case, setup=setup, on_step=steps.append).response
        told.append((response, structure_snapshot(setup, steps[-1]).point_data))
    (plain, drawn), (soft, seen) = told
    np.testing.assert_allclose(soft["displacement"], plain["displacement"], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(soft["pressure"], plain["pressure"], rtol=1e-6)
    assert np.abs(plain["slip"]).max() > 1e-8
    assert "error_mesh_um" in plain.attrs
    assert "error_mesh_um" not in soft.attrs
    for name in ("displacement_m", "von_mises_Pa"):
        np.testing.assert_allclose(
            seen[name], drawn[name], rtol=1e-6, atol=1e-6 * drawn[name].max()
        )
    stiff = simulate(two_blocks(tmp_path, 104.0), accuracy=False).response
    assert np.abs(stiff["displacement"] - plain["displacement"]).max() > 1e-7


@pytest.mark.parametrize("asked", [{"forces": True}, {"stress_probes": ["tip"]}])
def test_forces_and_stresses_of_a_changing_modulus_are_refused(tmp_path, asked):
    case = two_blocks(tmp_path, 104.0, youngs_modulus_factor=FALLING)
    data = case.model_dump(mode="json", exclude_unset=True) | {"output": asked}
    with pytest.raises(InputError, match=r"materials\.soft\.youngs_modulus_factor so far"):
        case_from_data(data, "blocks", tmp_path)


def test_every_step_satisfies_its_own_equation(tmp_path):
    """Assembled anew at the temperatures that came out, nothing is left of the heat equation."""
    data = driven(
        tmp_path,
        convection_factor={"x1": RISING},
        radiation={"y1": {"emissivity": 0.9, "ambient_degC": 20.0}},
    )
    data["materials"]["metal"] |= {"conductivity_factor": FALLING}
    case = case_from_data(data, "bar", tmp_path)
    setup, steps = set_up(case), []
    response = simulate(case, setup=setup, on_step=steps.append).response
    thermal, variable = setup.machine.thermal, setup.machine.variable
    upper = thermal.factor.matrix
    system = upper + upper.T - diags_array(upper.diagonal())
    before = np.zeros(setup.spaces.heat.N)
    for step in steps:
        after = step.state.temperature
        lack = (
            system @ after
            + variable.lost(after, step.inputs)
            - thermal.capacity_rate @ before
            - thermal.inputs @ step.inputs
        )
        assert np.abs(lack).max() < 1e-6
        before = after
    assert response["secant_residual"].max().item() < 1.1e-8
    assert np.abs(response["heat_balance"]).max().item() < 1e-8
    # What leaves by film and radiation counts: the bar does not keep all of its heat.
    assert steps[-1].state.temperature.max() > 5.0


def test_radiation_follows_the_ambient(tmp_path):
    (tmp_path / "hall.csv").write_text("time_s,ambient_degC\n0,20\n10,50\n")
    still = {
        "ambient": {"file": "hall.csv"},
        "sources": {},
        "convection_W_m2K": {},
        "radiation": {name: {"emissivity": 1.0, "ambient_degC": 20.0} for name in ("x1", "y1")},
        "march": {"step_s": FOREVER, "duration_min": FOREVER / 60.0, "thermal": "full"},
    }
    found = marched(tmp_path, driven(tmp_path, **still))
    np.testing.assert_allclose(found["temperature"][-1], 30.0, rtol=1e-9)


def test_an_unsettled_secant_step_is_one_line(tmp_path):
    data = driven(tmp_path)
    data["materials"]["metal"] |= {"conductivity_factor": RISING}
    machine = set_up(case_from_data(data, "bar", tmp_path)).machine
    cold, inputs = np.zeros(machine.thermal.inputs.shape[0]), np.array([0.0, 40.0])
    with pytest.raises(ConvergenceError, match="secant steps: temperatures still change") as told:
        step_heat(machine.thermal, machine.variable, cold, HeatLoads(inputs, np.empty(0)), most=2)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"convection_factor": {"z1": FLAT}}, "add its film to"),
        ({"convection_factor": {"x1": {"rise_K": [0, 0], "factor": [1, 1]}}}, "must rise"),
        ({"convection_factor": {"x1": {"rise_K": [0, 1], "factor": [1]}}}, "as many values"),
        ({"convection_factor": {"x1": {"rise_K": [0], "factor": [0]}}}, "greater than 0"),
        ({"radiation": {"x1": {"emissivity": 1.5, "ambient_degC": 20}}}, "less than or equal to 1"),
        ({"radiation": {"x1": {"emissivity": 0.5}}}, "ambient_degC is missing"),
        ({"cavities": {"air": {"surfaces": ["x1"], "film_W_m2K": 3}}}, "gives off heat elsewhere"),
        ({"cavities": {"air": {"surfaces": ["q"], "film_W_m2K": 3}}}, "no surface named 'q'"),
        ({"radiation": {"q": {"emissivity": 0.5, "ambient_degC": 20}}}, "no surface named 'q'"),
    ],
)
def test_a_slip_about_what_depends_on_temperature_is_one_line(tmp_path, changes, message):
    with pytest.raises(InputError, match=message) as refused:
        marched(tmp_path, driven(tmp_path, **changes))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "key",
    [
        "conductivity_factor",
        "heat_capacity_factor",
        "expansion_factor",
        "youngs_modulus_factor",
        "convection_factor",
        "radiation",
    ],
)
def test_the_reduced_model_refuses_what_depends_on_temperature(tmp_path, key):
    data = driven(tmp_path, march=MARCH | {"thermal": "reduced"})
    if key.startswith("con") and "vec" in key:
        data[key] = {"x1": FLAT}
    elif key == "radiation":
        data[key] = {"x1": {"emissivity": 0.5, "ambient_degC": 20.0}}
    else:
        data["materials"]["metal"][key] = FLAT
    with pytest.raises(InputError, match='thermal = "full"') as refused:
        case_from_data(data, "bar", tmp_path)
    assert key in str(refused.value)


def test_a_copy_of_a_case_is_refused_as_the_case_would_be(tmp_path):
    """Commands that need modes copy a case: what it cannot be marched with is found then."""
    data = driven(tmp_path, radiation={"x1": {"emissivity": 0.5, "ambient_degC": 20.0}})
    case = case_from_data(data, "bar", tmp_path)
    march = case.march.model_copy(update={"thermal": "reduced"})
    with pytest.raises(InputError, match=r"radiation\.x1: the reduced thermal model"):
        set_up(case.model_copy(update={"march": march}))
    with ThreadPoolExecutor() as crew:
        assert observers_beside(crew, case, {}, {}, tmp_path)()[0] == []


def test_a_batch_has_a_place_for_the_error_of_secant_steps(tmp_path):
    text = case_text(0.1)
    black = "[radiation.exterior]\nemissivity = 0.5\nambient_degC = 20.0\n"
    (tmp_path / "machine.toml").write_text(text + black)
    path = tmp_path / "study.toml"
    path.write_text(f'case = "machine.toml"\n{grid("radiation.exterior.emissivity", 0.5, 0.9)}')
    arrays = open_dataset(tmp_path / "dataset.zarr", read_study(path)).arrays
    assert arrays["secant_residual"].shape == arrays["heat_balance"].shape


def test_bodies_that_share_nodes_do_not_grow_in_two_ways():
    factor = TemperatureFactor(np.zeros(1), np.ones(1))
    nodes = {"a": np.array([0, 1]), "b": np.array([1, 2])}
    with pytest.raises(InputError, match="body 'a' shares nodes with 'b'"):
        thermal_growth(nodes, {"a": factor})
    both = thermal_growth(nodes, {"a": factor, "b": TemperatureFactor(np.zeros(1), np.ones(1))})
    assert both is not None


@pytest.mark.long
def test_the_example_starts_warm_and_tells_its_secant_error():
    case = read_case(EXAMPLE)
    response = simulate(case).response
    assert response["temperature"][0].sel(probe="head").item() == pytest.approx(7.4, rel=1e-9)
    assert np.abs(response["displacement"][0]).max().item() > 1e-6
    assert response["secant_residual"].max().item() < 1e-7
    assert np.abs(response["heat_balance"]).max().item() < 1e-8
    assert response["gap_residual"].max().item() < 1e-11
