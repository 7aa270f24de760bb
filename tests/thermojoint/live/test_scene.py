"""The machine in 3-D: a model without a mesh gets its surface back, and only its own."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from observed import SENSORS, estimates, observed_data

from estimator.joint_aware.kind import KIND
from estimator.joint_aware.observer_state import unpacked
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.artefacts.errors import InputError
from thermojoint.live.scene import EYE, front_of, scene_of, upright
from thermojoint.live.surface import (
    pressures,
    read_surface,
    surface_of,
    temperatures,
    write_surface,
)

UP = np.array([0.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def surface(watched):
    return surface_of(watched.case, watched.setup, watched.estimator.model, UP)


def test_in_a_warmer_ambient_every_corner_becomes_as_warm(surface, watched):
    modes = watched.estimator.model.modes
    amplitudes = modes.drive[:, -1] / modes.rates
    assert surface.rows @ amplitudes == pytest.approx(np.ones(len(surface.points)), abs=1e-3)


def test_the_surface_is_as_warm_as_the_sensors_on_it(surface, watched):
    estimator, samples = watched.estimator, watched.samples
    state, _ = estimates(estimator, samples)
    found = temperatures(surface, estimator, state)
    where = watched.response["probe_position"].sel(probe=list(SENSORS)).to_numpy()
    for place, reading in zip(where, samples[-1][1:], strict=False):
        distance = np.linalg.norm(surface.points - place, axis=1)
        near = found[distance < 0.11]
        assert near.min() - 0.5 <= reading <= near.max() + 0.5
    assert found.max() > 2.0 * max(samples[-1][1:]) / 3.0


def test_a_machine_at_rest_has_its_preload_in_every_contact(surface, watched):
    estimator = watched.estimator
    found = pressures(surface, estimator, estimator.initial_state())
    preload = 1e6 * next(iter(watched.case.joints.values())).preload_MPa
    assert found == pytest.approx(np.full(len(surface.contact_triangles), preload))
    known = unpacked(estimator.initial_state(), estimator.parts).pressure.size
    assert set(surface.contacts) == set(range(known))


def test_modes_whose_signs_are_others_give_the_same_temperatures(surface, watched):
    model = watched.estimator.model
    signs = np.where(np.arange(model.modes.rates.size) % 2, -1.0, 1.0)
    elastic = replace(
        model.modes.elastic,
        thermal_gap=model.modes.elastic.thermal_gap * signs,
        probe_thermal=model.modes.elastic.probe_thermal * signs,
    )
    turned = replace(
        model.modes,
        drive=model.modes.drive * signs[:, None],
        jump=model.modes.jump * signs,
        sensors=model.modes.sensors * signs,
        elastic=elastic,
    )
    found = surface_of(watched.case, watched.setup, replace(model, modes=turned), UP)
    assert found.rows == pytest.approx(surface.rows * signs, abs=1e-4)


def test_the_surface_of_another_machine_is_refused(coarse_data, watched):
    other = observed_data(coarse_data)
    other["materials"]["cast_iron"]["conductivity_W_mK"] = 20.0
    case = case_from_data(other, "case", Path())
    with pytest.raises(InputError, match="another case or mesh"):
        surface_of(case, set_up(case), watched.estimator.model, UP)


def test_a_scene_of_a_machine_that_moves_is_refused_in_one_line(command, tmp_path):
    """It was to leave out its axes, with which its model was calibrated."""
    case, out = files("thermojoint").joinpath("cases", "moving_knee.toml"), tmp_path / "scene.h5"
    code, _, errors = command("scene", case, tmp_path / "model.h5", "--out", out)
    assert (code, errors.count("\n"), out.exists()) == (2, 1, False)
    assert "a scene shows a machine that stands, and its y may move; leave out scene" in errors


def test_a_surface_is_read_back_for_its_own_model_alone(tmp_path, surface, watched):
    path, model = tmp_path / "scene.h5", watched.estimator.model
    write_surface(surface, path)
    assert np.array_equal(read_surface(path, model).rows, surface.rows)
    other = replace(model, offset=model.offset + 1.0)
    with pytest.raises(InputError, match="another model"):
        read_surface(path, other)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match="no readable surface"):
        read_surface(path, model)


def test_a_scene_says_nothing_before_the_first_sample(tmp_path, surface, watched):
    path, estimator = tmp_path / "scene.h5", watched.estimator
    write_surface(surface, path)
    states = [estimator.initial_state()]
    scene = scene_of(path, estimator, lambda: states[-1])
    assert scene.fields() is None
    states.append(estimates(estimator, watched.samples)[0])
    told = scene.fields()
    assert len(told["temperature_K"]) == len(scene.shape["surface"]["points_m"][0])
    assert len(told["pressure_MPa"]) == len(scene.shape["joints"]["triangles"][0])


@pytest.mark.parametrize("up", [one * sign for one in np.eye(3) for sign in (1.0, -1.0)])
def test_up_becomes_the_third_axis_by_a_rotation(up):
    turn = upright(up)
    assert turn @ up == pytest.approx([0.0, 0.0, 1.0])
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_a_joint_is_looked_at_from_its_front():
    corners = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    found = front_of(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    assert found[0] > 1.0
    assert abs(found[1]) < 1e-9
    both = front_of(corners, np.array([[0, 1, 2], [0, 2, 1]]))
    assert both == pytest.approx(EYE)


def test_the_reading_of_a_sensor_that_lies_stands_out_by_what_it_lies(watched):
    samples, estimator = [list(one) for one in watched.samples], watched.estimator
    at = 1 + SENSORS.index("T1")
    for sample in samples[-20:]:
        sample[at] += 5.0
    state, found = estimates(estimator, samples)
    assert found[-1].distrusted == ("T1",)
    differ = KIND.residuals(estimator, state, np.array(samples[-1][1:]))
    assert differ[at - 1] == pytest.approx(5.0, abs=0.5)
    assert np.abs(np.delete(differ, at - 1)).max() < 0.5
